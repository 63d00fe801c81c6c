"""Each imperfection alone, and all but each, in; what it costs in t_d, R and t out.

Each recording has a set-up and a calibration of its own, so that a mean is what one may expect of a
bench, not the luck of one. All kinds of a recording share its motion: their differences are of the
imperfection, not of the draw.
"""

from functools import partial
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator

from experiments.drawing.style import WIDTH_IN, method_looks, quiet_axes
from experiments.lab.study import Study, summed_study
from experiments.paper.quantities import ERRORS, T_D_ERROR
from experiments.physical.cells import cells_of, setup_seed
from experiments.physical.imperfections import (
    ALL,
    ANGLES_DEG,
    IMPERFECTIONS,
    KINDS,
    NONE,
    all_but,
    bench_of,
    only,
)
from experiments.physical.measure import PHYSICAL, PhysicalCell
from experiments.physical.mini import COMMAND
from ssac.fit.covariance import NORMAL_95

N_RECORDINGS = 1
"""Of each angle, and each of all kinds. 24 of the 34 kinds are simulated apart: half an hour a
recording at 10 s."""

FIRST_FLIGHT = 20_000  # of no table
DURATION_S = 10.0
T_D_MS = 50.0
METHOD_NAMES = ("ssac", "joint", "tangency")


def budget_cells(n_recordings: int = N_RECORDINGS) -> list[PhysicalCell]:
    """List the three methods on every kind of each recording."""
    return [
        cell
        for angle_deg in ANGLES_DEG
        for flight in range(FIRST_FLIGHT, FIRST_FLIGHT + n_recordings)
        for kind in KINDS
        for cell in cells_of(
            bench_of(kind, angle_deg, DURATION_S, setup_seed(angle_deg, flight)),
            {"kind": kind},
            flight,
            (T_D_MS,),
            METHOD_NAMES,
        )
    ]


def budget_table(runs: pd.DataFrame) -> pd.DataFrame:
    """Mean errors by kind, angle and method.

    Parameters
    ----------
    runs
        One row per cell of `budget_cells`.

    Returns
    -------
    pd.DataFrame
        One row per kind, angle and method in their order: `runs`, `answered` (status "ok"), mean
        and deviation of each error over these, `t_d_bias_ms`, the mean of the signed error of t_d,
        and `t_d_held`, the share of the stated 95 % intervals of t_d that hold the truth.
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


def budget_figure(summary: pd.DataFrame, _: pd.DataFrame) -> Figure:
    """Draw, for each method and error, what each imperfection adds alone and what its lack spares.

    The mean over the angles of each imperfection alone (filled) and of all but it (hollow); lines
    stand where there is none and where there are all.
    """
    means = (
        summary.groupby(["kind", "method"], sort=False)[[f"{name}_mean" for name in ERRORS]]
        .mean()
        .reset_index()
        .set_index(["method", "kind"])
    )
    places = np.arange(len(IMPERFECTIONS))
    height_in = 1.2 + 0.22 * len(places) * len(METHOD_NAMES)
    figure = Figure(figsize=(WIDTH_IN, height_in), layout="constrained")
    grid = figure.subplots(len(METHOD_NAMES), len(ERRORS), sharey=True, squeeze=False)
    for row, method in zip(grid, METHOD_NAMES, strict=True):
        look = method_looks([method])[method]
        for axes, (name, quantity) in zip(row, ERRORS.items(), strict=True):
            quiet_axes(axes)
            values = means.loc[method][f"{name}_mean"]
            axes.plot(values[[only(one) for one in IMPERFECTIONS]], places, "o", ms=5,
                      color=look.color, label="alone")  # fmt: skip
            axes.plot(values[[all_but(one) for one in IMPERFECTIONS]], places, "o", ms=5,
                      color=look.color, mfc="white", label="all but it")  # fmt: skip
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


def budget_study(n_recordings: int = N_RECORDINGS, command: str = COMMAND) -> Study:
    """Give the error budget."""
    return summed_study(
        "error_budget",
        "What each imperfection of a bench costs, alone and of all",
        partial(budget_cells, n_recordings),
        PHYSICAL,
        budget_table,
        keys=("kind", "angle_deg", "flight", "method"),
        draw=budget_figure,
        config={"n_recordings": n_recordings, "first_flight": FIRST_FLIGHT,
                "duration_s": DURATION_S, "t_d_ms": T_D_MS, "angles_deg": ANGLES_DEG,
                "kinds": KINDS, "methods": METHOD_NAMES,
                "bench": bench_of(ALL, ANGLES_DEG[0], DURATION_S, 0)},
        command=command,
    )  # fmt: skip
