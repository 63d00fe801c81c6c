"""A network in; what is told of each camera and of the path, with deviations, out."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ssac.clock import PPM
from ssac.estimate import Status
from ssac.network.align import Similarity
from ssac.network.build import Built
from ssac.network.linear import border_offsets, fit_of
from ssac.network.sightings import Sightings, is_near
from ssac.network.spline import basis
from ssac.network.state import (
    DELAY,
    RATE,
    READOUT,
    ROTATION,
    TRANSLATION,
    network_times,
)
from ssac.network.triangulation import LEAST_ANGLE_DEG
from ssac.network.tum import Path

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

REACH_S, REACH_INTERVALS = 0.1, 2.5
"""A camera sees the object at a time where it did so within this, or so many of its intervals."""

_STEP_S = 0.01  # between samples of a path, at least


@dataclass(frozen=True, eq=False)
class CameraAnswer:
    """What is known of one camera; times are of the clock of its group's first camera."""

    name: str
    status: str = Status.OK
    reason: str = ""
    group: int = 0  # 0: none
    t_d_s: float = np.nan
    t_d_std_s: float = np.nan
    t_ref_s: float = np.nan
    skew_ppm: float = np.nan
    skew_std_ppm: float = np.nan
    readout_s: float = np.nan
    readout_std_s: float = np.nan
    R: Array | None = None  # (3, 3) x_k = R x_1 + t
    t: Array | None = None  # (3,)
    r_std_deg: float = np.nan
    t_std: Array | None = None  # (3,) in the unit of t
    knots_s: Array = field(default_factory=lambda: np.empty(0))  # (k,) first camera's clock
    strays_s: Array = field(default_factory=lambda: np.empty(0))  # (k,)
    n_samples: int = 0
    n_seen: int = 0
    rms_px: float = np.nan


@dataclass(frozen=True, eq=False)
class PathAnswer:
    """The object's path in the frame and on the clock of a group's first camera."""

    path: Path
    spans_s: Array  # (k, 2) between which it holds

    @property
    def typical_deviations(self) -> Array:
        """Medians (3,) of the deviations along x, y and z; NaN of an empty path."""
        deviations = self.path.deviations_m
        if deviations is None or not len(deviations):
            return np.full(3, np.nan)
        return np.asarray(np.median(deviations, axis=0))


def answer_of(built: Built, k: int, group: int) -> CameraAnswer:
    """Tell of the k-th camera of a network."""
    state, seen, network = built.network.states[k], built.cameras[k], built.network
    fit = fit_of(network, k, seen, built.enabled[k])
    used_s = network_times(state, seen)[fit.used]
    t_ref_s = 0.5 * float(used_s[0] + used_s[-1])
    own_s = (t_ref_s + state.delay_s - state.rate * state.middle_s) / (1.0 - state.rate)
    at = int(border_offsets(network)[k])
    covariance = built.solved.border_covariance()[at : at + state.size, at : at + state.size]
    covariance = covariance * network.lasting
    by = np.zeros(state.size)
    by[DELAY], by[RATE] = 1.0, own_s - state.middle_s
    by /= 1.0 - state.rate
    deviations = np.sqrt(np.diag(covariance))
    rotation = np.diag(covariance)[ROTATION]
    return CameraAnswer(
        seen.name,
        group=group,
        t_d_s=own_s - t_ref_s,
        t_d_std_s=float(np.sqrt(by @ covariance @ by)),
        t_ref_s=t_ref_s,
        skew_ppm=(1.0 / (1.0 - state.rate) - 1.0) / PPM,
        skew_std_ppm=float(deviations[RATE]) / (1.0 - state.rate) ** 2 / PPM,
        readout_s=(seen.camera.readout_s or 0.0) + state.readout_s,
        readout_std_s=float(deviations[READOUT]),
        R=state.R,
        t=state.t,
        r_std_deg=float(np.rad2deg(np.sqrt(np.sum(rotation)))),
        t_std=deviations[TRANSLATION],
        knots_s=state.network_from_own(state.knots_s),
        strays_s=state.strays_s,
        n_samples=int(np.count_nonzero(fit.used)),
        n_seen=len(seen),
        rms_px=fit.rms_px,
    )


def seen_at(built: Built, times_s: Array) -> Mask:
    """Whether two cameras, whose rays are apart, see the object at times (n,): the path holds."""
    near = np.stack(
        [
            is_near(times_s, network_times(state, seen)[enabled], _reach_s(seen))
            for state, seen, enabled in zip(
                built.network.states, built.cameras, built.enabled, strict=True
            )
        ]
    )
    points = built.network.path.at(times_s)
    rays = np.stack([points - state.centre for state in built.network.states])
    rays /= np.linalg.norm(rays, axis=2, keepdims=True)
    holds = np.zeros(len(times_s), dtype=bool)
    least = np.sin(np.deg2rad(LEAST_ANGLE_DEG))
    for i in range(len(rays)):
        for j in range(i):
            apart = np.linalg.norm(np.cross(rays[i], rays[j]), axis=1) > least
            holds |= near[i] & near[j] & apart
    knots_s = built.network.path.knots_s
    return np.asarray(holds & (times_s >= knots_s[0]) & (times_s <= knots_s[-1]))


def path_at(built: Built, times_s: Array, frame: Similarity | None = None) -> Path:
    """Give the path at times (n,), with its deviations, wherever it holds or not.

    In the frame of the first camera, or in one that a similarity takes that to.
    """
    network = built.network
    first, weights = basis(network.path.knots_s, times_s)
    covariances = built.solved.path_covariances(first, weights) * network.lasting
    points = network.path.at(times_s)
    if frame is not None:
        points = frame.apply(points)
        covariances = frame.scale**2 * frame.R @ covariances @ frame.R.T
    return Path(times_s, points, np.sqrt(np.diagonal(covariances, axis1=1, axis2=2)))


def path_of(built: Built, frame: Similarity | None = None) -> PathAnswer:
    """Sample the path evenly where it holds; in a frame as of `path_at`."""
    knots_s = built.network.path.knots_s
    step_s = max(_STEP_S, min(seen.interval_s for seen in built.cameras))
    times_s = np.arange(knots_s[0], knots_s[-1] + 0.5 * step_s, step_s)
    times_s = np.minimum(times_s, knots_s[-1])
    holds = seen_at(built, times_s)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], holds, [False]]).astype(int)))
    spans_s = np.column_stack([times_s[edges[::2]], times_s[edges[1::2] - 1]])
    return PathAnswer(path_at(built, times_s[holds], frame), spans_s)


def left_out(seen: Sightings, group: int, reason: str) -> CameraAnswer:
    """Tell of a camera that is in no network."""
    return CameraAnswer(seen.name, Status.NO_MATCH, reason, group, n_seen=len(seen))


def _reach_s(seen: Sightings) -> float:
    return max(REACH_S, REACH_INTERVALS * seen.interval_s)
