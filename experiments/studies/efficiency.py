"""How near methods come to the Cramer-Rao bound of the tables' flights (`worlds.bound`).

What is measured is the bound of each flight and method; the errors beside it are those of
results/runs.csv. The efficiency is the bound's root mean square over the flights over that of the
errors.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import pandas as pd

from experiments.drawing.errors import efficiency_figure
from experiments.lab.cache import Cache
from experiments.lab.cell import FlightCell, Measure, RunRow
from experiments.lab.grid import named_config
from experiments.lab.recorded import load_pair
from experiments.lab.results import Results
from experiments.lab.study import Made, Runs, Study
from experiments.lab.summary import answered, by_group, made_of
from experiments.paper.esim import ERRORS, TABLES, in_order
from experiments.worlds.bound import KNOWN_POSE, SAMPLES, TrueMotion, load_truth, method_bound
from ssac.config import Config
from ssac.pipeline.chain import Chain
from ssac.search.two_views import TwoViews

Flown = tuple[TwoViews, TrueMotion]  # a flight as the methods see it, and as it was
FLIGHT = ("duration_s", "angle_deg", "flight", "method")  # columns that name a bound
CELL = ("duration_s", "angle_deg", "t_d_ms", "method")
KINDS = ("bound", "error")

UNITS = {error.parameter: error.unit for error in ERRORS.values()}  # of the errors of t_d, R and t


@dataclass(frozen=True)
class BoundCell(FlightCell):
    """A method on a flight; the offset moves its samples and does not change the bound."""

    estimator: Config
    method: str  # of SAMPLES


@dataclass(frozen=True)
class BoundRow(RunRow):
    """The bound of a method on a flight; NaN for the pose where it is given."""

    sigma_px: float = np.nan  # measured noise of a sample of median weight
    n_samples: int = 0  # that the bound counts
    t_d_bound_ms: float = np.nan
    r_bound_deg: float = np.nan
    t_bound_deg: float = np.nan


def load_flown(cells: Sequence[BoundCell], cache: Cache) -> Flown:
    """Load a flight."""
    folder = cache.recording_folder(cells[0].sim, cells[0].seed)
    cam1, cam2, rig = load_pair(folder)
    return Chain((cam1, cam2), rig, cells[0].estimator).views(), load_truth(folder)


def bound_row(cell: BoundCell, flown: Flown) -> BoundRow:
    """Find the bound of one method."""
    found = method_bound(cell.method, *flown)
    given, of = cell.method in KNOWN_POSE, found.bound
    pose_deg = (np.nan, np.nan) if given else np.rad2deg([of.R_rad, of.t_rad]).tolist()
    return BoundRow("ok", "", found.sigma_px, found.n_samples, 1e3 * of.t_d_s, *pose_deg)


def bound_cells() -> list[BoundCell]:
    """List every method that has a bound, on every flight of the tables, whatever its offset."""
    cells: dict[tuple[Any, ...], BoundCell] = {}
    for cell in (cell for name in TABLES for cell in named_config(name).cells()):
        if cell.method in SAMPLES:
            found = BoundCell(cell.sim, cell.flight, cell.seed, cell.estimator, cell.method)
            cells.setdefault((cell.sim, cell.seed, cell.method), found)
    return list(cells.values())


def runs_beside_bounds(runs: pd.DataFrame, bounds: pd.DataFrame) -> pd.DataFrame:
    """Put the bound of each run that is "ok" beside its errors."""
    found = [f"{parameter}_bound_{unit}" for parameter, unit in UNITS.items()]
    good = answered(runs)[[*FLIGHT, "t_d_ms", *ERRORS]]
    bounded = answered(bounds)[[*FLIGHT, "sigma_px", "n_samples", *found]]
    both = good.merge(bounded, on=list(FLIGHT), how="inner", validate="many_to_one")
    return in_order(both, ["duration_s", "angle_deg", "t_d_ms", "flight", "method"])


def efficiency_table(beside: pd.DataFrame) -> pd.DataFrame:
    """Sum up `runs_beside_bounds` by cell and method: root mean squares, and their ratios."""

    def row(part: pd.DataFrame) -> dict[str, Any]:
        row: dict[str, Any] = {"n_runs": len(part)}
        row |= {name: part[name].mean() for name in ("sigma_px", "n_samples")}
        for one, unit in UNITS.items():
            values = (part[f"{one}_{kind}_{unit}"].to_numpy() for kind in KINDS)
            bound, rms = (float(np.sqrt(np.mean(of_kind**2))) for of_kind in values)
            row |= {f"{one}_bound_{unit}": bound, f"{one}_rms_{unit}": rms}
            row[f"{one}_efficiency"] = bound / rms if rms > 0.0 else np.nan
        return row

    return by_group(beside, CELL, row)


def summary(results: Results) -> pd.DataFrame:
    """Sum up the tables' runs beside the bounds."""
    beside = runs_beside_bounds(results.table("runs"), results.table("efficiency_runs"))
    return efficiency_table(beside)


def share(results: Results, method: str) -> str:
    """Range over the cells of the bound of t_d over the error, for white noise."""
    shares = 100 * results.column("efficiency", "t_d_efficiency", method=method)
    return f"{shares.min():.0f} to {shares.max():.0f} %"


STUDIES = (
    Study(
        "efficiency",
        "Errors of the tables' runs beside the Cramer-Rao bound of their flights",
        bound_cells,
        Measure(load_flown, bound_row, BoundRow),
        Runs("efficiency_runs.csv", FLIGHT),
        (
            Made("efficiency.csv", summary),
            made_of("efficiency.png", efficiency_figure, "efficiency"),
        ),
        numbers={f"bound.{m}": partial(share, method=m) for m in ("ssac", "joint", "tangency")},
        config={"tables": TABLES, "methods": list(SAMPLES)},
        reads=("runs.csv",),
    ),
)
