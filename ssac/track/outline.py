"""The two tangents of an object's outline along the epipolar planes, in one camera's events.

The epipolar planes of two cameras are a pencil: they all hold the baseline, and an angle about it
tells one from another. Whatever the object's shape, the two planes that just touch it are the same
for both cameras. They touch it in points of its outline, the frontier points, whose images in the
two views satisfy p2' F p1 = 0, as if they were images of one point.

In a view such a tangent is the extreme of the angles of the object's events. It moves, so the
events of a window are first moved back along the tangent's course: along the track's in a first
pass over short windows, then along the smoothed course found there, over longer windows.
`docs/tangency.md` says why.
"""

from dataclasses import dataclass

import numba
import numpy as np
from scipy.ndimage import minimum_filter1d

from ssac.arrays import Array, Indices, Int32Array, IntArray, Mask
from ssac.events import first_from
from ssac.geometry.pose import Pencil
from ssac.rules import OutlineRules
from ssac.track.motion import TIE_US, ObjectMotion


@dataclass(frozen=True)
class OutlineEvents:
    """Events of one camera near one tangent, and the course that their angles are measured from."""

    times_us: IntArray  # (m,) [us], sorted
    points_px: Array  # (m, 2) undistorted
    on_border: Mask  # (m,)
    course_rad: Array  # (n,) at the sample times, from the track's angle, positive outwards


@dataclass(frozen=True)
class Tangents:
    """The tangent on one side of the object, at n instants of the camera's clock."""

    points_px: Array  # (n, 2) where it touches the outline
    velocities_px_s: Array  # (n, 2) of the tangent, perpendicular to itself
    spreads_px: Array  # (n,) distances between the two ranks' events: blur of the outline
    valid: Mask  # (n,)


def near_outline(
    motion: ObjectMotion, pencil: Pencil, times_s: Array, config: OutlineRules
) -> list[OutlineEvents]:
    """Find the courses of the upper and of the lower tangent, and the events near each.

    `tangents` needs only these few events, even for a pencil and times that differ a little.
    """
    course = _Course.of(motion, pencil, times_s, config)
    blocks = _Blocks.of(motion.times_us, course)
    sums_px = motion.position_sums_px  # positions of all events would take as much memory again
    values = blocks.angles(sums_px, course.angles_rad)
    kept = []
    for side in (1.0, -1.0):
        found_rad, _, _ = blocks.extremes(values, side, config.rough_half_window_s)
        rough_rad = _within(found_rad, config.max_angle_rad)
        lowest_rad = _filled(times_s, rough_rad) - config.rough_margin_px * course.rad_per_px
        chosen = above_limit(values, blocks.bounds, side, blocks.at_edges(np.tan(lowest_rad)))
        events = OutlineEvents(
            motion.times_us.take(chosen),
            # `take` is several times as fast as an index.
            sums_px.take(chosen + 1, axis=0) - sums_px.take(chosen, axis=0),
            motion.border_sums.take(chosen + 1) > motion.border_sums.take(chosen),
            _filled(times_s, course.smoothed(rough_rad)[0])
            if config.passes
            else np.zeros(len(times_s)),
        )
        for _ in range(config.passes - 1):
            events = _followed(side, events, course)
        kept.append(events)
    return kept


def tangents(
    motion: ObjectMotion,
    near: list[OutlineEvents],
    pencil: Pencil,
    times_s: Array,
    config: OutlineRules,
) -> list[Tangents]:
    """Find the upper and the lower tangent of the object's outline, that of greater angle first.

    Times (n,) [s], n > 1, ascend by equal steps in this camera's clock. A tangent is invalid where
    the track is, when the event that gives it is on the border, or close to the epipole.
    """
    course = _Course.of(motion, pencil, times_s, config)
    sides = zip((1.0, -1.0), near, strict=True)
    return [_tangent(side, events, course) for side, events in sides]


