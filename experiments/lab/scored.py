"""The measure of a grid's cells: it scores a method on a recording with a clock offset."""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from experiments.lab.cache import Cache
from experiments.lab.cell import UNUSABLE, Measure, RunRow
from experiments.lab.grid import Cell
from experiments.lab.recorded import load_pair
from experiments.lab.score import Truth, kept, scored
from ssac.arrays import Array
from ssac.camera import Rig, known_pose
from ssac.errors import SsacError
from ssac.estimate import Estimate, Status
from ssac.events import US_PER_S
from ssac.pipeline.chain import Chain
from ssac.pipeline.opened import IMAGES, MEANS
from ssac.pipeline.registry import METHODS, Input, Method

GUARDED = 10  # one in this many pairs of flight and offset is also run in full, and must agree


@dataclass(frozen=True)
class Row(RunRow):
    """One scored run, or a skipped one; NaN for a quantity that the method does not give."""

    t_d_estimate_ms: float = np.nan
    t_d_error_ms: float = np.nan
    r_error_deg: float = np.nan  # NaN, like t_error_deg, if the method was given the pose
    t_error_deg: float = np.nan
    t_d_std_ms: float = np.nan
    r_std_deg: float = np.nan  # from here to t_2_normalised as in `score.POSE_SCORES`
    t_std_deg: float = np.nan
    r_mahalanobis: float = np.nan
    t_mahalanobis: float = np.nan
    r_x_normalised: float = np.nan
    r_y_normalised: float = np.nan
    r_z_normalised: float = np.nan
    t_1_normalised: float = np.nan
    t_2_normalised: float = np.nan
    n_samples: int = 0
    d_avg_px: float = np.nan
    n_events_cam1: int = 0  # as recorded
    n_events_cam2: int = 0
    skew_ppm: float = np.nan  # estimated; NaN for a method that assumes equal clock rates
    skew_std_ppm: float = np.nan
    skew_error_ppm: float = np.nan  # |estimate - truth|


def load_recorded(cells: Sequence[Cell], cache: Cache) -> Chain:
    """Load the parts of a recording that its cells need; simulate it if the cache lacks it."""
    folder = cache.recording_folder(cells[0].sim, cells[0].seed)
    *seen, rig = load_pair(folder, frames_of(cells))
    return Chain(seen, rig, cells[0].estimator)


def scored_row(cell: Cell, chain: Chain) -> Row:
    """Run one method on one recording, with the cell's offset, and score it."""
    method, chain = METHODS[cell.method], chain.under(cell.estimator)
    n_cam1, n_cam2 = (chain.clean(k).n_recorded for k in range(2))
    reason = chain.lacks(method)
    if reason:
        return Row("skipped", reason, n_events_cam1=n_cam1, n_events_cam2=n_cam2)
    try:
        row = _scored(_estimate(cell, method, chain), cell, chain.rig.pair(0, 1))
    except SsacError as error:
        row = Row(UNUSABLE, " ".join(str(error).split()))
    return replace(row, n_events_cam1=n_cam1, n_events_cam2=n_cam2)


SCORED = Measure(load_recorded, scored_row, Row)
"""Measure of a grid's cells: of tables, ablations, sweeps and coverage."""


def _estimate(cell: Cell, method: Method, chain: Chain) -> Estimate:
    """Estimate with equal clocks and add the cell's offset, or run in full where that is not exact.

    Cells of one flight that search the same interval around their true offsets thus share one run,
    and no row depends on which others are measured. A refusal is run in full: it names offsets.
    """

    def whole() -> Estimate:
        return chain.delayed(cell.t_d_s).estimate(method)

    interval_s = cell.estimator.interval_s
    if not method.follows_clock or cell.t_d_s == 0.0 or interval_s is None:
        return whole()
    shift_s = round(cell.t_d_s * US_PER_S) / US_PER_S  # as `Observation.delayed` rounds
    low, high = (round(bound_s - shift_s, 9) for bound_s in interval_s)
    shared = chain.under(replace(cell.estimator, interval_s=(low, high))).estimate(method)
    if shared.status != Status.OK:
        return whole()
    shared = shared.delayed(shift_s)
    text = f"{cell.seed} {float(cell.t_d_s)!r}"
    if int(hashlib.sha256(text.encode()).hexdigest(), 16) % GUARDED == 0:
        _check_same(shared, whole())
    return shared


def _check_same(shared: Estimate, whole: Estimate) -> None:
    apart = [
        name
        for name in ("n_samples", "t_d_s", "t_d_std_s", "R", "t")
        if not np.allclose(_numbers(shared, name), _numbers(whole, name), 0.0, 1e-9, equal_nan=True)
    ]
    if whole.status != shared.status:
        apart.insert(0, "status")
    if apart:
        raise ArithmeticError(
            f"{whole.method} must follow a delay of camera 2's clock, but run in full it differs in"
            f" {', '.join(apart)}: mend it, or unset its follows_clock in ssac.pipeline.registry"
        )


def _numbers(estimate: Estimate, name: str) -> Array:
    """Return the numbers of a field, NaN for None."""
    return np.array(getattr(estimate, name), np.float64)


def _scored(estimate: Estimate, cell: Cell, rig: Rig) -> Row:
    sim = cell.sim
    truth = Truth(cell.t_d_s, *known_pose(rig), sim.skew_ppm, 0.5 * sim.duration_s)
    has_pose = not METHODS[cell.method].needs_extrinsics
    return Row(**kept(Row, scored(estimate, truth, has_pose)))


def frames_of(cells: Sequence[Cell]) -> str:
    """Return what the cells' methods take of frames: IMAGES, MEANS if these suffice, or nothing."""
    looking = [one for one in (METHODS[cell.method] for cell in cells) if one.input is Input.FRAMES]
    if not looking:
        return ""
    return MEANS if all(method.takes_means for method in looking) else IMAGES
