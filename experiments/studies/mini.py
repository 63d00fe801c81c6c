"""The paper's physical tables by their twin: ten recordings of each angle and duration.

All recordings of an angle are of one set-up with one calibration, as in the paper: what the
calibration errs by, all cells of the angle share.
"""

from collections.abc import Iterable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pandas as pd

from experiments.lab.command import command_of
from experiments.lab.markdown import digits, markdown_table
from experiments.lab.results import Results
from experiments.lab.study import Made, Runs, Study
from experiments.lab.verify import scored_checks
from experiments.paper.comparison import (
    PUBLISHED_ERRORS,
    comparison_table,
    load_published,
)
from experiments.paper.esim import esim_table
from experiments.paper.quantities import ERRORS
from experiments.studies import error_budget, light_latency
from experiments.worlds.bench import (
    ALL,
    ANGLES_DEG,
    COMMAND,
    IMPERFECTIONS,
    PHYSICAL,
    PhysicalCell,
    Recordings,
    bench_of,
    cells_of,
    setup_seed,
)
from ssac.fit.covariance import NORMAL_95
from ssac.pipeline.registry import OURS

if TYPE_CHECKING:
    from matplotlib.figure import Figure

N_RECORDINGS = 10
"""Of each angle and duration, as in the paper."""

DURATIONS_S = (10.0, 20.0)
T_DS_MS = (5.0, 50.0, 500.0)
METHODS = ("ssac", "joint", "tangency")  # that pages show

PUBLISHED = Path(__file__).parents[1] / "worlds" / "published"
_ERRORS = tuple(one for one in PUBLISHED_ERRORS if one.method == "ssac")


def cells(duration_s: float, recordings: Recordings = None) -> list[PhysicalCell]:
    """List every method on every recording of a duration, with each offset."""
    return [
        cell
        for angle_deg in ANGLES_DEG
        for flight in range(recordings or N_RECORDINGS)
        for cell in cells_of(
            bench_of(ALL, angle_deg, duration_s, setup_seed(angle_deg, 0)),
            {},
            flight,
            T_DS_MS,
            [method.name for method in OURS],
        )
    ]


def published_tables() -> dict[float, pd.DataFrame]:
    """Read the paper's physical tables, by duration [s]."""
    return load_published(PUBLISHED, "mini", DURATIONS_S, _ERRORS)


def table(results: Results, duration_s: float) -> pd.DataFrame:
    """Mean errors by angle and offset."""
    return esim_table(results.table(f"mini_{duration_s:g}_runs"), duration_s)


def figure(results: Results, duration_s: float) -> "Figure":
    """Draw the errors of all methods beside the paper's."""
    from experiments.drawing.errors import error_figure

    return error_figure(results.table(f"mini_{duration_s:g}_runs"), published_tables())


def comparison(results: Results) -> pd.DataFrame:
    """Compare both tables with the paper's, cell by cell."""
    tables = {duration_s: results.table(f"mini_{duration_s:g}") for duration_s in DURATIONS_S}
    return comparison_table(tables, published_tables(), reasons={}, errors=_ERRORS)


# --- What pages quote ---


def page_table(results: Results) -> str:
    """Lay out the paper's means and ours by duration and angle, over the offsets, as t_d / R / t.

    The offsets of a recording leave the same errors here, and other recordings in the paper.
    """
    compared, rows = results.table("mini_comparison"), []
    for duration_s in DURATIONS_S:
        ours_by_cell = results.table(f"mini_{duration_s:g}")
        of_duration = compared[compared["duration_s"] == duration_s]
        for angle_deg, of_angle in of_duration.groupby("angle_deg", sort=False):
            published = of_angle.groupby("quantity")["published_mean"].mean()
            ours = ours_by_cell[ours_by_cell["angle_deg"] == angle_deg].mean(numeric_only=True)
            rows.append(
                [
                    f"{duration_s:g}",
                    f"{angle_deg:g}",
                    _slashed(published[f"ssac_{error}"] for error in ERRORS),
                    *(_slashed(ours[f"{name}_{error}_mean"] for error in ERRORS)
                      for name in METHODS),
                ]
            )  # fmt: skip
    return markdown_table(["s", "deg", "the paper's SSAC", *(f"`{m}`" for m in METHODS)], rows)


def held_table(results: Results) -> str:
    """Count answers, and stated 95 % intervals of t_d that hold the truth, of all recordings."""
    rows = []
    for duration_s in DURATIONS_S:
        runs = results.table(f"mini_{duration_s:g}_runs")
        one_offset = runs[runs["t_d_ms"] == runs["t_d_ms"].min()]
        for method in METHODS[1:]:
            mine = one_offset[one_offset["method"] == method]
            ok = mine[mine["status"] == "ok"]
            held = ok["t_d_error_ms"] <= NORMAL_95 * ok["t_d_std_ms"]
            means = (digits(float(ok[name].mean())) for name in ("t_d_error_ms", "t_d_std_ms"))
            answered = f"{len(ok)} of {len(mine)}"
            share = f"{100.0 * held.mean():.0f}"
            rows.append([f"{duration_s:g}", f"`{method}`", answered, share, *means])
    header = ["s", "method", "answered", "held [%]", "error of t_d [ms]", "stated 1 sigma [ms]"]
    return markdown_table(header, rows)


def _slashed(values: Iterable[float]) -> str:
    return " / ".join(digits(float(value)) for value in values)


# --- The studies ---


def _config(duration_s: float) -> dict[str, Any]:
    angle_deg = ANGLES_DEG[0]
    return {
        "n_recordings": N_RECORDINGS, "duration_s": duration_s, "angles_deg": ANGLES_DEG,
        "t_ds_ms": T_DS_MS, "imperfections": list(IMPERFECTIONS),
        "bench": bench_of(ALL, angle_deg, duration_s, setup_seed(angle_deg, 0)),
    }  # fmt: skip


def _study(duration_s: float, *more: Made, **others: Any) -> Study:
    name = f"mini_{duration_s:g}"
    return Study(
        name,
        f"The paper's physical experiments of {duration_s:g} s, by their twin",
        partial(cells, duration_s),
        PHYSICAL,
        Runs(f"{name}_runs.csv", ("angle_deg", "t_d_ms", "flight", "method")),
        (
            Made(f"{name}.csv", partial(table, duration_s=duration_s)),
            Made(f"{name}.png", partial(figure, duration_s=duration_s)),
            *more,
        ),
        checks=scored_checks(f"{name}_runs"),
        config=_config(duration_s),
        command=COMMAND,
        **others,
    )


STUDIES = (
    _study(10.0),
    _study(
        20.0,
        Made(
            "mini_comparison.csv",
            comparison,
            config={f"mini_{duration_s:g}": _config(duration_s) for duration_s in DURATIONS_S},
        ),
        reads=("mini_10.csv",),
        numbers={
            "table.mini": page_table,
            "table.mini.held": held_table,
        },
    ),
)

command = command_of(
    {"tables": STUDIES, "budget": error_budget.STUDIES, "latency": light_latency.STUDIES},
    "Simulate the paper's small-scale physical set-up: its tables, and what each fault costs.\n\n"
    "What is finished is kept in the cache, so that an interrupted run goes on where it was.",
)
