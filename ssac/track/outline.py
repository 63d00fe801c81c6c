"""The two tangents of an object's outline along the epipolar planes, in one camera's events.

The epipolar planes of two cameras are a pencil: they all hold the baseline, and an angle about it
tells one from another. Whatever the object's shape, the two planes that just touch it are the same
for both cameras. They touch it in points of its outline, the frontier points, so those of one view
and of the other are pairs p2' F p1 = 0, as if they were images of one point.

In a view such a tangent is the extreme of the angles of the object's events. It moves, so the
events of a window are first taken back by the tangent's own course: by the track's in a first pass
over short windows, then by the smoothed course that was found, over longer ones. `docs/tangency.md`
says why.
"""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import minimum_filter1d

from ssac.arrays import Array, Indices, IntArray, Mask
from ssac.events import first_from
from ssac.geometry.pose import Pencil
from ssac.rules import OutlineRules
from ssac.track.motion import ObjectMotion
from ssac.track.motion_kernels import TIE_US
from ssac.track.outline_kernels import (
    above_limit,
    angles_from_course,
    highest_in_blocks,
    local_parabolas,
    ranked_in_windows,
)

OutlineConfig = OutlineRules


@dataclass(frozen=True)
class OutlineEvents:
    """Events of one camera near one tangent, and the course from which they are ranked."""

    times_us: IntArray  # (m,) [us], sorted
    points_px: Array  # (m, 2) undistorted
    on_border: Mask  # (m,)
    course_rad: Array  # (n,) at the sample times, from the track's angle, towards the side


@dataclass(frozen=True)
class Tangents:
    """The tangent on one side of the object, at n instants of the camera's clock."""

    points_px: Array  # (n, 2) where it touches the outline
    velocities_px_s: Array  # (n, 2) of the tangent, across itself
    spreads_px: Array  # (n,) between events of the two ranks: how blurred the outline is
    valid: Mask  # (n,)


def near_outline(
    motion: ObjectMotion, pencil: Pencil, times_s: Array, config: OutlineConfig
) -> list[OutlineEvents]:
    """Find the courses of the upper and of the lower tangent, and the events near each.

    These few are all that `tangents` needs, also for a pencil and times a little different.
    """
    course = _Course.of(motion, pencil, times_s, config.centred)
    blocks = _Blocks.of(motion.times_us, times_s, config)
    points_px = np.diff(motion.position_sums_px, axis=0)
    values = blocks.angles(points_px, course.angles_rad, pencil)
    kept = []
    for side in (1.0, -1.0):
        rough = blocks.extremes(values, side, config.rough_half_window_s, course.valid, config)
        rough_rad = _within(rough.angles_rad, config.max_angle_rad)
        lowest_rad = _filled(times_s, rough_rad) - config.rough_margin_px * course.rad_per_px
        chosen = above_limit(values, blocks.bounds, side, blocks.at_edges(np.tan(lowest_rad)))
        events = OutlineEvents(
            motion.times_us.take(chosen),
            points_px.take(chosen, axis=0),  # several times as fast as `points_px[chosen]`
            motion.border_sums.take(chosen + 1) > motion.border_sums.take(chosen),
            course.smoothed(rough_rad, config) if config.passes else np.zeros(len(times_s)),
        )
        for _ in range(config.passes - 1):
            events = _followed(side, events, course, pencil, config)
        kept.append(events)
    return kept


def tangents(
    motion: ObjectMotion,
    near: list[OutlineEvents],
    pencil: Pencil,
    times_s: Array,
    config: OutlineConfig,
) -> list[Tangents]:
    """Find the upper and the lower tangent of the object's outline, that of greater angle first.

    Times (n,) [s], n > 1, ascend by equal steps in this camera's clock; `near` is of as many. A
    tangent is invalid where the track is, when the event that gives it is on the border, or close
    to the epipole.
    """
    course = _Course.of(motion, pencil, times_s, config.centred)
    return [
        _tangent(side, events, course, pencil, config)
        for side, events in zip((1.0, -1.0), near, strict=True)
    ]


