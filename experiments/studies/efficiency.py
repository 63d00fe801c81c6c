"""How near methods come to the Cramer-Rao bound of the tables' flights (`worlds.bound`).

What is measured is the bound of each flight and method; the errors beside it are those of
results/runs.csv. The efficiency is the bound's root mean square over the flights over that of the
errors.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from experiments.lab.cache import Cache
from experiments.lab.cell import FlightCell, Measure
from experiments.lab.grid import named_config
from experiments.lab.recorded import load_pair
from experiments.lab.results import Results
from experiments.lab.study import Made, Runs, Study
from experiments.paper.esim import in_order
from experiments.paper.grids import TABLES
from experiments.paper.quantities import ERRORS
from experiments.worlds.bound import KNOWN_POSE, SAMPLES, TrueMotion, load_truth, method_bounds
from ssac.config import Config
from ssac.pipeline.chain import Chain
from ssac.search.two_views import TwoViews

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FLIGHT = ("duration_s", "angle_deg", "flight", "method")
"""Columns that name a bound."""

CELL = ("duration_s", "angle_deg", "t_d_ms", "method")

UNITS = {error.parameter: error.unit for error in ERRORS.values()}
"""Of the errors of t_d, R and t."""


@dataclass(frozen=True)
class BoundCell(FlightCell):
    """A method on a flight; the offset moves its samples and does not change the bound."""

    estimator: Config
    method: str  # of SAMPLES

    @property
    def columns(self) -> dict[str, Any]:
        """As the tables' runs name them."""
        return {**self.flown, "method": self.method}

    @property
    def inputs(self) -> tuple[Any, ...]:
        """What the bound depends on beside the recording."""
        return self.estimator, self.method


@dataclass(frozen=True)
class BoundRow:
    """The bound of a method on a flight; NaN for the pose where it is given."""

    status: str
    reason: str = ""
    sigma_px: float = np.nan  # measured noise of a sample of median weight
    n_samples: int = 0  # that the bound counts
    t_d_bound_ms: float = np.nan
    r_bound_deg: float = np.nan
    t_bound_deg: float = np.nan


@dataclass(frozen=True)
class Flown:
    """A flight as the methods see it, and as it was."""

    views: TwoViews
    truth: TrueMotion


def load_flown(cells: Sequence[BoundCell], cache: Cache) -> Flown:
    """Load a flight."""
    folder = cache.recording_folder(cells[0].sim, cells[0].seed)
    cam1, cam2, rig = load_pair(folder)
    return Flown(Chain((cam1, cam2), rig, cells[0].estimator).views(), load_truth(folder))


def bound_row(cell: BoundCell, flown: Flown) -> BoundRow:
    """Find the bound of one method."""
    of_method = method_bounds([cell.method], flown.views, flown.truth)[cell.method]
    given = cell.method in KNOWN_POSE
    return BoundRow(
        "ok",
        sigma_px=of_method.sigma_px,
        n_samples=of_method.n_samples,
        t_d_bound_ms=1e3 * of_method.bound.t_d_s,
        r_bound_deg=np.nan if given else float(np.rad2deg(of_method.bound.R_rad)),
        t_bound_deg=np.nan if given else float(np.rad2deg(of_method.bound.t_rad)),
    )


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
    return in_order(both, ["duration_s", "angle_deg", "t_d_ms", "flight", "method"])


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


def summary(results: Results) -> pd.DataFrame:
    """Sum up the tables' runs beside the bounds."""
    beside = runs_beside_bounds(results.table("runs"), results.table("efficiency_runs"))
    return efficiency_table(beside)


def figure(results: Results) -> "Figure":
    """Draw each method's errors and bounds."""
    from experiments.drawing.errors import efficiency_figure

    return efficiency_figure(results.table("efficiency"))


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
        (Made("efficiency.csv", summary), Made("efficiency.png", figure)),
        numbers={f"bound.{m}": partial(share, method=m) for m in ("ssac", "joint", "tangency")},
        config={"tables": TABLES, "methods": list(SAMPLES)},
        reads=("runs.csv",),
    ),
)