@dataclass(frozen=True)
class _Course:
    """The track's angles in a pencil, from which the angles of the events are measured."""

    pencil: Pencil
    config: OutlineRules
    times_s: Array  # (n,)
    angles_rad: Array  # (n,) without jumps, and interpolated where the track is invalid
    rad_per_px: Array  # (n,) across the planes, also interpolated
    velocities_px_s: Array  # (n, 2) of the track; zero where it is unknown
    valid: Mask  # (n,)

    def smoothed(self, angles_rad: Array) -> tuple[Array, Array]:
        """Smooth angles (n,) over two or more steps on each side; return their slopes too."""
        return local_parabolas(angles_rad, max(self.steps(self.config.smoothing_s), 2))

    def steps(self, duration_s: float) -> int:
        """Sample steps in a duration."""
        step_s = float(self.times_s[-1] - self.times_s[0]) / (len(self.times_s) - 1)
        return round(duration_s / step_s)

    @staticmethod
    def of(motion: ObjectMotion, pencil: Pencil, times_s: Array, config: OutlineRules) -> "_Course":
        track = motion.centred_at(times_s) if config.centred else motion.at(times_s)
        points_px = np.where(track.valid[:, None], track.positions_px, np.nan)
        angles = np.full(len(times_s), np.nan)
        angles[track.valid] = np.unwrap(pencil.angles(points_px[track.valid]))
        return _Course(
            pencil,
            config,
            times_s,
            _filled(times_s, angles),
            _filled(times_s, np.linalg.norm(pencil.gradients(points_px), axis=1)),
            np.nan_to_num(np.gradient(points_px, times_s, axis=0)),
            track.valid,
        )


_Extremes = tuple[Array, Array, Indices]
"""Extremes of the outline in a window about each of n times: angles (n,) [rad] from the course,
NaN with too few events; gaps (n,) [rad] between the ranks; indices (n,) of the first's events."""


@dataclass(frozen=True)
class _Blocks:
    """Events in blocks of half a sample step; the samples' windows begin and end at block edges."""

    course: _Course
    times_us: IntArray  # (m,) of the events
    padding: int  # blocks before the first sample and after the last
    edges_us: Array  # (b + 1,)
    bounds: Indices  # (b + 1,) index of the first event at or after each edge

    @staticmethod
    def of(events_us: IntArray, course: _Course) -> "_Blocks":
        config, times_s, n = course.config, course.times_s, len(course.times_s)
        length_us = 1e6 * (times_s[-1] - times_s[0]) / (n - 1) / 2
        longest_s = max(config.half_window_s, config.rough_half_window_s)
        padding = max(round(1e6 * longest_s / length_us), 1)
        numbers = np.arange(-padding, 2 * (n - 1) + padding + 1)
        edges_us = 1e6 * times_s[0] + length_us * numbers
        bounds = first_from(events_us, edges_us - TIE_US)
        return _Blocks(course, events_us, padding, edges_us, bounds)

    def at_edges(self, values: Array) -> Array:
        """Interpolate values at the samples to the block edges; constant beyond the samples."""
        return np.asarray(np.interp(1e-6 * self.edges_us, self.course.times_s, values))

    def angles(self, points_px: Array, course_rad: Array) -> Array:
        """Return tan (m,) of the angles of the events from a course (n,)."""
        pencil = self.course.pencil
        edges = self.bounds, self.edges_us, self.at_edges(course_rad)
        return angles_from_course(self.times_us, points_px, *edges, pencil.sine, pencil.cosine)

    def extremes(self, values: Array, side: float, half_window_s: float) -> _Extremes:
        """Find the extremes of the outline in the windows about the samples of a valid track."""
        config, usable = self.course.config, self.course.valid
        # The very highest value may be noise. Any rank lies inside the outline, the more so the
        # fewer events there are near it; the gap to a deeper rank tells how much.
        half = max(round(1e6 * half_window_s / (self.edges_us[1] - self.edges_us[0])), 1)
        firsts = self.padding + 2 * np.arange(len(usable)) - half
        starts, ends = self.bounds[firsts], self.bounds[firsts + 2 * half * usable]
        tops, at = highest_in_windows(values, starts, ends, side, config.deeper_rank + 1)
        is_full = tops[:, -1] > -np.inf
        ranked = np.where(is_full, np.arctan(tops[:, [config.rank, -1]]).T, np.nan)
        gaps = ranked[0] - ranked[1]
        return ranked[0] + config.outward * gaps, gaps, np.where(is_full, at[:, config.rank], 0)


def _ranked(
    side: float, events: OutlineEvents, course: _Course
) -> tuple[_Blocks, Array, _Extremes]:
    """Return tan of the events' angles from the known course of their tangent, and the extremes."""
    blocks = _Blocks.of(events.times_us, course)
    course_rad = course.angles_rad + side * events.course_rad
    values = blocks.angles(events.points_px, course_rad)
    return blocks, values, blocks.extremes(values, side, course.config.half_window_s)


