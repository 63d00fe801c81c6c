"""What each imperfection of a bench costs in t_d, R and t: alone, and all but it.

Each recording has a set-up and a calibration of its own, so that a mean is what one may expect of a
bench, not the luck of one. All kinds of a recording share its motion: their differences are of the
imperfection, not of the draw.
"""

from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from experiments.lab.markdown import digits, markdown_table
from experiments.lab.results import Results
from experiments.lab.study import Made, Runs, Study
from experiments.lab.verify import between, scored_checks
from experiments.paper.quantities import ERRORS, R_ERROR, T_D_ERROR
from experiments.worlds.bench import (
    ALL,
    ANGLES_DEG,
    COMMAND,
    IMPERFECTIONS,
    KINDS,
    NONE,
    PHYSICAL,
    PhysicalCell,
    Recordings,
    all_but,
    bench_of,
    cells_of,
    only,
    setup_seed,
)
from ssac.fit.covariance import NORMAL_95

if TYPE_CHECKING:
    from matplotlib.figure import Figure

N_RECORDINGS = 1
"""Of each angle, and each of all kinds. 24 of the 34 kinds are simulated apart: half an hour a
recording at 10 s."""

FIRST_FLIGHT = 20_000  # of no table
DURATION_S = 10.0
T_D_MS = 50.0
METHODS = ("ssac", "joint", "tangency")
ON_THE_PAGE = ("ssac", "tangency")


def cells(recordings: Recordings = None) -> list[PhysicalCell]:
    """List the three methods on every kind of each recording."""
    return [
        cell
        for angle_deg in ANGLES_DEG
        for flight in range(FIRST_FLIGHT, FIRST_FLIGHT + (recordings or N_RECORDINGS))
        for kind in KINDS
        for cell in cells_of(
            bench_of(kind, angle_deg, DURATION_S, setup_seed(angle_deg, flight)),
            {"kind": kind},
            flight,
            (T_D_MS,),
            METHODS,
        )
    ]


def budget_table(runs: pd.DataFrame) -> pd.DataFrame:
    """Mean errors by kind, angle and method, in their order.

    Returns
    -------
    pd.DataFrame
        `runs`, `answered` (status "ok"), mean and deviation of each error over these,
        `t_d_bias_ms`, the mean of the signed error of t_d, and `t_d_held`, the share of the stated
        95 % intervals of t_d that hold the truth.
    """
    rows = []
    for (kind, angle_deg, method), group in runs.groupby(
        ["kind", "angle_deg", "method"], sort=False
    ):
        ok = group[group["status"] == "ok"]
        row: dict[str, Any] = {"kind": kind, "angle_deg": angle_deg, "method": method,
                               "runs": len(group), "answered": len(ok)}  # fmt: skip
        for error in ERRORS:
            row[f"{error}_mean"] = ok[error].mean()
            row[f"{error}_std"] = ok[error].std(ddof=0)
        row["t_d_bias_ms"] = (ok["t_d_estimate_ms"] - ok["t_d_ms"]).mean()
        stated = ok[np.isfinite(ok["t_d_std_ms"].astype(float))]
        held = stated["t_d_error_ms"] <= NORMAL_95 * stated["t_d_std_ms"]
        row["t_d_held"] = held.mean() if len(stated) else np.nan
        rows.append(row)
    table: pd.DataFrame = pd.DataFrame(rows)
    return table


def budget_figure(summary: pd.DataFrame) -> "Figure":
    """Draw, for each method and error, what each imperfection adds alone and what its lack spares.

    The mean over the angles of each imperfection alone (filled) and of all but it (hollow); lines
    stand where there is none and where there are all.
    """
    from matplotlib.figure import Figure
    from matplotlib.ticker import LogLocator

    from experiments.drawing.style import WIDTH_IN, method_looks, quiet_axes

    places = np.arange(len(IMPERFECTIONS))
    height_in = 1.2 + 0.22 * len(places) * len(METHODS)
    figure = Figure(figsize=(WIDTH_IN, height_in), layout="constrained")
    grid = figure.subplots(len(METHODS), len(ERRORS), sharey=True, squeeze=False)
    for row, method in zip(grid, METHODS, strict=True):
        color = method_looks([method])[method].color
        for axes, (name, quantity) in zip(row, ERRORS.items(), strict=True):
            quiet_axes(axes)
            values = _means(summary, name).xs(method, level="method")
            axes.plot(values[[only(one) for one in IMPERFECTIONS]], places, "o", ms=5,
                      color=color, label="alone")  # fmt: skip
            axes.plot(values[[all_but(one) for one in IMPERFECTIONS]], places, "o", ms=5,
                      color=color, mfc="white", label="all but it")  # fmt: skip
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
    handles, labels = grid[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, fontsize=8, frameon=False)
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
    means: pd.Series[float] = summary.groupby(["kind", "method"], sort=False)[
        f"{error}_mean"
    ].mean()
    return means


STUDIES = (
    Study(
        "error_budget",
        "What each imperfection of a bench costs, alone and of all",
        cells,
        PHYSICAL,
        Runs("error_budget_runs.csv", ("kind", "angle_deg", "flight", "method")),
        (
            Made("error_budget.csv", lambda one: budget_table(one.table("error_budget_runs"))),
            Made("error_budget.png", lambda one: budget_figure(one.table("error_budget"))),
        ),
        numbers={"table.budget": page_table},
        checks=(
            ("shares are shares", between("error_budget", "t_d_held", 0.0, 1.0)),
            *scored_checks("error_budget_runs"),
        ),
        config={"n_recordings": N_RECORDINGS, "first_flight": FIRST_FLIGHT,
                "duration_s": DURATION_S, "t_d_ms": T_D_MS, "angles_deg": ANGLES_DEG,
                "kinds": KINDS, "methods": METHODS,
                "bench": bench_of(ALL, ANGLES_DEG[0], DURATION_S, 0)},
        command=COMMAND,
    ),
)  # fmt: skip
