"""Angles of events from a course, the highest of them in windows, and smoothing: compiled loops.

Time is cut into even blocks. The highest values of a window are among the highest of its blocks, so
that each event is looked at once, however many windows it is in.
"""

import numba
import numpy as np
from numpy.typing import NDArray

from ssac.arrays import Array, Indices, IntArray, Mask

_TIE = 1e-12
"""Differences of tangents that rounding may make: the earlier event then counts as the higher.

Two events of one instant on one epipolar line are a tie, as such a line may be a row of pixels.
"""


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
    """Tangents (n,) of the angles of n events from a course; NaN when more than 90 deg from it.

    The events of block i are those from bounds[i] (b + 1,) up to bounds[i + 1]; the values of
    events in no block are not set. The course (b + 1,) [rad] is that at the blocks' edges, between
    which its direction is interpolated; sine and cosine (3,) are the pencil's.
    """
    out = np.empty(len(times_us))
    for i in range(len(bounds) - 1):
        line = _course_of_block(edges_us, course, i)
        own = slice(bounds[i], bounds[i + 1])
        _tangents(
            points_px[own].reshape(-1), times_us[own], edges_us[i], line, sine, cosine, out[own]
        )
    return out


@numba.njit(cache=True)
def _course_of_block(edges_us: Array, course: Array, i: int) -> tuple[float, float, float, float]:
    """Sine and cosine of the course at the start of block i, and their slopes [1/us]."""
    length_us = edges_us[i + 1] - edges_us[i]
    sin_start, cos_start = np.sin(course[i]), np.cos(course[i])
    sin_slope = (np.sin(course[i + 1]) - sin_start) / length_us
    cos_slope = (np.cos(course[i + 1]) - cos_start) / length_us
    return sin_start, sin_slope, cos_start, cos_slope


@numba.njit(cache=True, error_model="numpy")
def _tangents(
    points_px: Array,
    times_us: IntArray,
    start_us: float,
    line: tuple[float, float, float, float],
    sine: Array,
    cosine: Array,
    out: Array,
) -> None:
    """Fill in the tangents (n,) of the angles of a block's events from its course.

    Points (2 * n,) are x, y by turns. Nothing but numbers of its own in the loop, and no branch:
    it is compiled to vector instructions.
    """
    s0, s1, s2 = sine[0], sine[1], sine[2]
    c0, c1, c2 = cosine[0], cosine[1], cosine[2]
    sin_start, sin_slope, cos_start, cos_slope = line
    for k in range(len(out)):
        x, y, age_us = points_px[2 * k], points_px[2 * k + 1], times_us[k] - start_us
        s = s0 * x + s1 * y + s2
        c = c0 * x + c1 * y + c2
        course_s = sin_start + age_us * sin_slope
        course_c = cos_start + age_us * cos_slope
        ahead = s * course_s + c * course_c
        tangent = (s * course_c - c * course_s) / ahead
        out[k] = tangent if ahead > 0.0 else np.nan  # beyond 90 deg


@numba.njit(cache=True)
def highest_in_blocks(
    values: Array, bounds: Indices, side: float, depth: int
) -> tuple[Array, Indices]:
    """Highest of side * values in each of b blocks, descending: values and indices (b, depth).

    Minus infinity where a block has fewer. NaN is never among them.
    """
    n = len(bounds) - 1
    tops, at = np.full((n, depth), -np.inf), np.zeros((n, depth), np.intp)
    for i in range(n):
        least = -np.inf
        for k in range(bounds[i], bounds[i + 1]):
            if side * values[k] > least:
                _insert(side * values[k], k, tops[i], at[i])
                least = tops[i, depth - 1] + _TIE
    return tops, at


@numba.njit(cache=True)
def ranked_in_windows(
    tops: Array,
    at: Indices,
    firsts: Indices,
    length: int,
    usable: Mask,
    rank: int,
    deeper_rank: int,
) -> tuple[Array, Indices]:
    """Values (n, 2) of two ranks in windows of `length` blocks, and the index of the first's event.

    NaN and 0 where a window is not usable or has fewer events.
    """
    n = len(firsts)
    ranked, indices = np.full((n, 2), np.nan), np.zeros(n, np.intp)
    top, top_at = np.empty(deeper_rank + 1), np.empty(deeper_rank + 1, np.intp)
    for i in range(n):
        if not usable[i]:
            continue
        top[:] = -np.inf
        for block in range(firsts[i], firsts[i] + length):
            for j in range(tops.shape[1]):
                if not tops[block, j] > top[deeper_rank] + _TIE:
                    break
                _insert(tops[block, j], at[block, j], top, top_at)
        if top[deeper_rank] > -np.inf:
            ranked[i, 0], ranked[i, 1], indices[i] = top[rank], top[deeper_rank], top_at[rank]
    return ranked, indices


@numba.njit(cache=True)
def _insert(value: float, index: int, top: Array, at: Indices) -> None:
    """Put a value in its place among the descending ones; the last is lost."""
    j = len(top) - 1
    while j > 0 and top[j - 1] < value - _TIE:
        top[j], at[j] = top[j - 1], at[j - 1]
        j -= 1
    top[j], at[j] = value, index


@numba.njit(cache=True)
def above_limit(values: Array, bounds: Indices, side: float, limits: Array) -> NDArray[np.int32]:
    """Pick the events whose side * value is above the lower of the limits at their block's ends."""
    found = np.empty(len(values) + 1, np.int32)
    n = 0
    for i in range(len(bounds) - 1):
        limit = min(limits[i], limits[i + 1])
        for k in range(bounds[i], bounds[i + 1]):
            found[np.uint32(n)] = k  # and written over, where it is not above: nothing to foresee
            n += side * values[k] > limit
    return found[:n].copy()


@numba.njit(cache=True)
def local_parabolas(values: Array, reach: int) -> tuple[Array, Array]:
    """Value and slope per step (n,) of parabolas fitted about each of n even samples.

    By tricube weights over `reach` samples on each side; NaN, where the sample is itself or fewer
    than half of those around it are known.
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
