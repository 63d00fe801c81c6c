"""The tables' runs and the bounds of their flights in, how near the methods come to these out.

What is measured is the bound of each flight and method; the errors beside it are those of
results/runs.csv. The efficiency is the bound's root mean square over the flights over that of the
errors; `experiments.measures.recording_bound` says what the bound assumes.
"""

from typing import Any

import numpy as np
import pandas as pd

from experiments.drawing.efficiency import efficiency_figure
from experiments.lab.grid import named_config
from experiments.lab.study import summed_study
from experiments.measures.bounds import BOUNDS, BoundCell
from experiments.measures.recording_bound import SAMPLES
from experiments.paper.esim import method_order
from experiments.paper.grids import TABLES
from experiments.paper.quantities import ERRORS

FLIGHT = ("duration_s", "angle_deg", "flight", "method")
"""Columns that name a bound."""

CELL = ("duration_s", "angle_deg", "t_d_ms", "method")

UNITS = {error.parameter: error.unit for error in ERRORS.values()}
"""Of the errors of t_d, R and t."""


def bound_cells() -> list[BoundCell]:
    """List every method that has a bound, on every flight of the tables."""
    cells: dict[tuple[Any, ...], BoundCell] = {}
    for name in TABLES:
        for cell in named_config(name).cells():
            if cell.method in SAMPLES:  # the offset does not enter into the bound
                key = (cell.sim, cell.seed, cell.method)
                found = BoundCell(cell.sim, cell.flight, cell.seed, cell.estimator, cell.method)
                cells.setdefault(key, found)
    return list(cells.values())


def efficiency_of_runs(bounds: pd.DataFrame, runs: pd.DataFrame) -> pd.DataFrame:
    """Put the runs of the tables beside their bounds, and sum up each cell and method.

    Parameters
    ----------
    bounds
        One row for each of `bound_cells`.
    runs
        results/runs.csv.
    """
    return efficiency_table(runs_beside_bounds(runs, bounds))


def runs_beside_bounds(runs: pd.DataFrame, bounds: pd.DataFrame) -> pd.DataFrame:
    """Put the bound of each run that is "ok" beside its errors.

    Returns
    -------
    pd.DataFrame
        In the order of the runs by duration, angle, offset, flight and method: these, `sigma_px`
        (measured noise of a sample of median weight), `n_samples` (that the bound counts), and of
        t_d [ms], R [deg] and t [deg] the bound and the error; NaN for the pose where it was given.
    """
    found = [f"{parameter}_bound_{unit}" for parameter, unit in UNITS.items()]
    good = runs.loc[runs["status"] == "ok", [*FLIGHT, "t_d_ms", *ERRORS]]
    bounded = bounds.loc[bounds["status"] == "ok", [*FLIGHT, "sigma_px", "n_samples", *found]]
    both = good.merge(bounded, on=list(FLIGHT), how="inner", validate="many_to_one")
    place = {name: number for number, name in enumerate(method_order(both["method"]))}
    beside: pd.DataFrame = both.sort_values(
        ["duration_s", "angle_deg", "t_d_ms", "flight", "method"],
        key=lambda column: column.map(place) if column.name == "method" else column,
        ignore_index=True,
    )
    return beside


def efficiency_table(beside: pd.DataFrame) -> pd.DataFrame:
    """Sum up the runs of each cell and method.

    Parameters
    ----------
    beside
        As of `runs_beside_bounds`.

    Returns
    -------
    pd.DataFrame
        The columns CELL, `n_runs` that are "ok", the means of `sigma_px` and `n_samples`, and of
        t_d [ms], R [deg] and t [deg] the root mean squares of bound and error, and their ratio,
        the efficiency; NaN for the pose where it was given.
    """
    rows = []
    for cell, part in beside.groupby(list(CELL), sort=False):
        row: dict[str, Any] = dict(zip(CELL, cell, strict=True))
        row |= {"n_runs": len(part)}
        row |= {name: part[name].mean() for name in ("sigma_px", "n_samples")}
        for parameter, unit in UNITS.items():
            bound, rms = (
                float(np.sqrt(np.mean(part[f"{parameter}_{kind}_{unit}"].to_numpy() ** 2)))
                for kind in ("bound", "error")
            )
            row[f"{parameter}_bound_{unit}"] = bound
            row[f"{parameter}_rms_{unit}"] = rms
            row[f"{parameter}_efficiency"] = bound / rms if rms > 0.0 else np.nan
        rows.append(row)
    table: pd.DataFrame = pd.DataFrame(rows)
    return table


EFFICIENCY = summed_study(
    "efficiency",
    "Errors of the tables' runs beside the Cramer-Rao bound of their flights",
    bound_cells,
    BOUNDS,
    efficiency_of_runs,
    keys=FLIGHT,
    draw=lambda cells, _: efficiency_figure(cells),
    reads=("runs.csv",),
    config={"tables": TABLES, "methods": list(SAMPLES)},
)

STUDIES = (EFFICIENCY,)
