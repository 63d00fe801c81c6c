"""An estimate and its events in, the points and curves of its pictures out."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ssac.camera import Camera, Rig, undistortion_map
from ssac.config import Config
from ssac.estimate import Estimate
from ssac.events import US_PER_S, slice_time
from ssac.geometry.epipolar import epipolar_distance, epipolar_lines_1
from ssac.geometry.fundamental import MIN_PAIRS
from ssac.geometry.pose import rays_of
from ssac.search.offset_search import mean_epipolar_distance
from ssac.search.two_views import TwoViews
from ssac.track.motion import Motion

Array = NDArray[np.float64]

_SEARCH_STEP_S = 2e-3
_STRETCH_PER_OFFSET = 20.0  # the stretch of time drawn is so many offsets long
_STRETCH_S = (0.4, 2.0)  # and at least and at most this long
_LEGIBLE_PX = 15.0  # a distance d of this length is seen at a glance
_MAX_POINTS = 6000  # per camera: more would only blot the picture


@dataclass(frozen=True)
class Material:
    """All that a figure may draw."""

    estimate: Estimate
    events: tuple[NDArray[np.void], NDArray[np.void]]  # as the method saw them
    views: TwoViews

    @property
    def motions(self) -> tuple[Motion, Motion]:
        """The object's motion in each view."""
        return self.views.motion1, self.views.motion2

    @property
    def rig(self) -> Rig:
        """Both cameras."""
        return self.views.rig

    @property
    def config(self) -> Config:
        """The method's parameters."""
        return self.views.config


@dataclass(frozen=True)
class EpipolarRow:
    """One row of the epipolar figure: camera 2 is looked at `offset_s` after camera 1."""

    name: str
    offset_s: float
    time_s: float  # camera 1's clock
    p1: Array  # (2,) [px]
    p2: Array  # (2,) [px]
    line_1: Array  # (3,)
    distance_px: float


def clocks(t_d_s: float) -> tuple[tuple[str, float], tuple[str, float]]:
    """Name and offset of the two ways to pair the clocks."""
    return ("clocks as recorded", 0.0), ("clocks aligned", t_d_s)


def search_curve(material: Material) -> tuple[Array, Array]:
    """Offsets and costs that the method tried; d_avg of its F when it kept none."""
    estimate = material.estimate
    if np.isfinite(estimate.costs).any():
        return estimate.candidates_s, estimate.costs
    offsets_s: Array = np.arange(*material.config.offsets_s, _SEARCH_STEP_S, dtype=np.float64)
    return offsets_s, d_avg_px(material, offsets_s)


def d_avg_px(material: Material, offsets_s: Array) -> Array:
    """Eq. 4 with the F of the estimate, at each offset."""
    F = material.estimate.F
    if F is None:
        return np.full(len(offsets_s), np.nan)
    return mean_epipolar_distance(F, material.views.pairs(offsets_s), MIN_PAIRS)


def epipolar_rows(material: Material) -> list[EpipolarRow]:
    """Rows before and after at one sample time; only after where before no time is valid.

    The time is one at which d, before, can be seen well.
    """
    F = np.asarray(material.estimate.F)
    motion1, motion2 = material.motions
    t_d_s = material.estimate.t_d_s
    pairs = material.views.pairs_at(t_d_s)
    times_s = pairs.times_s
    before = motion2.at(times_s)
    pairings = list(clocks(t_d_s))
    if before.valid.any() and abs(t_d_s) > 0.0:
        times_s = times_s[before.valid]
        distances = epipolar_distance(
            F, motion1.at(times_s).positions_px, before.positions_px[before.valid]
        )
    else:
        pairings = pairings[1:]
        distances = epipolar_distance(F, *pairs.points_px)
    time_s = float(times_s[np.argmin(np.abs(distances - _LEGIBLE_PX))])
    rows = []
    for name, offset_s in pairings:
        p1 = motion1.at(np.array([time_s])).positions_px
        p2 = motion2.at(material.views.on_clock_2(np.array([time_s]), offset_s)).positions_px
        line_1, distance_px = epipolar_lines_1(F, p2)[0], float(epipolar_distance(F, p1, p2)[0])
        rows.append(EpipolarRow(name, offset_s, time_s, p1[0], p2[0], line_1, distance_px))
    return rows