def _followed(side: float, events: OutlineEvents, course: _Course) -> OutlineEvents:
    """Refine a tangent's course, and keep the events that can still be of one of the ranks."""
    config = course.config
    blocks, values, (found_rad, gaps_rad, _) = _ranked(side, events, course)
    deeper_rad = found_rad - (1.0 + config.outward) * gaps_rad
    lowest_rad = _filled(course.times_s, deeper_rad) - config.margin_px * course.rad_per_px
    lowest_rad = minimum_filter1d(lowest_rad, 2 * course.steps(config.half_window_s) + 1)
    chosen = above_limit(values, blocks.bounds, side, blocks.at_edges(np.tan(lowest_rad)))
    angles_rad = _within(events.course_rad + found_rad, config.max_angle_rad)
    return OutlineEvents(
        events.times_us.take(chosen),
        events.points_px.take(chosen, axis=0),
        events.on_border.take(chosen),
        _filled(course.times_s, course.smoothed(angles_rad)[0]),
    )


def _tangent(side: float, events: OutlineEvents, course: _Course) -> Tangents:
    """Find the upper (side 1) or the lower (side -1) tangent."""
    pencil, config, times_s, n = course.pencil, course.config, course.times_s, len(course.times_s)
    if len(events.times_us) == 0:
        nothing = np.full((n, 2), np.nan)
        return Tangents(nothing, nothing, nothing[:, 0], np.zeros(n, np.bool_))
    _, _, (found_rad, gaps_rad, at) = _ranked(side, events, course)
    angles_rad = _within(events.course_rad + found_rad, config.max_angle_rad)
    tangent_rad = course.angles_rad + side * angles_rad
    _, slopes = course.smoothed(tangent_rad)

    # The event, moved with the track's velocity, tells well enough where the tangent touches.
    ages_s = 1e-6 * events.times_us[at] - times_s
    points = events.points_px[at] - ages_s[:, None] * course.velocities_px_s
    gradients = pencil.gradients(points)
    across = gradients / np.sum(gradients**2, axis=1)[:, None]  # [px/rad]
    turn_rad = tangent_rad - pencil.angles(points)
    turn_rad -= 2.0 * np.pi * np.rint(turn_rad / (2.0 * np.pi))
    shifts = turn_rad[:, None] * across
    valid = np.isfinite(slopes) & (np.linalg.norm(shifts, axis=1) < config.max_shift_px)
    # A pixel makes its first event when it is partly covered, and its last when nearly left.
    velocities = (slopes / (times_s[1] - times_s[0]))[:, None] * across
    speeds = np.linalg.norm(velocities, axis=1)[:, None] + 1e-9
    return Tangents(
        points + shifts + config.ahead_px * velocities / speeds,
        velocities,
        gaps_rad * np.linalg.norm(across, axis=1),
        valid & ~events.on_border[at],
    )


def _within(angles: Array, limit: float) -> Array:
    return np.asarray(np.where(np.abs(angles) < limit, angles, np.nan))


def _filled(times_s: Array, values: Array) -> Array:
    """Interpolate where values are NaN; zero when all are."""
    known = np.isfinite(values)
    if not known.any():
        return np.zeros(len(values))
    return np.asarray(np.interp(times_s, times_s[known], values[known]))


_TIE = 1e-12
"""Difference of tan that rounding may cause, as a row of pixels may be an epipolar line: the
earlier event then counts as the higher."""


