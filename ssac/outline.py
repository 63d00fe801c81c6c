"""One camera's events and a pencil of epipolar planes in, the outline's two tangents out.

The epipolar planes of two cameras are a pencil: they all hold the baseline, and an angle about it
tells one from another. Whatever the object's shape, the two planes that just touch it are the same
for both cameras. They touch it in points of its outline, the frontier points, so those of one view
and of the other are pairs p2' F p1 = 0, as if they were images of one point.

In a view such a tangent is the extreme of the angles of the object's events. It moves, so the
events of a window are first taken back by the tangent's own course: by the track's in a first pass
over short windows, then by the smoothed course that was found, over longer ones. `docs/tangency.md`
has the study behind the constants.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ssac.outline_kernels import interpolated_at, local_parabolas, ranked_in_windows
from ssac.pencil import Pencil
from ssac.tracks import ObjectMotion

Array = NDArray[np.float64]
Indices = NDArray[np.intp]
Mask = NDArray[np.bool_]

MAX_SHIFT_PX = 6.0
"""An event that the track's velocity leaves further than this from its tangent is no part of it."""


@dataclass(frozen=True)
class OutlineConfig:
    """How the outline is found; `docs/tangency.md` has what other values give."""

    rough_half_window_s: float = 0.010  # of events moved by the track's course, not the tangent's
    half_window_s: float = 0.040  # of events moved by the smoothed tangent: more pixels are crossed
    smoothing_s: float = 0.040  # on each side, of the local parabolas that smooth a tangent
    passes: int = 2  # over the longer windows
    rank: int = 2  # from the extreme event, whose rank is 0 and which may be noise
    deeper_rank: int = 10
    outward: float = 0.5  # of the gap between the ranks: how far beyond the first the outline is
    max_angle_rad: float = 0.9  # of a tangent from the track: a pencil says little near the epipole
    margin_px: float = 3.0  # inside the rough outline, up to which events are kept


@dataclass(frozen=True)
class OutlineEvents:
    """Events of one camera, undistorted."""

    times_us: NDArray[np.int64]  # (n,) [us], sorted
    points_px: Array  # (n, 2)
    on_border: Mask  # (n,)

    def only(self, chosen: Mask) -> "OutlineEvents":
        """Return the chosen events."""
        return OutlineEvents(self.times_us[chosen], self.points_px[chosen], self.on_border[chosen])


@dataclass(frozen=True)
class Tangents:
    """The tangent on one side of the object, at n instants of the camera's clock."""

    points_px: Array  # (n, 2) where it touches the outline
    velocities_px_s: Array  # (n, 2) of the tangent, across itself
    spreads_px: Array  # (n,) between events of the two ranks: how blurred the outline is
    valid: Mask  # (n,)


def all_events(motion: ObjectMotion) -> OutlineEvents:
    """Take the events apart again that a motion sums up."""
    return OutlineEvents(
        motion.times_us,
        np.diff(motion.position_sums_px, axis=0),
        np.diff(motion.border_sums) > 0,
    )


def near_outline(
    motion: ObjectMotion, pencil: Pencil, times_s: Array, config: OutlineConfig
) -> list[OutlineEvents]:
    """Keep the events near the upper and near the lower tangent, found from short windows.

    They are few, and all that `tangents` needs, also for a pencil and times a little different.
    """
    course = _Course.of(motion, pencil, times_s)
    events = all_events(motion)
    angles = course.relative_angles(events, pencil)
    kept = []
    for side in (1.0, -1.0):
        half_window_s = config.rough_half_window_s
        rough = _highest(events, side * angles, times_s, half_window_s, course.valid, config)
        limit = _filled(times_s, rough.values - config.margin_px * course.rad_per_px)
        kept.append(events.only(side * angles > interpolated_at(events.times_us, times_s, limit)))
    return kept


def tangents(
    motion: ObjectMotion,
    near: list[OutlineEvents],
    pencil: Pencil,
    times_s: Array,
    config: OutlineConfig,
) -> list[Tangents]:
    """Find the upper and the lower tangent of the object's outline.

    Parameters
    ----------
    motion
        The object's motion; its rules say when a sample is valid.
    near
        From `near_outline`.
    pencil
        Of this camera.
    times_s
        Shape (n,) [s], n > 1, ascending by equal steps, in this camera's clock.
    config
        Parameters.

    Returns
    -------
    list of Tangents
        The one with the greater angle first. A tangent is invalid where the track is, when the
        event that gives it is on the border, or close to the epipole.
    """
    course = _Course.of(motion, pencil, times_s)
    velocities_px_s = motion.velocities_at(times_s)
    return [
        _tangent(side, events, course, velocities_px_s, pencil, config)
        for side, events in zip((1.0, -1.0), near, strict=True)
    ]


