"""Compiled loops over events and points, by which an object's motion is sampled."""

import numba
import numpy as np

from ssac.arrays import Array, Indices, Int32Array, IntArray, Pixels


@numba.njit(cache=True)
def sum_up(
    x: Pixels,
    y: Pixels,
    ideal: Array | None,
    border: tuple[int, int, int],
    position_sums_px: Array,
    border_sums: Int32Array,
) -> None:
    """Fill in the sums of an `ObjectMotion` in one pass over n events.

    `ideal` (height, width, 2) holds the undistorted position of each pixel; None: no distortion.
    `border` is the sensor's width and height, and the width of its border [px]. The caller gives
    the arrays, as NumPy allocates them in large pages of memory, which Numba does not: the first
    access to small pages takes as long as all else here.
    """
    width, height, border_px = border
    sum_x, sum_y, n_on_border = 0.0, 0.0, 0
    position_sums_px[0, 0] = position_sums_px[0, 1] = border_sums[0] = 0
    for i in range(len(x)):
        column, row = np.int64(x[i]), np.int64(y[i])
        if ideal is None:
            sum_x, sum_y = sum_x + column, sum_y + row
        else:
            sum_x, sum_y = sum_x + ideal[row, column, 0], sum_y + ideal[row, column, 1]
        position_sums_px[i + 1, 0], position_sums_px[i + 1, 1] = sum_x, sum_y
        n_on_border += bool(min(column, row, width - 1 - column, height - 1 - row) < border_px)
        border_sums[i + 1] = n_on_border


@numba.njit(cache=True)
def mean_times_us(times_us: IntArray, first: Indices, last: Indices) -> Array:
    """Mean (n,) [us] of times from `first` up to `last`, since the first of all; NaN of none."""
    means = np.full(len(first), np.nan)
    for i in range(len(first)):
        if last[i] > first[i]:
            total = 0
            for time_us in times_us[first[i] : last[i]]:
                total += time_us - times_us[0]
            means[i] = total / (last[i] - first[i])
    return means


@numba.njit(cache=True)
def sharp_centres(
    times_us: IntArray,
    position_sums_px: Array,
    first: Indices,
    last: Indices,
    middles_us: Array,
    velocities: Array,
) -> tuple[Array, Array]:
    """Centres (n, 2) [px] and sizes (n,) [px] of windows' event images; velocities in [px/us]."""
    n = len(first)
    flat_px = position_sums_px.ravel()  # a second index would halve the speed of vectors
    centres, sizes = np.empty((n, 2)), np.empty(n)
    counts = np.zeros(0, np.int32)  # events in each cell; all zero between windows
    most = np.max(last - first) if n else 0
    # Of one window: each event's cell at the middle, and the first event of each, in their order.
    columns, rows, firsts = np.empty((3, most + 1), np.int32)
    for i in range(n):
        times, sums = times_us[first[i] : last[i]], flat_px[2 * first[i] : 2 * last[i] + 2]
        n_events, start_us, middle_us = len(times), times[0], middles_us[i]
        v_x, v_y = velocities[i, 0], velocities[i, 1]
        origin_x = (sums[2 * n_events] - sums[0]) / n_events
        origin_y = (sums[2 * n_events + 1] - sums[1]) / n_events
        for j in range(n_events):  # loops of one kind each, and ages under 2**31 us, become vectors
            age_us = np.float64(start_us) + np.int32(times[j] - start_us) - middle_us
            columns[j] = np.rint(sums[2 * j + 2] - sums[2 * j] - v_x * age_us - origin_x)
            rows[j] = np.rint(sums[2 * j + 3] - sums[2 * j + 1] - v_y * age_us - origin_y)
        left = right = columns[0]
        top = bottom = rows[0]
        for j in range(n_events):
            left, right = min(left, columns[j]), max(right, columns[j])
            top, bottom = min(top, rows[j]), max(bottom, rows[j])
        width = right - left + 1
        if width * (bottom - top + 1) > len(counts):
            counts = np.zeros(width * (bottom - top + 1), np.int32)
        n_cells = 0
        for j in range(n_events):
            cell = np.uint64((rows[j] - top) * width + columns[j] - left)  # may not be negative
            firsts[n_cells] = j  # overwritten if it is not the first: no branch to predict
            n_cells += counts[cell] == 0
            counts[cell] += 1
        total, sum_x, sum_y, sum_squares = 0.0, 0.0, 0.0, 0.0
        for j in firsts[:n_cells]:
            cell = np.uint64((rows[j] - top) * width + columns[j] - left)
            weight = np.sqrt(counts[cell])
            counts[cell] = 0
            total += weight
            sum_x, sum_y = sum_x + weight * columns[j], sum_y + weight * rows[j]
            sum_squares += weight * (columns[j] ** 2 + rows[j] ** 2)
        x, y = sum_x / total, sum_y / total
        centres[i, 0], centres[i, 1] = origin_x + x, origin_y + y
        sizes[i] = np.sqrt(max(sum_squares / total - x**2 - y**2, 0.0))
    return centres, sizes