@numba.njit(cache=True, error_model="numpy")
def angles_from_course(
    times_us: IntArray,
    points_px: Array,
    bounds: Indices,
    edges_us: Array,
    course: Array,
    sine: Array,
    cosine: Array,
) -> Array:
    """Return tan (n,) of the angles of n events from a course; NaN when more than 90 deg from it.

    The events of block i are those from bounds[i] (b + 1,) up to bounds[i + 1]; the values of
    events in no block are not set. The course (b + 1,) [rad] is given at the blocks' edges,
    between which its direction is interpolated; sine and cosine (3,) are the pencil's. Points are
    (n, 2), or their cumulative sums from zero on (n + 1, 2).
    """
    out = np.empty(len(times_us))
    are_summed = len(points_px) > len(times_us)
    s0, s1, s2 = sine[0], sine[1], sine[2]
    c0, c1, c2 = cosine[0], cosine[1], cosine[2]
    for i in range(len(bounds) - 1):
        own = slice(bounds[i], bounds[i + 1])
        points, ages_us, found = points_px[own], times_us[own] - edges_us[i], out[own]
        if are_summed:
            points = points_px[bounds[i] + 1 : bounds[i + 1] + 1] - points
        length_us = edges_us[i + 1] - edges_us[i]
        sin_start, cos_start = np.sin(course[i]), np.cos(course[i])
        sin_slope = (np.sin(course[i + 1]) - sin_start) / length_us
        cos_slope = (np.cos(course[i + 1]) - cos_start) / length_us
        # The loop uses only local variables, so that it compiles to vector instructions.
        for k in range(len(ages_us)):
            s = s0 * points[k, 0] + s1 * points[k, 1] + s2
            c = c0 * points[k, 0] + c1 * points[k, 1] + c2
            course_s = sin_start + ages_us[k] * sin_slope
            course_c = cos_start + ages_us[k] * cos_slope
            ahead = s * course_s + c * course_c
            tangent = (s * course_c - c * course_s) / ahead
            found[k] = tangent if ahead > 0.0 else np.nan  # beyond 90 deg
    return out


@numba.njit(cache=True)
def highest_in_windows(
    values: Array, starts: Indices, ends: Indices, side: float, depth: int
) -> tuple[Array, Indices]:
    """Find the highest side * values of n windows, descending: values and indices (n, depth).

    Minus infinity where a window has fewer. NaN is never among them.
    """
    n = len(starts)
    tops, at = np.full((n, depth), -np.inf), np.zeros((n, depth), np.intp)
    for i in range(n):
        least = -np.inf
        for k in range(starts[i], ends[i]):
            if side * values[k] > least:
                _insert(side * values[k], k, tops[i], at[i])
                least = tops[i, depth - 1] + _TIE
    return tops, at


@numba.njit(cache=True)
def _insert(value: float, index: int, top: Array, at: Indices) -> None:
    """Insert a value, in place, into the descending `top`; the last value drops out."""
    j = len(top) - 1
    while j > 0 and top[j - 1] < value - _TIE:
        top[j], at[j] = top[j - 1], at[j - 1]
        j -= 1
    top[j], at[j] = value, index


@numba.njit(cache=True)
def above_limit(values: Array, bounds: Indices, side: float, limits: Array) -> Int32Array:
    """Pick the events whose side * value is above the lower of the limits at their block's ends."""
    found = np.empty(len(values) + 1, np.int32)
    n = 0
    for i in range(len(bounds) - 1):
        limit = min(limits[i], limits[i + 1])
        for k in range(bounds[i], bounds[i + 1]):
            found[np.uint32(n)] = k  # overwritten if not above: no branch to predict
            n += side * values[k] > limit
    return found[:n].copy()


@numba.njit(cache=True)
def local_parabolas(values: Array, reach: int) -> tuple[Array, Array]:
    """Value and slope per step (n,) of parabolas fitted about each of n even samples.

    The weights are tricube over `reach` samples on each side. NaN where the sample itself is NaN,
    or where fewer than half of those around it are known.
    """
    n = len(values)
    smooth, slopes = np.full(n, np.nan), np.full(n, np.nan)
    for i in range(n):
        if np.isnan(values[i]):
            continue
        known = 0
        moments, sums = np.zeros(5), np.zeros(3)
        for j in range(max(i - reach, 0), min(i + reach + 1, n)):
            if np.isnan(values[j]):
                continue
            known += 1
            lag = (j - i) / (reach + 1.0)
            term = (1.0 - abs(lag) ** 3) ** 3
            for power in range(5):
                moments[power] += term
                if power < 3:
                    sums[power] += term * (values[j] - values[i])
                term *= lag
        if known < reach + 1:
            continue
        m0, m1, m2, m3, m4 = moments
        # Cofactors of the symmetric matrix of moments.
        c00, c01, c02 = m2 * m4 - m3 * m3, m2 * m3 - m1 * m4, m1 * m3 - m2 * m2
        c11, c12 = m0 * m4 - m2 * m2, m1 * m2 - m0 * m3
        determinant = m0 * c00 + m1 * c01 + m2 * c02
        smooth[i] = values[i] + (c00 * sums[0] + c01 * sums[1] + c02 * sums[2]) / determinant
        slope = (c01 * sums[0] + c11 * sums[1] + c12 * sums[2]) / determinant
        slopes[i] = slope / (reach + 1.0)
    return smooth, slopes
