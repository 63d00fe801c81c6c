"""The loops over points behind a point track's motion, compiled."""

import numba
import numpy as np
from numpy.typing import NDArray

MIN_POINTS = 4
"""Of a local fit: one more than a parabola has coefficients."""

_MIN_SIDE = 2  # of them before the sample time and after it: nothing is told beyond an end
_SAME_S = 1e-9
_SINGULAR = 1e-9  # of a scaled determinant


@numba.njit(cache=True)
def local_parabolas(
    times_s: NDArray[np.float64],
    points_px: NDArray[np.float64],
    sigmas_px: NDArray[np.float64],
    wanted_s: NDArray[np.float64],
    half_window_s: float,
    max_gap_s: float,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]:
    """Positions, velocities, deviations and counts of points at m wanted times.

    Parabolas are fitted to the points within the window, weighed by (1 - (age / window)^2)^2 and by
    their deviations. NaN, and a count of 0, in gaps and beyond the ends.
    """
    n, m = len(times_s), len(wanted_s)
    positions, velocities = np.full((m, 2), np.nan), np.full((m, 2), np.nan)
    deviations, counts = np.full(m, np.nan), np.zeros(m, np.int64)
    for k in range(m):
        t_s = wanted_s[k]
        after = np.searchsorted(times_s, t_s)
        if after < _MIN_SIDE or n - after < _MIN_SIDE:
            continue
        if times_s[after] - times_s[after - 1] > max_gap_s:
            continue
        first, last = after, after
        while first > 0 and t_s - times_s[first - 1] < half_window_s:
            first -= 1
        while last < n and times_s[last] - t_s < half_window_s:
            last += 1
        before = after - first + (times_s[after] - t_s < _SAME_S)  # a point there is on both sides
        if before < _MIN_SIDE or last - after < _MIN_SIDE or last - first < MIN_POINTS:
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
        determinant = s0 * (s2 * s4 - s3 * s3) - s1 * (s1 * s4 - s3 * s2) + s2 * (s1 * s3 - s2 * s2)
        if determinant < _SINGULAR * s0**3:
            continue
        for axis in range(2):
            b0, b1, b2 = sums[axis, 0], sums[axis, 1], sums[axis, 2]
            positions[k, axis] = (
                b0 * (s2 * s4 - s3 * s3) - s1 * (b1 * s4 - s3 * b2) + s2 * (b1 * s3 - s2 * b2)
            ) / determinant
            velocities[k, axis] = (
                s0 * (b1 * s4 - b2 * s3) - b0 * (s1 * s4 - s3 * s2) + s2 * (s1 * b2 - b1 * s2)
            ) / (determinant * half_window_s)
        deviations[k] = np.sqrt(variance / total)
        counts[k] = last - first
    return positions, velocities, deviations, counts
