"""A network and sightings in; residuals, their derivatives, and the rows of the priors, out."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ssac.geometry.robust import TO_DEVIATION
from ssac.network.graph import Pair, PairTold, shared_by
from ssac.network.normal import Linear
from ssac.network.sightings import Sightings
from ssac.network.spline import Spline, basis
from ssac.network.state import (
    BEHIND,
    CENTRE,
    FOCAL,
    LEAST_DEPTH,
    RATE,
    READOUT,
    STRAYS,
    TRANSLATION,
    CameraState,
    Priors,
    network_times,
    projected,
)

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
Mask = NDArray[np.bool_]

SCALE_STD = 1e-6
"""Deviation, as a share, of the distance that sets the scale: it is none of the data's."""

ASPECT_SHARE = 0.2
"""Deviation of the two focal lengths from each other, in deviations of one: focus changes both."""

BEHIND_PX, BEHIND_STD_PX, BEHIND_OWN_PX = 0.15, 0.08, 0.035
"""Length by which events are behind, its deviation in all cameras alike, and that of each beside:
it is 0.2 px in noisy recordings of small drones, 0.1 px in ideal ones, and within 0.03 px the same
in cameras of one kind (trial flights 900 to 903 of `experiments.outdoor` and `.network`)."""

LEVEL_STD_PX, LEVEL_OWN_PX = 0.03, 0.02
"""The same of silhouettes, which are told from both sides of an edge and are not behind: 0.01 px
(ideal flights 73000 and 74000)."""

_HELD_STRAY_S = 1e-6  # of the strays' offset, and of their slope at the recording's ends


@dataclass(frozen=True, eq=False)
class Network:
    """Cameras, in the order of their sightings, and the path: all in the frame of the first."""

    states: list[CameraState]
    path: Spline
    sigmas_px: Array  # (c,) of each camera's residuals
    jerk: float  # root of its spectral density: unit / s^2.5
    scale_camera: int  # whose distance from the first sets the scale
    distance: float = 1.0  # that
    repeats: float = 1.0  # sightings that tell as much as an independent one: errors last
    lasting: float = 1.0  # the same, with what the path takes up of such errors
    told: Mapping[Pair, PairTold] = field(default_factory=dict)  # by pairs of states


@dataclass(frozen=True, eq=False)
class Fit:
    """Residuals of one camera."""

    residuals_px: Array  # (n, 2) seen less projected
    depths: Array  # (n,)
    used: Mask  # (n,) within the path, in front, and not switched off

    @property
    def rms_px(self) -> float:
        """Robust deviation of a coordinate."""
        return deviation_px(self.residuals_px[self.used])


def border_offsets(network: Network) -> Indices:
    """Give where each camera's parameters begin in the border (c + 1,)."""
    return np.concatenate([[0], np.cumsum([state.size for state in network.states])]).astype(int)


def fit_of(network: Network, k: int, seen: Sightings, enabled: Mask | None = None) -> Fit:
    """Compare what camera k saw with what the network has it see."""
    return linearised(network, k, seen, enabled)[1]


def linearised(
    network: Network, k: int, seen: Sightings, enabled: Mask | None
) -> tuple[Linear, Fit]:
    """Linearise camera k's sightings, not over their deviations yet."""
    state, knots_s = network.states[k], network.path.knots_s
    times_s = network_times(state, seen)
    inside = (times_s >= knots_s[0]) & (times_s <= knots_s[-1])
    if enabled is not None:
        inside &= enabled
    clipped_s = np.clip(times_s, knots_s[0], knots_s[-1])
    first, weights = basis(knots_s, clipped_s)
    slopes = basis(knots_s, clipped_s, 1)[1]
    around = network.path.coefficients[first[:, None] + np.arange(4)]
    points = np.einsum("na,nax->nx", weights, around)
    velocities = np.einsum("na,nax->nx", slopes, around)
    found = projected(state, seen, points, velocities)
    used = inside & (found.depths > LEAST_DEPTH)
    residuals = seen.points_px - found.points_px
    columns = found.columns
    linear = Linear(first, weights, found.by_point, found.by_camera, columns, residuals)
    return linear, Fit(residuals, found.depths, used)