def telling_stretch(material: Material) -> tuple[float, float]:
    """Start [s], camera 1's clock, and length [s] of a stretch that both views see well.

    Of all that start at a sample time: where the angle of the epipolar plane varies most.
    """
    t_d_s = material.estimate.t_d_s
    length_s = float(np.clip(_STRETCH_PER_OFFSET * abs(t_d_s), *_STRETCH_S))
    pairs = material.views.pairs(np.array([t_d_s]))
    times_s, valid = pairs.times_s[0], pairs.valid[0]
    length_s = min(length_s, float(times_s[-1] - times_s[0]))
    angles = plane_angles(material, 0, pairs.p1_px[0])
    scores = []
    for start_s in times_s[times_s <= times_s[-1] - length_s]:
        inside = (times_s >= start_s) & (times_s <= start_s + length_s)
        seen = inside & valid
        spread = np.ptp(angles[seen]) if seen.any() else 0.0
        scores.append(spread * (np.count_nonzero(seen) / np.count_nonzero(inside)) ** 2)
    return float(times_s[int(np.argmax(scores))]), length_s


def plane_angles(material: Material, camera: int, points: Array) -> Array:
    """Angle (n,) [deg] about the baseline of the epipolar planes of undistorted points (n, 2).

    Zero is the plane of camera 1's line of sight.
    """
    R, t = np.asarray(material.estimate.R), np.asarray(material.estimate.t)
    K = (material.rig.cam1, material.rig.cam2)[camera].K
    rays = rays_of(K, points)
    if camera == 1:
        rays = rays @ R  # from camera 2's frame to camera 1's
    baseline = R.T @ t
    ahead = np.array([0.0, 0.0, 1.0]) - baseline[2] * baseline
    ahead /= np.linalg.norm(ahead)
    across = np.cross(ahead, baseline)
    return np.asarray(np.degrees(np.arctan2(rays @ across, rays @ ahead)))


def points_in_time(
    material: Material, camera: int, start_s: float, length_s: float
) -> tuple[Array, Array]:
    """Thin a stretch of events to times (n,) [s] and undistorted positions (n, 2) [px]."""
    events = window(material, camera, start_s + 0.5 * length_s, 0.5 * length_s)
    events = events[:: max(1, len(events) // _MAX_POINTS)]
    points = undistorted(events, (material.rig.cam1, material.rig.cam2)[camera])
    return events["t"] / US_PER_S, points


def window(
    material: Material, camera: int, time_s: float, half_length_s: float
) -> NDArray[np.void]:
    """Return the events of camera 0 or 1 around a time of its own clock."""
    bounds_us = (round((time_s + side * half_length_s) * US_PER_S) for side in (-1, 1))
    return slice_time(material.events[camera], *bounds_us)


def undistorted(events: NDArray[np.void], camera: Camera) -> Array:
    """Positions (n, 2) [px] without distortion; NaN where the lens model has none."""
    if camera.distortion_model == "none":
        return np.stack([events["x"], events["y"]], axis=1).astype(np.float64)
    return np.asarray(undistortion_map(camera)[events["y"], events["x"]])


def has_curve(material: Material) -> bool:
    """Tell whether there is a cost curve to draw."""
    return bool(np.isfinite(material.estimate.costs).any()) or has_fit(material)


def has_fit(material: Material) -> bool:
    """Tell whether there are an offset and an F."""
    return material.estimate.F is not None and bool(np.isfinite(material.estimate.t_d_s))


def has_pose(material: Material) -> bool:
    """Tell whether there are an offset and a pose."""
    return has_fit(material) and material.estimate.R is not None