@numba.njit(cache=True)
def local_parabolas_at(
    times_s: Array,
    points_px: Array,
    sigmas_px: Array,
    wanted_s: Array,
    half_window_s: float,
    max_gap_s: float,
) -> tuple[Array, Array, Array, IntArray]:
    """Positions, velocities, deviations and counts of points at m wanted times.

    Parabolas are fitted to the points within the window, weighted by (1 - (age / window)^2)^2 over
    their variances. NaN, and a count of 0, in gaps and beyond the ends: there must be two points on
    each side, and in all one more than a parabola has coefficients.
    """
    n, m, min_side = len(times_s), len(wanted_s), 2
    positions, velocities = np.full((m, 2), np.nan), np.full((m, 2), np.nan)
    deviations, counts = np.full(m, np.nan), np.zeros(m, np.int64)
    for k in range(m):
        t_s = wanted_s[k]
        after = np.searchsorted(times_s, t_s)
        if after < min_side or n - after < min_side:
            continue
        if times_s[after] - times_s[after - 1] > max_gap_s:
            continue
        first, last = after, after
        while first > 0 and t_s - times_s[first - 1] < half_window_s:
            first -= 1
        while last < n and times_s[last] - t_s < half_window_s:
            last += 1
        before = after - first + (times_s[after] - t_s < 1e-9)  # a point there is on both sides
        if before < min_side or last - after < min_side or last - first < 4:
            continue
        s0 = s1 = s2 = s3 = s4 = 0.0
        sums = np.zeros((2, 3))
        variance, total = 0.0, 0.0
        for i in range(first, last):
            age = (times_s[i] - t_s) / half_window_s
            nearness = (1.0 - age * age) ** 2
            weight = nearness / (sigmas_px[i] * sigmas_px[i])
            s0, s1, s2 = s0 + weight, s1 + weight * age, s2 + weight * age**2
            s3, s4 = s3 + weight * age**3, s4 + weight * age**4
            for axis in range(2):
                for power in range(3):
                    sums[axis, power] += weight * points_px[i, axis] * age**power
            variance += nearness * sigmas_px[i] ** 2
            total += nearness
        m0, m1, m2 = s2 * s4 - s3 * s3, s1 * s4 - s3 * s2, s1 * s3 - s2 * s2  # minors
        determinant = s0 * m0 - s1 * m1 + s2 * m2
        if determinant < 1e-9 * s0**3:
            continue
        for axis in range(2):
            b0, b1, b2 = sums[axis]
            c1, c2 = b1 * s4 - s3 * b2, b1 * s3 - s2 * b2
            positions[k, axis] = (b0 * m0 - s1 * c1 + s2 * c2) / determinant
            slope = s0 * c1 - b0 * m1 + s2 * (s1 * b2 - b1 * s2)
            velocities[k, axis] = slope / (determinant * half_window_s)
        deviations[k] = np.sqrt(variance / total)
        counts[k] = last - first
    return positions, velocities, deviations, counts