@dataclass(frozen=True)
class _Course:
    """The track in a pencil, from whose angles those of events are counted."""

    times_s: Array  # (n,)
    angles_rad: Array  # (n,) without jumps, and interpolated where the track is invalid
    rad_per_px: Array  # (n,) across the planes; NaN where the track is invalid
    valid: Mask  # (n,)

    @staticmethod
    def of(motion: ObjectMotion, pencil: Pencil, times_s: Array) -> "_Course":
        track = motion.at(times_s)
        points_px = np.where(track.valid[:, None], track.positions_px, np.nan)
        angles = np.full(len(times_s), np.nan)
        angles[track.valid] = np.unwrap(pencil.angles(points_px[track.valid]))
        rad_per_px = np.linalg.norm(pencil.gradients(points_px), axis=1)
        return _Course(times_s, _filled(times_s, angles), rad_per_px, track.valid)

    def relative_angles(self, events: OutlineEvents, pencil: Pencil) -> Array:
        """Angles (n,) [rad] of events from the track's at their times, in -pi to pi."""
        angles = pencil.angles(events.points_px)
        angles -= interpolated_at(events.times_us, self.times_s, self.angles_rad)
        return _wrapped(angles)


@dataclass(frozen=True)
class _Extremes:
    """The highest of the values in a window about each of n times."""

    values: Array  # (n,) where the outline is taken to be; NaN without enough events
    gaps: Array  # (n,) between the two ranks
    indices: Indices  # (n,) of the event of the first rank


def _tangent(
    side: float,
    events: OutlineEvents,
    course: _Course,
    velocities_px_s: Array,
    pencil: Pencil,
    config: OutlineConfig,
) -> Tangents:
    """Find the upper (side 1) or the lower (side -1) tangent."""
    times_s, n = course.times_s, len(course.times_s)
    if len(events.times_us) == 0:
        nothing = np.full((n, 2), np.nan)
        return Tangents(nothing, nothing, nothing[:, 0], np.zeros(n, np.bool_))
    step_s = times_s[1] - times_s[0]
    reach = round(config.smoothing_s / step_s)
    angles = side * course.relative_angles(events, pencil)  # counted towards the side
    half_window_s = config.rough_half_window_s
    extremes = _highest(events, angles, times_s, half_window_s, course.valid, config)
    values = _within(extremes.values, config.max_angle_rad)
    for _ in range(config.passes):
        smooth, _ = local_parabolas(values, reach)
        filled = _filled(times_s, smooth)
        excess = angles - interpolated_at(events.times_us, times_s, filled)
        usable = np.isfinite(smooth)
        extremes = _highest(events, excess, times_s, config.half_window_s, usable, config)
        values = _within(filled + extremes.values, config.max_angle_rad)
    tangent_rad = course.angles_rad + side * values
    _, slopes = local_parabolas(tangent_rad, reach)

    # Along the line, the event and the track's velocity say well enough where it touches.
    ages_s = 1e-6 * events.times_us[extremes.indices] - times_s
    points = events.points_px[extremes.indices] - ages_s[:, None] * np.nan_to_num(velocities_px_s)
    gradients = pencil.gradients(points)
    across = gradients / np.sum(gradients**2, axis=1)[:, None]  # [px/rad]
    shifts = _wrapped(tangent_rad - pencil.angles(points))[:, None] * across
    valid = np.isfinite(slopes) & (np.linalg.norm(shifts, axis=1) < MAX_SHIFT_PX)
    return Tangents(
        points + shifts,
        (slopes / step_s)[:, None] * across,
        extremes.gaps * np.linalg.norm(across, axis=1),
        valid & ~events.on_border[extremes.indices],
    )


def _within(angles: Array, limit: float) -> Array:
    return np.asarray(np.where(np.abs(angles) < limit, angles, np.nan))


def _filled(times_s: Array, values: Array) -> Array:
    """Interpolate where values are NaN; zero when all are."""
    known = np.isfinite(values)
    if not known.any():
        return np.zeros(len(values))
    return np.asarray(np.interp(times_s, times_s[known], values[known]))


def _wrapped(angles: Array) -> Array:
    """Bring angles [rad] to -pi to pi."""
    return np.asarray(angles - 2.0 * np.pi * np.rint(angles / (2.0 * np.pi)))


def _highest(
    events: OutlineEvents,
    values: Array,
    times_s: Array,
    half_window_s: float,
    usable: Mask,
    config: OutlineConfig,
) -> _Extremes:
    """Find how far up values reach in the windows about the usable times.

    Not the very highest, which may be noise. Any rank lies inside the outline, the more so the
    fewer events there are near it; the gap to a deeper rank tells how much.
    """
    ranked, indices = ranked_in_windows(
        events.times_us,
        values,
        np.rint(times_s * 1e6).astype(np.int64),
        round(half_window_s * 1e6),
        usable,
        config.rank,
        config.deeper_rank,
    )
    gaps = ranked[:, 0] - ranked[:, 1]
    return _Extremes(ranked[:, 0] + config.outward * gaps, gaps, indices)
