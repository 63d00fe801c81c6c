"""What each imperfection of a bench costs in t_d, R and t: alone, and all but it.

Each recording has a set-up and a calibration of its own, so that a mean is what one may expect of a
bench, not the luck of one. All kinds of a recording share its motion: their differences are of the
imperfection, not of the draw.
"""

from typing import Any

import numpy as np
import pandas as pd

from experiments.drawing.panels import Figure, legend_below, panels
from experiments.lab.markdown import digits, markdown_table
from experiments.lab.results import Results
from experiments.lab.study import Runs, Study
from experiments.lab.summary import answered, by_group, held, made_of, statistics
from experiments.lab.verify import between, scored_checks
from experiments.paper.quantities import ERRORS, R_ERROR, T_D_ERROR
from experiments.worlds import bench
from experiments.worlds.bench import ALL, ANGLES_DEG, IMPERFECTIONS, KINDS, NONE, all_but, only

N_RECORDINGS = 1
"""Of each angle, and each of all kinds. 24 of the 34 kinds are simulated apart: half an hour a
recording at 10 s."""

FIRST_FLIGHT = 20_000  # of no table
DURATION_S = 10.0
T_D_MS = 50.0
METHODS = ("ssac", "joint", "tangency")
ON_THE_PAGE = ("ssac", "tangency")


def cells(recordings: bench.Recordings = None) -> list[bench.PhysicalCell]:
    """List the three methods on every kind of each recording."""
    found: list[bench.PhysicalCell] = []
    for angle_deg in ANGLES_DEG:
        for flight in range(FIRST_FLIGHT, FIRST_FLIGHT + (recordings or N_RECORDINGS)):
            setup = bench.setup_seed(angle_deg, flight)
            for kind in KINDS:
                of_kind = bench.bench_of(kind, angle_deg, DURATION_S, setup)
                found += bench.cells_of(of_kind, {"kind": kind}, flight, (T_D_MS,), METHODS)
    return found


def budget_table(runs: pd.DataFrame) -> pd.DataFrame:
    """Mean errors by kind, angle and method, of the runs that are answered ("ok").

    `t_d_bias_ms` is the mean of the signed error of t_d, `t_d_held` the share of the stated 95 %
    intervals of t_d that hold the truth.
    """

    def row(group: pd.DataFrame) -> dict[str, Any]:
        ok = answered(group)
        stated = ok[np.isfinite(ok["t_d_std_ms"].astype(float))]
        return {
            **{"runs": len(group), "answered": len(ok)},
            **statistics(ok, [*ERRORS], "mean", "std"),
            "t_d_bias_ms": (ok["t_d_estimate_ms"] - ok["t_d_ms"]).mean(),
            "t_d_held": held(stated, "t_d", "ms").mean() if len(stated) else np.nan,
        }

    return by_group(runs, ("kind", "angle_deg", "method"), row)


def budget_figure(summary: pd.DataFrame) -> Figure:
    """Draw, for each method and error, what each imperfection adds alone and what its lack spares.

    The mean over the angles of each imperfection alone (filled) and of all but it (hollow); lines
    stand where there is none and where there are all.
    """
    from matplotlib.ticker import LogLocator

    from experiments.drawing.style import method_looks

    places, looks = np.arange(len(IMPERFECTIONS)), method_looks([*METHODS])
    height_in = 1.2 + 0.22 * len(places) * len(METHODS)
    figure, grid = panels(height_in, len(METHODS), len(ERRORS), sharey=True)
    for row, method in zip(grid, METHODS, strict=True):
        dots: dict[str, Any] = {"ms": 5, "color": looks[method].color}
        for axes, (name, quantity) in zip(row, ERRORS.items(), strict=True):
            values = _means(summary, name).xs(method, level="method")
            alone, without = (values[[*map(of, IMPERFECTIONS)]] for of in (only, all_but))
            axes.plot(alone, places, "o", label="alone", **dots)
            axes.plot(without, places, "o", mfc="white", label="all but it", **dots)
            axes.axvline(values[NONE], color="0.3", lw=0.8, ls=":", label="none")
            axes.axvline(values[ALL], color="0.3", lw=0.8, ls="--", label="all")
            axes.set(xscale="log")
            axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            axes.xaxis.set_major_formatter("{x:g}")
            axes.xaxis.set_minor_formatter("")
            axes.set_xlabel(quantity.label, fontsize=9)
            if name == T_D_ERROR.column:
                axes.set_title(method, fontsize=10, loc="left")
        row[0].set_yticks(places, list(IMPERFECTIONS), fontsize=8)
    grid[0, 0].invert_yaxis()
    legend_below(figure, 4)
    return figure


def page_table(results: Results) -> str:
    """Lay t_d / R out over the angles, with nothing, each imperfection alone, and all of them."""
    table = results.table("error_budget")
    means = [_means(table, error.column) for error in (T_D_ERROR, R_ERROR)]
    kinds = {NONE: NONE, **{name: only(name) for name in IMPERFECTIONS}, ALL: ALL}
    rows = [
        [name, *(" / ".join(digits(float(of[kind, method])) for of in means)
                 for method in ON_THE_PAGE)]
        for name, kind in kinds.items()
    ]  # fmt: skip
    return markdown_table(["bench", *(f"`{method}`" for method in ON_THE_PAGE)], rows)


def _means(summary: pd.DataFrame, error: str) -> "pd.Series[float]":
    """Mean over the angles by kind and method."""
    by_kind = summary.groupby(["kind", "method"], sort=False)
    return by_kind[f"{error}_mean"].mean()


STUDIES = (
    Study(
        "error_budget",
        "What each imperfection of a bench costs, alone and of all",
        cells,
        bench.PHYSICAL,
        Runs("error_budget_runs.csv", ("kind", "angle_deg", "flight", "method")),
        (made_of("error_budget.csv", budget_table, "error_budget_runs"),
         made_of("error_budget.png", budget_figure, "error_budget")),
        numbers={"table.budget": page_table},
        checks=(("shares are shares", between("error_budget", "t_d_held", 0.0, 1.0)),
                *scored_checks("error_budget_runs")),
        config={"n_recordings": N_RECORDINGS, "first_flight": FIRST_FLIGHT,
                "duration_s": DURATION_S, "t_d_ms": T_D_MS, "angles_deg": ANGLES_DEG,
                "kinds": KINDS, "methods": METHODS,
                "bench": bench.bench_of(ALL, ANGLES_DEG[0], DURATION_S, 0)},
        command=bench.COMMAND,
    ),
)  # fmt: skip