def known(
    network: Network, cameras: list[Sightings], priors: list[Priors], offsets: Indices
) -> tuple[Array, Array]:
    """Give rows (k, b) and residuals (k,) of the priors of the cameras and their pairs."""
    rows, residuals = list[Array](), list[float]()

    def add(places: Indices | list[int], values: Array | list[float], residual: float) -> None:
        row = np.zeros(int(offsets[-1]))
        row[places] = values
        rows.append(row)
        residuals.append(residual)

    # The sightings count in full, so that errors which last are made up for on the other side.
    sharper = 1.0 / np.sqrt(network.repeats)
    for k, (state, prior) in enumerate(zip(network.states, priors, strict=True)):
        at = int(offsets[k])
        told = [(RATE, prior.rate, state.rate - prior.expected_rate)] if k else []
        told += [(READOUT, prior.readout_s, state.readout_s)]
        for i in range(2):
            told += [(FOCAL.start + i, prior.focal[i], float(state.focal[i]))]
            told += [(CENTRE.start + i, prior.centre_px[i], float(state.centre_px[i]))]
        for place, deviation, value in told:
            if deviation > 0.0:
                deviation *= sharper
                add([at + place], [1.0 / deviation], -value / deviation)
        if min(prior.focal) > 0.0:
            deviation = ASPECT_SHARE * sharper * min(prior.focal)
            places = at + np.arange(FOCAL.start, FOCAL.stop)
            off = float(state.focal[0] - state.focal[1])
            add(places, [1.0 / deviation, -1.0 / deviation], -off / deviation)
        n = len(state.strays_s)
        if n:
            places = at + STRAYS + np.arange(n)
            step_s = float(state.knots_s[1] - state.knots_s[0])
            bend_s = sharper * prior.roughness * step_s
            for i in range(n - 2):
                bend = float(np.array([1.0, -2.0, 1.0]) @ state.strays_s[i : i + 3])
                add(places[i : i + 3], np.array([1.0, -2.0, 1.0]) / bend_s, -bend / bend_s)
            slope = np.linspace(-1.0, 1.0, n, dtype=np.float64)
            for mode in (np.full(n, 1.0 / n), slope / np.sum(slope**2)):
                value = float(mode @ state.strays_s)
                add(places, mode / _HELD_STRAY_S, -value / _HELD_STRAY_S)
    of_events = [k for k, seen in enumerate(cameras) if not seen.has_frames]
    values_px = np.array([network.states[k].behind_px for k in of_events])
    by_mean = np.array([cameras[k].spreads_px2 is None for k in of_events], np.bool_)
    common_px = np.where(by_mean, BEHIND_STD_PX, LEVEL_STD_PX)
    weights = _alike_but_for(common_px, np.where(by_mean, BEHIND_OWN_PX, LEVEL_OWN_PX)) / sharper
    off_px = np.where(by_mean, BEHIND_PX, 0.0) - values_px
    for values, residual in zip(weights, weights @ off_px, strict=True):
        add(offsets[of_events] + BEHIND, values, float(residual))
    alike = shared_by(network.told)
    for (a, b), pair in network.told.items():
        by_a, by_b, off_by = pair.rows(network.states[a], network.states[b])
        counts = np.sqrt(network.lasting / alike[a, b])
        for i in range(len(off_by)):
            row = np.zeros(int(offsets[-1]))
            row[offsets[a] : offsets[a + 1]] = counts * by_a[i]
            row[offsets[b] : offsets[b + 1]] = counts * by_b[i]
            rows.append(row)
            residuals.append(float(counts * off_by[i]))
    k = network.scale_camera
    t = network.states[k].t
    length = float(np.linalg.norm(t))
    by_t = t / length**2 / SCALE_STD
    off = np.log(network.distance / length) / SCALE_STD
    add(offsets[k] + np.arange(TRANSLATION.start, TRANSLATION.stop), by_t, off)
    return np.array(rows), np.array(residuals)


def _alike_but_for(common: Array, own: Array) -> Array:
    """Give rows (n, n) over their deviations of n numbers that share one error beside their own."""
    covariance = np.outer(common, common) + np.diag(own**2)
    return np.asarray(np.linalg.inv(np.linalg.cholesky(covariance)), dtype=np.float64)


def deviation_px(residuals_px: Array) -> float:
    """Give the robust deviation [px] of a coordinate."""
    return float(TO_DEVIATION * np.median(np.abs(residuals_px)) if len(residuals_px) else np.nan)
