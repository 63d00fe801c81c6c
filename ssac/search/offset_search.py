"""The search for the offset of least cost, as in the paper or from coarse to fine."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ssac.geometry.epipolar import epipolar_distance
from ssac.rules import SearchRules
from ssac.search.two_views import Pairs, TwoViews

Array = NDArray[np.float64]
Cost = Callable[[Array], Array]  # offsets (M,) [s] -> d_avg (M,) [px], NaN where it has none

FINE_STEP_S = 0.001
"""Step of the paper's exhaustive search, on whose grid all candidates lie."""

_FIT_STEPS = 6  # fine steps on each side of the minimum, to which a parabola is fitted


@dataclass(frozen=True)
class OffsetSearch:
    """Every candidate tried and the minimum found."""

    candidates_s: Array  # (M,) [s], ascending
    d_avg_px: Array  # (M,) [px], NaN where too few samples are valid
    t_d_s: float  # [s] offset of least d_avg, NaN without any
    at_bound: bool  # the least d_avg is at the first or last candidate: no minimum was enclosed


def mean_epipolar_distance(F: Array, pairs: Pairs, min_pairs: int) -> Array:
    """d_avg (M,) [px] of the paper's Eq. 4 with one F for all offsets; NaN below `min_pairs`."""
    distances = np.where(pairs.valid, epipolar_distance(F, pairs.p1_px, pairs.p2_px), 0.0)
    counts = np.count_nonzero(pairs.valid, axis=1)
    return np.where(counts < min_pairs, np.nan, np.sum(distances, axis=1) / np.maximum(counts, 1))


def candidate_offsets(views: TwoViews) -> Array:
    """Offsets [s], 1 ms apart from the interval's lower bound, at which the recordings overlap.

    Deviation: the paper says nothing of offsets near which little is left of the recordings. A
    short stretch fits almost any F, so an offset is a candidate only when its overlap is at least
    half of the longest in the interval. Empty when no offset gives any overlap.
    """
    low, high = views.config.offsets_s
    n_steps = int(np.floor((high - low) / FINE_STEP_S + 1e-9))
    offsets = low + FINE_STEP_S * np.arange(n_steps + 1, dtype=np.float64)
    start, end = views.overlap_s(offsets)
    lengths = end - start
    least = views.config.rules.search.min_overlap * np.max(lengths, initial=0.0)
    return offsets[(lengths > 0.0) & (lengths >= least)]


def exhaustive_search(cost: Cost, offsets_s: Array) -> OffsetSearch:
    """Evaluate the cost at every offset (M,) [s], as the loops of Algorithms 1 and 2 do."""
    return _minimum(offsets_s, cost(offsets_s), np.ones(len(offsets_s), dtype=np.bool_))


def coarse_to_fine_search(
    coarse_cost: Cost,
    cost: Cost,
    offsets_s: Array,
    coarsest: int,
    rules: SearchRules,
    returns_s: Array | None = None,
) -> OffsetSearch:
    """Find what `exhaustive_search` finds from about a tenth of its candidates.

    Every 20 ms first, then every 5 ms around the three least local minima, both with the coarse
    cost; then every 1 ms around the least of all with the cost itself. The other deep minima of the
    curve are followed to 1 ms as well, with the coarse cost: they are not candidates any more, but
    say whether the least of all has rivals (`observability.valleys`).

    The coarse cost may be cheaper and less robust. Motion that turns back more often than an
    ordinary flight has narrower valleys, and needs a shorter first step: `coarsest`, of 5 fine
    steps or more. Motion that repeats itself after some lags (k,) [s] has rivals as far from the
    best.
    """
    middle, finest, close = 5, 1, 3  # fine steps; the last on each side of a rival
    size = len(offsets_s)
    if size == 0:
        return OffsetSearch(offsets_s, offsets_s, np.nan, False)
    d_avg_px = np.full(size, np.nan)

    coarse_grid = grid = np.append(np.arange(0, size - 1, coarsest), size - 1)
    d_avg_px[grid] = coarse_cost(offsets_s[grid])
    tried = grid
    minima = _least_local_minima(d_avg_px, grid, rules.kept_minima)
    if len(minima) > 0:
        grid = _neighbourhood(minima, np.arange(-coarsest, coarsest + 1, middle), size)
        d_avg_px[grid] = coarse_cost(offsets_s[grid])
        tried = np.union1d(tried, grid)
        known = grid[np.isfinite(d_avg_px[grid])]
        known = known if len(known) else minima  # steps from these may reach no candidate
        best = known[[np.argmin(d_avg_px[known])]]
        reach = middle + _FIT_STEPS
        grid = _neighbourhood(best, np.arange(-reach, reach + 1, finest), size)
        rivals = _least_local_minima(d_avg_px, coarse_grid, rules.max_rivals)
        is_deep = d_avg_px[rivals] < rules.deep * np.nanmedian(d_avg_px[coarse_grid])
        rivals = rivals[is_deep & (np.abs(rivals - best[0]) > coarsest)]
        if returns_s is not None and len(returns_s) > 0:
            repeats = np.rint(np.concatenate([-returns_s, returns_s]) / FINE_STEP_S).astype(np.intp)
            rivals = np.union1d(rivals, _neighbourhood(best, repeats, size))
        for step, reach in ((middle, coarsest - middle), (finest, close)):
            near = _neighbourhood(rivals, np.arange(-reach, reach + 1, step), size)
            near = near[np.isnan(d_avg_px[near])]
            d_avg_px[near] = coarse_cost(offsets_s[near])
            tried = np.union1d(tried, near)
            rivals = _least_within(d_avg_px, rivals, coarsest)
        d_avg_px[grid] = cost(offsets_s[grid])
        tried = np.union1d(tried, grid)
        others = np.setdiff1d(_neighbourhood(rivals, np.arange(-coarsest, coarsest), size), grid)
        others = others[d_avg_px[others] < rules.rival * np.nanmin(d_avg_px[grid], initial=np.inf)]
        d_avg_px[others] = cost(offsets_s[others])  # lest few samples make a rival by chance
    return _minimum(offsets_s[tried], d_avg_px[tried], np.isin(tried, grid))


