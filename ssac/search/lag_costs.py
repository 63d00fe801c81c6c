"""Two object motions in, a cost for each lag between them on one grid of time out.

The loop over lags is compiled.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from ssac.geometry.fundamental import median_after_fit
from ssac.track.motion import Motion

Array = NDArray[np.float64]
Progress = Callable[[float], None]  # called with the share that is done

LEAST_PAIRS = 40
"""Pairs that a lag leaves at least."""

_MOVED = 0.02  # of a path's extent, between samples that count
_LEAST_SHARE = 0.15  # of the pairs that the longest common path has
_CHUNK = 256  # lags between two calls of `progress`


@dataclass(frozen=True)
class Fit:
    """How thoroughly F is fitted."""

    n_pairs: int
    iterations: int


@dataclass(frozen=True)
class Grid:
    """A track sampled at whole steps of time."""

    first: int  # steps from time zero
    p_px: Array  # (n, 2)
    valid: NDArray[np.bool_]  # (n,)
    least_px: float  # that it moves between samples that count


@dataclass(frozen=True)
class Scan:
    """Costs at all lags, for one rate of camera 2's clock."""

    rate: float
    lags: NDArray[np.int64]  # (m,) of the grids' indices
    shift: int  # to be added to a lag for steps of time
    costs: Array  # (m,) for comparison: the less common path, the more
    most: int  # samples that count, at the best of the lags


def grid_of(motion: Motion, step_s: float, rate: float = 1.0) -> Grid:
    """Sample a track at whole steps of a clock that runs `rate` times slower than its own."""
    start_s, end_s = motion.span_s
    first, last = int(np.ceil(start_s / (rate * step_s))), int(end_s / (rate * step_s))
    track = motion.at(rate * step_s * np.arange(first, last + 1, dtype=np.float64))
    seen = track.positions_px[track.valid]
    extent_px = float(np.sum(np.std(seen, axis=0))) if len(seen) else 0.0
    positions = np.where(track.valid[:, None], track.positions_px, 0.0)
    return Grid(first, positions, track.valid, _MOVED * extent_px)


def scan_lags(one: Grid, other: Grid, rate: float, fit: Fit, progress: Progress | None) -> Scan:
    """Find the costs of all lags at which two paths overlap.

    Parameters
    ----------
    one, other
        Of camera 1 and of camera 2, in steps of one length.
    rate
        Of camera 2's clock, with which it was sampled.
    fit
        How thoroughly F is fitted at each lag.
    progress
        Called now and then with the share that is done; may be None.
    """
    lags = np.arange(-len(one.valid) + 1, len(other.valid), dtype=np.int64)
    costs, counts = np.full(len(lags), np.nan), np.zeros(len(lags), np.int64)
    for start in range(0, len(lags), _CHUNK):
        part = slice(start, start + _CHUNK)
        costs[part], counts[part] = costs_at_lags(
            one.p_px,
            one.valid,
            other.p_px,
            other.valid,
            lags[part],
            (one.least_px, other.least_px),
            fit.n_pairs,
            LEAST_PAIRS,
            fit.iterations,
        )
        if progress is not None:
            progress(min(1.0, (start + _CHUNK) / len(lags)))
    most = int(np.max(counts, initial=0))
    enough = counts >= max(LEAST_PAIRS, _LEAST_SHARE * most)
    weighed = np.where(enough, costs * most / np.maximum(counts, 1), np.nan)
    return Scan(rate, lags, other.first - one.first, weighed, most)


def local_minima(costs: Array, most: int) -> list[int]:
    """Places of the few least local minima of costs (m,), the least first; NaN is none."""
    known = np.where(np.isfinite(costs), costs, np.inf)
    padded = np.pad(known, 1, constant_values=np.inf)
    is_least = (known <= padded[:-2]) & (known < padded[2:]) & np.isfinite(known)
    places = np.flatnonzero(is_least)
    return [int(m) for m in places[np.argsort(known[places], kind="stable")[:most]]]


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