@dataclass(frozen=True)
class _Course:
    """The track in a pencil, from whose angles those of events are counted."""

    times_s: Array  # (n,)
    angles_rad: Array  # (n,) without jumps, and interpolated where the track is invalid
    rad_per_px: Array  # (n,) across the planes, also interpolated
    velocities_px_s: Array  # (n, 2) of the track; zero where it is unknown
    valid: Mask  # (n,)

    def smoothed(self, angles_rad: Array, config: OutlineConfig) -> Array:
        """Smooth the angles (n,) of a tangent, and interpolate where they are NaN."""
        smooth, _ = local_parabolas(angles_rad, self.reach(config))
        return _filled(self.times_s, smooth)

    def reach(self, config: OutlineConfig) -> int:
        """Sample steps to each side of a parabola: two at least, however short it is to be."""
        return max(self.steps(config.smoothing_s), 2)

    def steps(self, duration_s: float) -> int:
        """Sample steps in a duration."""
        step_s = float(self.times_s[-1] - self.times_s[0]) / (len(self.times_s) - 1)
        return round(duration_s / step_s)

    @staticmethod
    def of(
        motion: ObjectMotion, pencil: Pencil, times_s: Array, centred: bool = False
    ) -> "_Course":
        track = motion.centred_at(times_s) if centred else motion.at(times_s)
        points_px = np.where(track.valid[:, None], track.positions_px, np.nan)
        angles = np.full(len(times_s), np.nan)
        angles[track.valid] = np.unwrap(pencil.angles(points_px[track.valid]))
        return _Course(
            times_s,
            _filled(times_s, angles),
            _filled(times_s, np.linalg.norm(pencil.gradients(points_px), axis=1)),
            np.nan_to_num(np.gradient(points_px, times_s, axis=0)),
            track.valid,
        )


@dataclass(frozen=True)
class _Extremes:
    """How far up the outline reaches in a window about each of n times."""

    angles_rad: Array  # (n,) from the course; NaN without enough events
    gaps_rad: Array  # (n,) between the two ranks
    indices: Indices  # (n,) of the event of the first rank


@dataclass(frozen=True)
class _Blocks:
    """Events in blocks of half a sample step, which begin and end at the samples' windows' ends."""

    times_us: IntArray  # (m,) of the events
    times_s: Array  # (n,) of the samples
    padding: int  # blocks before the first sample and after the last
    edges_us: Array  # (b + 1,)
    bounds: Indices  # (b + 1,) index of the first event at or after each edge

    @staticmethod
    def of(events_us: IntArray, times_s: Array, config: OutlineConfig) -> "_Blocks":
        n = len(times_s)
        length_us = 1e6 * (times_s[-1] - times_s[0]) / (n - 1) / 2
        longest_s = max(config.half_window_s, config.rough_half_window_s)
        padding = max(round(1e6 * longest_s / length_us), 1)
        numbers = np.arange(-padding, 2 * (n - 1) + padding + 1)
        edges_us = 1e6 * times_s[0] + length_us * numbers
        bounds = first_from(events_us, edges_us - TIE_US)
        return _Blocks(events_us, times_s, padding, edges_us, bounds)

    def at_edges(self, values: Array) -> Array:
        """Interpolate what is known at the samples; constant beyond them."""
        return np.asarray(np.interp(1e-6 * self.edges_us, self.times_s, values))

    def angles(self, points_px: Array, course_rad: Array, pencil: Pencil) -> Array:
        """Tangents of the angles (m,) of the events from a course (n,)."""
        edges = self.bounds, self.edges_us, self.at_edges(course_rad)
        return angles_from_course(self.times_us, points_px, *edges, pencil.sine, pencil.cosine)

    def extremes(
        self, values: Array, side: float, half_window_s: float, usable: Mask, config: OutlineConfig
    ) -> _Extremes:
        """Find how far up the outline reaches in the windows about the usable samples.

        Not to the very highest value, which may be noise. Any rank lies inside the outline, the
        more so the fewer events there are near it; the gap to a deeper rank tells how much.
        """
        tops, at = highest_in_blocks(values, self.bounds, side, config.deeper_rank + 1)
        half = max(round(1e6 * half_window_s / (self.edges_us[1] - self.edges_us[0])), 1)
        firsts = self.padding + 2 * np.arange(len(self.times_s)) - half
        ranked, indices = ranked_in_windows(
            tops, at, firsts, 2 * half, usable, config.rank, config.deeper_rank
        )
        ranked = np.arctan(ranked)
        gaps = ranked[:, 0] - ranked[:, 1]
        return _Extremes(ranked[:, 0] + config.outward * gaps, gaps, indices)


