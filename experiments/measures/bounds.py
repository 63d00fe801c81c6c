"""Flights of the tables and methods in, the least error that the true track allows them out."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from experiments.lab.cache import Cache
from experiments.lab.cell import FlightCell, Measure
from experiments.lab.recorded import load_pair
from experiments.measures.recording_bound import (
    KNOWN_POSE,
    TrueMotion,
    load_truth,
    method_bounds,
)
from ssac.config import Config
from ssac.pipeline.chain import Chain
from ssac.search.two_views import TwoViews


@dataclass(frozen=True)
class BoundCell(FlightCell):
    """A method on a flight; the offset moves its samples and does not change the bound."""

    estimator: Config
    method: str  # of recording_bound.SAMPLES

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


BOUNDS = Measure(load_flown, bound_row, BoundRow)
