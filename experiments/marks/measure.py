"""Recordings of a kind in; what `tangency` says of them, its errors, and its time, out.

The flights are simulated and kept as any others; what spoils them is added when they are loaded.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from experiments.lab.cache import Cache
from experiments.lab.cell import FlightCell, Measure
from experiments.lab.recorded import Pair, recorded_pair
from experiments.lab.score import angle_between_deg, rotation_angle_deg
from experiments.marks.kinds import KINDS, Errors, Kind
from experiments.measures.imperfect import ImperfectRow, scored, spoilt_pair
from experiments.measures.imperfect_kinds import T_D_S
from experiments.measures.imperfect_kinds import Kind as SpoiltKind
from sim.recorded import Drift
from ssac.camera import Camera, Rig, with_deviations
from ssac.config import Config
from ssac.estimate import Estimate
from ssac.pipeline.chain import Chain
from ssac.pipeline.registry import METHODS
from ssac.track.observation import Observation

FloatArray = NDArray[np.float64]

METHOD = "tangency"
"""What `ssac sync` takes unasked."""


@dataclass(frozen=True)
class MarkCell(FlightCell):
    """`tangency` on a kind of recording that is made of a flight."""

    kind: str  # of KINDS
    other_seed: int  # of the other flight, where the kind has one

    @property
    def columns(self) -> dict[str, Any]:
        """Columns that say which run it is."""
        return {"group": KINDS[self.kind].group, "kind": self.kind, **self.flown}

    @property
    def inputs(self) -> tuple[Any, ...]:
        """What the row depends on beside the recording and the code."""
        return self.kind, self.other_seed, METHODS[METHOD].version


@dataclass(frozen=True)
class MarkRow(ImperfectRow):
    """What was said, its errors, and what it took; NaN for what is not given."""

    ends_error_ms: float = np.nan  # of the offset at both ends of the recording, the larger
    ends_normalised: float = np.nan  # over its deviation, the larger of both
    t_d_moved_ms: float = np.nan  # by the rig's errors: from what exact intrinsics give
    r_moved_deg: float = np.nan
    t_moved_deg: float = np.nan
    jump_ms: float = np.nan  # that a clock is said to make
    jump_at_s: float = np.nan  # camera 1's clock
    cpu_s: float = np.nan  # all but reading, on the machine that measured


@dataclass(frozen=True)
class Flown:
    """A flight, another one where a kind has it, and what exact intrinsics give."""

    flight: Pair  # whose clocks show the same
    other: Pair | None
    exact: list[Estimate] = field(default_factory=list)  # at most one


def load_marked(cells: Sequence[MarkCell], cache: Cache) -> Flown:
    """Load the flight, and the other one where a kind has it."""
    sim, other = replace(cells[0].sim, t_d_s=0.0), None
    if any(KINDS[cell.kind].needs_other for cell in cells):
        other = recorded_pair(cache, sim, cells[0].other_seed)
    return Flown(recorded_pair(cache, sim, cells[0].seed), other)


def marked_row(cell: MarkCell, flown: Flown) -> MarkRow:
    """Run `tangency` on a recording of a kind, and score what it says."""
    kind, duration_s = KINDS[cell.kind], cell.sim.spline.duration_s
    pair = marked_pair(flown.flight, flown.other, kind, cell.seed, duration_s)
    config = Config()
    if kind.skew_prior_ppm is not None:
        config = replace(config, skew_prior_ppm=kind.skew_prior_ppm)
    start_s = time.process_time()
    estimate = Chain((pair.cam1, pair.cam2), pair.rig, config).estimate(METHOD)
    cpu_s = time.process_time() - start_s
    t_mid_s = 0.5 * duration_s
    row = scored(estimate, flown.flight.rig, kind.skew_ppm, t_mid_s)
    row = replace(row, n_events_cam1=len(pair.cam1.events), n_events_cam2=len(pair.cam2.events))
    ends_error_ms, ends_normalised = ends_of(estimate, kind.skew_ppm, t_mid_s)
    found = MarkRow(
        **vars(row), ends_error_ms=ends_error_ms, ends_normalised=ends_normalised, cpu_s=cpu_s
    )
    if estimate.jump is not None:
        jump = estimate.jump
        found = replace(found, jump_ms=1e3 * jump.size_s, jump_at_s=jump.at_s)
    if kind.errors != Kind.errors:
        t_d_ms, r_deg, t_deg = _moved(estimate, flown)
        found = replace(found, t_d_moved_ms=t_d_ms, r_moved_deg=r_deg, t_moved_deg=t_deg)
    return found


MARKED = Measure(load_marked, marked_row, MarkRow)


def marked_pair(flight: Pair, other: Pair | None, kind: Kind, seed: int, duration_s: float) -> Pair:
    """Make of a flight what two cameras record of it.

    Parameters
    ----------
    flight, other
        Pairs whose clocks show the same.
    kind
    seed
        Of the flight.
    duration_s
        Of both.

    Returns
    -------
    Pair
        Camera 2's clock shows `T_D_S` more in the middle, and before a jump; the rig is as wrong as
        the kind says, but for its pose, which is the true one.
    """
    if kind.others:
        assert other is not None
        flight, other = Pair(flight.cam1, other.cam2, flight.rig), None
    second = other if kind.disturb.second_object > 0.0 else None
    pair = spoilt_pair(flight, second, SpoiltKind(kind.scene, kind.disturb), seed, duration_s)
    events = pair.cam2.events.copy()
    scene_us = events["t"] - round(1e6 * T_D_S)
    events["t"] += Drift(kind.skew_ppm, 0.5 * duration_s, kind.jump).added_us(scene_us)
    cam1, cam2 = (
        _restated(camera, errors, kind.stated)
        for camera, errors in zip((pair.rig.cam1, pair.rig.cam2), kind.errors, strict=True)
    )
    return Pair(pair.cam1, Observation(events), Rig(cam1, cam2, pair.rig.T_2_1))


def ends_of(estimate: Estimate, skew_ppm: float, t_mid_s: float) -> tuple[float, float]:
    """Give the error of the offset [ms] where a recording begins or ends, and over its deviation.

    Parameters
    ----------
    estimate
    skew_ppm
        The true one.
    t_mid_s
        Where the true offset is `T_D_S`; half the duration.

    Returns
    -------
    tuple of float
        Of both ends the larger each; NaN where no offset is given.
    """
    if not estimate.has_offset:
        return np.nan, np.nan
    ends_s = np.array([0.0, 2.0 * t_mid_s])
    found_s = estimate.clock.cam2_from_cam1(ends_s) - ends_s
    true_s = T_D_S + 1e-6 * skew_ppm * (ends_s - t_mid_s)
    errors_s = np.abs(found_s - true_s)
    sigmas = errors_s / estimate.clock_std_s(ends_s)
    return float(1e3 * np.max(errors_s)), float(np.max(sigmas))


def _restated(camera: Camera, errors: Errors, stated: tuple[float, float] | None) -> Camera:
    """Give a camera with intrinsics that are off, and what is said of them."""
    fu, fv, pu_px, pv_px = errors
    K: FloatArray = camera.K.copy()
    K[0, 0] *= 1.0 + fu
    K[1, 1] *= 1.0 + fv
    K[:2, 2] += pu_px, pv_px
    camera = replace(camera, K=K)
    if stated is None:
        return camera
    percent, centre_px = stated
    return with_deviations(camera, 0.01 * percent, centre_px)


def _moved(estimate: Estimate, flown: Flown) -> tuple[float, float, float]:
    """Give how far t_d [ms], R and t [deg] are from what exact intrinsics give."""
    if not flown.exact:
        cam2 = flown.flight.cam2.delayed(T_D_S)
        flown.exact.append(Chain((flown.flight.cam1, cam2), flown.flight.rig).estimate(METHOD))
    (exact,) = flown.exact
    if estimate.R is None or exact.R is None or estimate.t is None or exact.t is None:
        return np.nan, np.nan, np.nan
    return (
        1e3 * abs(estimate.t_d_s - exact.t_d_s),
        rotation_angle_deg(estimate.R.T @ exact.R),
        angle_between_deg(estimate.t, exact.t),
    )