def _least_within(values: Array, centres: NDArray[np.intp], reach: int) -> NDArray[np.intp]:
    """Find the index of the least known value within the reach of each centre that has one."""
    found = []
    for centre in centres.tolist():
        start = max(centre - reach, 0)
        near = values[start : centre + reach + 1]
        if np.isfinite(near).any():
            found.append(start + int(np.nanargmin(near)))
    return np.array(found, np.intp)


def _least_local_minima(values: Array, indices: NDArray[np.intp], most: int) -> NDArray[np.intp]:
    """Find the few least local minima among the values at these ascending indices."""
    tried = np.where(np.isnan(values[indices]), np.inf, values[indices])
    padded = np.pad(tried, 1, constant_values=np.inf)
    is_minimum = (tried <= padded[:-2]) & (tried <= padded[2:]) & np.isfinite(tried)
    minima = np.flatnonzero(is_minimum)
    return indices[minima[np.argsort(tried[minima])[:most]]]


def _neighbourhood(
    centres: NDArray[np.intp], around: NDArray[np.intp], size: int
) -> NDArray[np.intp]:
    """Collect the indices at the steps `around` any centre, ascending, from 0 up to the size."""
    indices = np.unique(centres[:, None] + around)
    return np.asarray(indices[(indices >= 0) & (indices < size)])


def _minimum(candidates_s: Array, d_avg_px: Array, eligible: NDArray[np.bool_]) -> OffsetSearch:
    """Take the least of the eligible candidates, refined between candidates.

    Deviation: the paper takes the best candidate. Events that enter and leave the windows make
    d_avg jump by about 1e-3 px between offsets 10 us apart, so the minimum is read off a parabola
    fitted to d_avg within 6 ms. Its weights fall off towards both ends of a window centred on the
    minimum itself, so that the result does not depend on where the candidates lie.
    """
    values = np.where(eligible & np.isfinite(d_avg_px), d_avg_px, np.inf)
    best = int(np.argmin(values))
    if not np.isfinite(values[best]):
        return OffsetSearch(candidates_s, d_avg_px, np.nan, False)
    steps = (candidates_s - candidates_s[best]) / FINE_STEP_S
    vertex = 0.0  # in steps from the best candidate
    for _ in range(4):
        root_weights = np.sqrt(np.maximum(1.0 - ((steps - vertex) / _FIT_STEPS) ** 2, 0.0))
        near = (root_weights > 0.0) & np.isfinite(values)
        if np.count_nonzero(near) < 4:
            break
        curvature, slope, _ = np.polyfit(steps[near], values[near], 2, w=root_weights[near])
        if curvature <= 0.0:
            break
        vertex = float(np.clip(-0.5 * slope / curvature, -0.5 * _FIT_STEPS, 0.5 * _FIT_STEPS))
    t_d_s = float(candidates_s[best]) + FINE_STEP_S * vertex
    return OffsetSearch(candidates_s, d_avg_px, t_d_s, best in (0, len(candidates_s) - 1))
