"""The paper's physical tables by their twin: ten recordings of each angle and duration.

All recordings of an angle are of one set-up with one calibration, as in the paper: what the
calibration errs by, all cells of the angle share.
"""

from collections.abc import Iterable
from functools import partial
from pathlib import Path
from typing import Any

import pandas as pd

from experiments.drawing.panels import Figure
from experiments.lab.command import command_of
from experiments.lab.markdown import digits, markdown_table
from experiments.lab.results import Results
from experiments.lab.study import Made, Runs, Study
from experiments.lab.summary import answered, held, made_of
from experiments.lab.verify import scored_checks
from experiments.paper.comparison import PUBLISHED_ERRORS, comparison_table, load_published
from experiments.paper.esim import esim_table
from experiments.paper.quantities import ERRORS
from experiments.studies import error_budget, light_latency
from experiments.worlds import bench
from experiments.worlds.bench import ALL, ANGLES_DEG
from ssac.pipeline.registry import OURS

N_RECORDINGS = 10  # of each angle and duration, as in the paper
DURATIONS_S = (10.0, 20.0)
T_DS_MS = (5.0, 50.0, 500.0)
METHODS = ("ssac", "joint", "tangency")  # that pages show

PUBLISHED = Path(__file__).parents[1] / "worlds" / "published"
_ERRORS = tuple(one for one in PUBLISHED_ERRORS if one.method == "ssac")


def cells(duration_s: float, recordings: bench.Recordings = None) -> list[bench.PhysicalCell]:
    """List every method on every recording of a duration, with each offset."""
    methods, found = [method.name for method in OURS], list[bench.PhysicalCell]()
    for angle_deg in ANGLES_DEG:
        for flight in range(recordings or N_RECORDINGS):
            found += bench.cells_of(_bench(angle_deg, duration_s), {}, flight, T_DS_MS, methods)
    return found


def _bench(angle_deg: float, duration_s: float) -> bench.SetUp:
    return bench.bench_of(ALL, angle_deg, duration_s, bench.setup_seed(angle_deg, 0))


def published_tables() -> dict[float, pd.DataFrame]:
    """Read the paper's physical tables, by duration [s]."""
    return load_published(PUBLISHED, "mini", DURATIONS_S, _ERRORS)


def figure(runs: pd.DataFrame) -> Figure:
    """Draw the errors of all methods beside the paper's."""
    from experiments.drawing.errors import error_figure

    return error_figure(runs, published_tables())


def comparison(results: Results) -> pd.DataFrame:
    """Compare both tables with the paper's, cell by cell."""
    tables = {duration_s: results.table(f"mini_{duration_s:g}") for duration_s in DURATIONS_S}
    return comparison_table(tables, published_tables(), reasons=(), errors=_ERRORS)


def page_table(results: Results) -> str:
    """Lay out the paper's means and ours by duration and angle, over the offsets, as t_d / R / t.

    The offsets of a recording leave the same errors here, and other recordings in the paper.
    """
    rows = []
    compared = results.table("mini_comparison").groupby(["duration_s", "angle_deg"], sort=False)
    for (duration_s, angle_deg), of in compared:
        published = of.groupby("quantity")["published_mean"].mean()
        ours = results.rows(f"mini_{duration_s:g}", angle_deg=angle_deg).mean(numeric_only=True)
        means = [[ours[f"{name}_{error}_mean"] for error in ERRORS] for name in METHODS]
        shown = [[published[f"ssac_{error}"] for error in ERRORS], *means]
        rows.append([f"{duration_s:g}", f"{angle_deg:g}", *map(_slashed, shown)])
    return markdown_table(["s", "deg", "the paper's SSAC", *(f"`{m}`" for m in METHODS)], rows)


def held_table(results: Results) -> str:
    """Count answers, and stated 95 % intervals of t_d that hold the truth, of all recordings."""
    rows = []
    for duration_s in DURATIONS_S:
        for method in METHODS[1:]:
            mine = results.rows(f"mini_{duration_s:g}_runs", method=method, t_d_ms=T_DS_MS[0])
            ok = answered(mine)
            means = (digits(float(ok[name].mean())) for name in ("t_d_error_ms", "t_d_std_ms"))
            share = f"{100.0 * held(ok, 't_d', 'ms').mean():.0f}"
            count = f"{len(ok)} of {len(mine)}"
            rows.append([f"{duration_s:g}", f"`{method}`", count, share, *means])
    header = ["s", "method", "answered", "held [%]", "error of t_d [ms]", "stated 1 sigma [ms]"]
    return markdown_table(header, rows)


def _slashed(values: Iterable[float]) -> str:
    return " / ".join(digits(float(value)) for value in values)


def _config(duration_s: float) -> dict[str, Any]:
    return {
        "n_recordings": N_RECORDINGS, "duration_s": duration_s, "angles_deg": ANGLES_DEG,
        "t_ds_ms": T_DS_MS, "imperfections": list(bench.IMPERFECTIONS),
        "bench": _bench(ANGLES_DEG[0], duration_s),
    }  # fmt: skip


def _study(duration_s: float, *more: Made, **others: Any) -> Study:
    name = f"mini_{duration_s:g}"
    return Study(
        name,
        f"The paper's physical experiments of {duration_s:g} s, by their twin",
        partial(cells, duration_s),
        bench.PHYSICAL,
        Runs(f"{name}_runs.csv", ("angle_deg", "t_d_ms", "flight", "method")),
        (made_of(f"{name}.csv", partial(esim_table, duration_s=duration_s), f"{name}_runs"),
         made_of(f"{name}.png", figure, f"{name}_runs"), *more),
        checks=scored_checks(f"{name}_runs"),
        config=_config(duration_s),
        command=bench.COMMAND,
        **others,
    )  # fmt: skip


_CONFIGS = {f"mini_{duration_s:g}": _config(duration_s) for duration_s in DURATIONS_S}

STUDIES = (
    _study(10.0),
    _study(
        20.0,
        Made("mini_comparison.csv", comparison, config=_CONFIGS),
        reads=("mini_10.csv",),
        numbers={"table.mini": page_table, "table.mini.held": held_table},
    ),
)

command = command_of(
    {"tables": STUDIES, "budget": error_budget.STUDIES, "latency": light_latency.STUDIES},
    "Simulate the paper's small-scale physical set-up: its tables, and what each fault costs.\n\n"
    "What is finished is kept in the cache, so that an interrupted run goes on where it was.",
)