def _ranked(
    side: float, events: OutlineEvents, course: _Course, pencil: Pencil, config: OutlineConfig
) -> tuple[_Blocks, Array, _Extremes]:
    """Angles of the events from the known course of their tangent, and their extremes."""
    blocks = _Blocks.of(events.times_us, course.times_s, config)
    course_rad = course.angles_rad + side * events.course_rad
    values = blocks.angles(events.points_px, course_rad, pencil)
    extremes = blocks.extremes(values, side, config.half_window_s, course.valid, config)
    return blocks, values, extremes


def _followed(
    side: float, events: OutlineEvents, course: _Course, pencil: Pencil, config: OutlineConfig
) -> OutlineEvents:
    """Follow a tangent more closely, and keep the events that can then be of one of the ranks."""
    blocks, values, extremes = _ranked(side, events, course, pencil, config)
    deeper_rad = extremes.angles_rad - (1.0 + config.outward) * extremes.gaps_rad
    lowest_rad = _filled(course.times_s, deeper_rad) - config.margin_px * course.rad_per_px
    lowest_rad = minimum_filter1d(lowest_rad, 2 * course.steps(config.half_window_s) + 1)
    chosen = above_limit(values, blocks.bounds, side, blocks.at_edges(np.tan(lowest_rad)))
    angles_rad = _within(events.course_rad + extremes.angles_rad, config.max_angle_rad)
    return OutlineEvents(
        events.times_us.take(chosen),
        events.points_px.take(chosen, axis=0),
        events.on_border.take(chosen),
        course.smoothed(angles_rad, config),
    )


def _tangent(
    side: float, events: OutlineEvents, course: _Course, pencil: Pencil, config: OutlineConfig
) -> Tangents:
    """Find the upper (side 1) or the lower (side -1) tangent."""
    times_s, n = course.times_s, len(course.times_s)
    if len(events.times_us) == 0:
        nothing = np.full((n, 2), np.nan)
        return Tangents(nothing, nothing, nothing[:, 0], np.zeros(n, np.bool_))
    _, _, extremes = _ranked(side, events, course, pencil, config)
    angles_rad = _within(events.course_rad + extremes.angles_rad, config.max_angle_rad)
    tangent_rad = course.angles_rad + side * angles_rad
    _, slopes = local_parabolas(tangent_rad, course.reach(config))

    # Along the line, the event and the track's velocity say well enough where it touches.
    ages_s = 1e-6 * events.times_us[extremes.indices] - times_s
    points = events.points_px[extremes.indices] - ages_s[:, None] * course.velocities_px_s
    gradients = pencil.gradients(points)
    across = gradients / np.sum(gradients**2, axis=1)[:, None]  # [px/rad]
    shifts = _wrapped(tangent_rad - pencil.angles(points))[:, None] * across
    valid = np.isfinite(slopes) & (np.linalg.norm(shifts, axis=1) < config.max_shift_px)
    # A pixel makes its first event when it is partly covered, and its last when nearly left.
    velocities = (slopes / (times_s[1] - times_s[0]))[:, None] * across
    speeds = np.linalg.norm(velocities, axis=1)[:, None] + 1e-9
    return Tangents(
        points + shifts + config.ahead_px * velocities / speeds,
        velocities,
        extremes.gaps_rad * np.linalg.norm(across, axis=1),
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
