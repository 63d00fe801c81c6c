"""The loop over all offsets, compiled: two tracks on one grid of time in, a cost per lag out."""

import numba
import numpy as np
from numpy.typing import NDArray

from ssac.geometry.fundamental import median_after_fit


@numba.njit(cache=True)
def costs_at_lags(
    p1_px: NDArray[np.float64],
    valid1: NDArray[np.bool_],
    p2_px: NDArray[np.float64],
    valid2: NDArray[np.bool_],
    lags: NDArray[np.int64],
    least_px: tuple[float, float],
    n_pairs: int,
    least_pairs: int,
    iterations: int,
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Cost (m,) of pairing sample i of track 1 with sample i + lag of track 2, and pairs (m,).

    The cost is the median Sampson distance from the F that fits best, over the least of both paths'
    deviations: what an F explains of any two paths whatever is the width of the thinner one. NaN
    below `least_pairs`. An object at rest says nothing, so that a sample counts only when both
    images have moved by `least_px` since the last one that did.
    """
    n1, n2 = len(valid1), len(valid2)
    costs, counts = np.full(len(lags), np.nan), np.zeros(len(lags), np.int64)
    chosen = np.empty(n1, np.int64)
    for m in range(len(lags)):
        lag = lags[m]
        first, last = max(0, -lag), min(n1, n2 - lag)
        count = moving_pairs(p1_px, valid1, p2_px, valid2, lag, first, last, least_px, chosen)
        counts[m] = count
        if count < least_pairs:
            continue
        n = min(count, n_pairs)
        one, other = np.empty((n, 2)), np.empty((n, 2))
        for j in range(n):
            i = chosen[j * count // n]
            one[j], other[j] = p1_px[i], p2_px[i + lag]
        costs[m] = relative_cost(one, other, iterations)
    return costs, counts


@numba.njit(cache=True)
def moving_pairs(
    p1_px: NDArray[np.float64],
    valid1: NDArray[np.bool_],
    p2_px: NDArray[np.float64],
    valid2: NDArray[np.bool_],
    lag: int,
    first: int,
    last: int,
    least_px: tuple[float, float],
    chosen: NDArray[np.int64],
) -> int:
    """Fill in the samples of track 1, from `first` up to `last`, that count; give their number."""
    count = 0
    x1 = y1 = x2 = y2 = 1e12
    for i in range(first, last):
        if not (valid1[i] and valid2[i + lag]):
            continue
        one, other = p1_px[i], p2_px[i + lag]
        if abs(one[0] - x1) + abs(one[1] - y1) < least_px[0]:
            continue
        if abs(other[0] - x2) + abs(other[1] - y2) < least_px[1]:
            continue
        chosen[count] = i
        count += 1
        x1, y1, x2, y2 = one[0], one[1], other[0], other[1]
    return count


@numba.njit(cache=True)
def relative_cost(p1_px: NDArray[np.float64], p2_px: NDArray[np.float64], iterations: int) -> float:
    """Median distance from the F that fits pairs (n, 2) best, over the thinner path's deviation."""
    width_px = min(width_of(p1_px), width_of(p2_px))
    if not width_px > 0.0:
        return np.nan
    return median_after_fit(p1_px, p2_px, iterations) / width_px


@numba.njit(cache=True)
def width_of(points_px: NDArray[np.float64]) -> float:
    """Deviation [px] of points (n, 2) across their longest direction."""
    x, y = points_px[:, 0] - np.mean(points_px[:, 0]), points_px[:, 1] - np.mean(points_px[:, 1])
    xx, yy, xy = np.mean(x * x), np.mean(y * y), np.mean(x * y)
    least = 0.5 * (xx + yy) - np.sqrt(0.25 * (xx - yy) ** 2 + xy * xy)
    width_px: float = np.sqrt(max(least, 0.0))
    return width_px
