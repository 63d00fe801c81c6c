"""The search for the time offset of least cost, and refusals where curve or views leave it open.

The limits for an estimate are in units of the object's own image and motion, so that they hold for
any resolution, speed and size. `docs/refusal.md` has the values of ordinary simulated flights, and
of flights that leave something undetermined.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ssac.arrays import Array, Indices, Mask
from ssac.config import Config, Interval
from ssac.estimate import Refusal, Status, first
from ssac.events import US_PER_S
from ssac.geometry.epipolar import epipolar_distance
from ssac.geometry.fundamental import second_best
from ssac.rules import SearchRules
from ssac.search.two_views import Pairs, TwoViews
from ssac.search.view import View, local_minima
from ssac.track.clean import Clean

Cost = Callable[[Array], Array]  # offsets (M,) [s] -> d_avg (M,) [px], NaN where undefined

FINE_STEP_S = 0.001  # step of the paper's exhaustive search; all candidates lie on its grid
_FIT_STEPS = 6  # fine steps on each side of the minimum, to which a parabola is fitted


@dataclass(frozen=True)
class OffsetSearch:
    """Every candidate tried and the minimum found."""

    candidates_s: Array  # (M,) [s], ascending
    d_avg_px: Array  # (M,) [px], NaN where too few samples are valid
    t_d_s: float  # [s] offset of least d_avg; NaN if no minimum is found
    at_bound: bool  # the least d_avg is at the first or last candidate: no minimum was enclosed


def mean_epipolar_distance(F: Array, pairs: Pairs, min_pairs: int) -> Array:
    """d_avg (M,) [px] of the paper's Eq. 4 with one F for all offsets; NaN below `min_pairs`."""
    distances = np.where(pairs.valid, epipolar_distance(F, pairs.p1_px, pairs.p2_px), 0.0)
    counts = np.count_nonzero(pairs.valid, axis=1)
    return np.where(counts < min_pairs, np.nan, np.sum(distances, axis=1) / np.maximum(counts, 1))


def candidate_offsets(views: TwoViews) -> Array:
    """Offsets [s], 1 ms apart from the interval's lower bound, at which the recordings overlap.

    Deviation: the paper says nothing of offsets at which the recordings hardly overlap. A
    short stretch fits almost any F, so an offset is a candidate only when its overlap is at least
    half of the longest in the interval. Empty when no offset gives any overlap.
    """
    low, high = views.config.offsets_s
    n_steps = int(np.floor((high - low) / FINE_STEP_S + 1e-9))
    (start1, end1), (start2, end2) = views.motion1.span_s, views.motion2.span_s
    ends = (np.array([start2 - end1, end2 - start1]) - low) / FINE_STEP_S  # of any overlap
    first, last = np.clip([np.floor(ends[0]), np.ceil(ends[1])], 0, n_steps).astype(np.int64)
    offsets = low + FINE_STEP_S * np.arange(first, last + 1, dtype=np.float64)
    start, end = views.overlap_s(offsets)
    lengths = end - start
    least = views.rules.search.min_overlap * np.max(lengths, initial=0.0)
    return offsets[(lengths > 0.0) & (lengths >= least)]


def search_offsets(
    views: TwoViews, coarse_cost: Cost, cost: Cost, returns_s: Array | None = None
) -> OffsetSearch:
    """Search the offsets of two views exhaustively or coarse to fine, as the config says."""
    candidates_s, rules = candidate_offsets(views), views.rules.search
    coarse_cost, cost = _in_parts(coarse_cost), _in_parts(cost)
    if views.config.exhaustive:
        return exhaustive_search(cost, candidates_s)
    # The first step is shorter for motion that turns back more often.
    swing_hz = max((view.swing_hz for view in views.alone.views if view is not None), default=0.0)
    steps = rules.coarsest_steps * rules.ordinary_swing_hz / max(swing_hz, 1e-12)
    coarsest = int(np.clip(steps, rules.least_coarse_steps, rules.coarsest_steps))
    return coarse_to_fine_search(coarse_cost, cost, candidates_s, coarsest, rules, returns_s)


def _in_parts(cost: Cost) -> Cost:
    """Take some offsets at a time: the pairs of all of them would fill the memory."""
    at_once = 500

    def of_parts(offsets_s: Array) -> Array:
        starts = range(at_once, len(offsets_s), at_once)
        return np.concatenate([cost(part) for part in np.split(offsets_s, starts)])

    return of_parts


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
    """Find the minimum of `exhaustive_search` from about a tenth of its candidates.

    The coarse cost, which may be less robust, is evaluated every `coarsest` steps of 1 ms, then
    every 5 ms around the three least local minima; the cost itself every 1 ms around the least
    value. The other deep minima, and the offsets a lag of `returns_s` (k,) [s] before or after the
    best, are refined to 1 ms with the coarse cost: they tell if the best has rivals (`valleys`).
    """
    middle, finest, close = 5, 1, 3  # in fine steps; `close` is the reach on each side of a rival
    size = len(offsets_s)
    if size == 0:
        return OffsetSearch(offsets_s, offsets_s, np.nan, False)
    d_avg_px = np.full(size, np.nan)

    coarse_grid = grid = np.append(np.arange(0, size - 1, coarsest), size - 1)
    d_avg_px[grid] = coarse_cost(offsets_s[grid])
    tried = grid
    minima = grid[local_minima(d_avg_px[grid])[: rules.kept_minima]]
    if len(minima) > 0:
        grid = _neighbourhood(minima, np.arange(-coarsest, coarsest + 1, middle), size)
        d_avg_px[grid] = coarse_cost(offsets_s[grid])
        tried = np.union1d(tried, grid)
        known = grid[np.isfinite(d_avg_px[grid])]
        known = known if len(known) else minima  # the grid may hold no candidate
        best = known[[np.argmin(d_avg_px[known])]]
        reach = middle + _FIT_STEPS
        grid = _neighbourhood(best, np.arange(-reach, reach + 1, finest), size)
        rivals = coarse_grid[local_minima(d_avg_px[coarse_grid])[: rules.max_rivals]]
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


def _least_within(values: Array, centres: Indices, reach: int) -> Indices:
    """Find the index of the least finite value within reach of each centre, if there is any."""
    found = []
    for centre in centres.tolist():
        start = max(centre - reach, 0)
        near = values[start : centre + reach + 1]
        if np.isfinite(near).any():
            found.append(start + int(np.nanargmin(near)))
    return np.array(found, np.intp)


def _neighbourhood(centres: Indices, around: Indices, size: int) -> Indices:
    """Return the indices from 0 to size - 1, ascending, that lie at steps `around` any centre."""
    indices = np.unique(centres[:, None] + around)
    return np.asarray(indices[(indices >= 0) & (indices < size)])


def _minimum(candidates_s: Array, d_avg_px: Array, eligible: Mask) -> OffsetSearch:
    """Find the eligible candidate of least d_avg, and refine it between candidates."""
    # Deviation: the paper takes the best candidate. Events that enter and leave the windows make
    # d_avg jump by about 1e-3 px between offsets 10 us apart, so the minimum is that of a parabola
    # fitted within 6 ms. Its weights fall off towards both ends of a window centred on the minimum,
    # so that the result does not depend on where the candidates lie.
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


@dataclass(frozen=True)
class Valley:
    """Neighbouring offsets of low cost."""

    first_s: float
    last_s: float
    least_s: float  # where the cost is least

    @property
    def length_s(self) -> float:
        """Length [s] from the first offset to the last."""
        return self.last_s - self.first_s


def unusable(
    views: TwoViews, cleans: tuple[Clean, Clean], interval_s: Interval | None
) -> Refusal | None:
    """Refuse views that no search can use: an object at rest, clocks far apart, too few events."""
    too_few = [
        _too_few(number, clean, views.config)
        for number, (clean, view) in enumerate(zip(cleans, views.alone.views, strict=True), start=1)
        if view is None  # else some windows hold enough
    ]
    apart = None
    (start1, end1), (start2, end2) = (one.span_s for one in cleans)
    are_known = np.isfinite([start1, start2]).all()
    if interval_s is not None and are_known and not has_common_time(cleans, interval_s):
        low, high = interval_s
        reason = (
            f"camera 1 ({start1:.3f} to {end1:.3f} s) and camera 2 ({start2:.3f} to {end2:.3f} s)"
            f" have no common time at any offset between {low:g} and {high:g} s: leave out"
            " --search, and all are tried"
        )
        apart = Refusal(Status.NO_COMMON_TIME, reason)
    return first(at_rest(views.alone.views, views.rules.search), apart, *too_few)


def overlapping(cleans: tuple[Clean, Clean]) -> Interval:
    """Return the offsets [s] at which the overlap is at least half of the shorter recording."""
    (start1, end1), (start2, end2) = (one.span_s for one in cleans)
    half_s = 0.5 * min(end1 - start1, end2 - start2)
    return start2 - end1 + half_s, end2 - start1 - half_s


def has_common_time(cleans: tuple[Clean, Clean], interval_s: Interval) -> bool:
    """Whether two recordings have common time at any offset of an interval."""
    (start1, end1), (start2, end2) = (one.span_s for one in cleans)
    return interval_s[0] < end2 - start1 and start2 - end1 < interval_s[1]


def _too_few(number: int, clean: Clean, config: Config) -> Refusal | None:
    """Refuse events of which no window holds enough for a position."""
    if clean.has_track:
        return None
    n, n_min = len(clean.events), clean.n_min(config.n_min)
    left = f"denoising left {n} of {clean.n_recorded} events"
    if clean.clutter is not None and clean.clutter.masked_events:
        left += f", of which {clean.clutter.masked_events} were of lamps and hot pixels"
    t_us, window_us = clean.events["t"], 2 * config.half_window_s * US_PER_S
    reason = (
        f"no window of {window_us / 1e3:g} ms holds {n_min} events"
        f"{f' ({left})' if clean.denoised else ''}: record closer to the object, or give a smaller"
        " --n-min or a longer --half-window"
    )
    if n == 0:
        reason = (
            f"{left}: check that an object moves in this recording and that its times are in the"
            " unit of its format, or try --no-denoise"
        )
    elif n >= n_min and np.min(t_us[n_min - 1 :] - t_us[: n - n_min + 1]) <= window_us:
        return None
    return Refusal(Status.TOO_FEW_SAMPLES, f"camera {number}: {reason}")


def at_rest(views: tuple[View | None, View | None], rules: SearchRules) -> Refusal | None:
    """Refuse an object that moves little, compared with its own image, in either view."""
    for number, view in enumerate(views, start=1):
        if view is not None and view.extent_px <= rules.min_extent * view.size_px:
            return Refusal(
                Status.NO_MOTION,
                f"in camera {number} the object moves by {view.extent_px:.1f} px rms only, of its"
                f" own rms size of {view.size_px:.1f} px: it is at rest, or lost in noise; record"
                " a livelier flight, or closer to the object",
            )
    return None


def too_little_motion(n_swings: float, least: float) -> Refusal | None:
    """Refuse a path too short to tell an offset and a pose from chance."""
    counted = min(n_swings, least - 0.1)  # rounded up, it could be what is needed
    reason = (
        f"the object goes to and fro {counted:.1f} times while both cameras see it, and"
        f" {least} are needed to tell offset and pose from chance, as of different objects: record"
        " longer, or a livelier flight"
    )
    return None if n_swings >= least else Refusal(Status.TOO_LITTLE_MOTION, reason)


def no_match(distance_px: float, object_px: float, rules: SearchRules) -> Refusal | None:
    """Refuse an estimate that fits the two views no better than two unrelated paths."""
    reason = (
        f"at the best offset the two paths still disagree by {distance_px:.1f} px, and the object's"
        f" rms size is {object_px:.1f} px: the cameras see different objects, a clock jumps or runs"
        " at a rate of its own, or the rig is of other cameras; record one flight with both"
        " cameras, give --rate-range, or calibrate again"
    )
    is_far = distance_px > rules.max_residual * object_px
    return Refusal(Status.NO_MATCH, reason) if is_far else None


def open_fundamental(p1_px: Array, p2_px: Array, rules: SearchRules) -> Refusal | None:
    """Refuse the pose of pairs (n, 2) [px] that another F fits nearly as well as the best."""
    reason = (
        "the path lies near a plane, or near another surface on which many fundamental matrices"
        " fit as well: F leaves the pose open, so fly in all directions"
    )
    is_open = not second_best(p1_px, p2_px) >= rules.min_second_best
    return Refusal(Status.DEGENERATE_POSE, reason) if is_open else None


def valleys(candidates_s: Array, costs: Array, t_d_s: float, rules: SearchRules) -> list[Valley]:
    """Find the valleys of a cost curve; that of `t_d_s`, the offset of least cost, comes first.

    The curve consists of M ascending offsets [s] and their costs; NaN costs are left out.
    """
    known = np.isfinite(costs)
    candidates_s, costs = candidates_s[known], costs[known]
    here = int(np.argmin(np.abs(candidates_s - t_d_s)))
    low = np.flatnonzero(costs < rules.rival * costs[here])
    if len(low) == 0:  # the least cost is zero
        return [Valley(t_d_s, t_d_s, t_d_s)]
    ends = np.flatnonzero(np.diff(candidates_s[low]) > rules.one_valley_s)
    found = []
    for piece in np.split(low, ends + 1):
        first, last, least = piece[0], piece[-1], piece[np.argmin(costs[piece])]
        found.append(Valley(*(float(candidates_s[k]) for k in (first, last, least))))
    at_s = candidates_s[here]
    return sorted(found, key=lambda valley: not valley.first_s <= at_s <= valley.last_s)


def ambiguous_offset(found: list[Valley], longest_s: float) -> Refusal | None:
    """Refuse a cost curve with several valleys, or with one longer than `longest_s`."""
    first, *others = found
    alternatives_s = sorted(valley.least_s for valley in others)
    reason = (
        f"all offsets from {first.first_s:.2f} to {first.last_s:.2f} s fit alike: the motion is"
        f" uniform along a line, circle or helix, {_NOT_ONE}"
    )
    if alternatives_s:
        reason = other_offsets(alternatives_s)
    is_open = alternatives_s or first.length_s > longest_s
    return Refusal(Status.AMBIGUOUS_OFFSET, reason) if is_open else None


def uniform() -> Refusal:
    """Refuse the offset of a path that fits itself after any lag."""
    reason = f"the path fits itself after any delay: a line, circle or helix, {_NOT_ONE}"
    return Refusal(Status.AMBIGUOUS_OFFSET, reason)


def other_offsets(alternatives_s: list[float]) -> str:
    """Give the reason for refusal that names the other offsets [s]."""
    named = ", ".join(f"{offset_s:.3f}" for offset_s in alternatives_s[:5])
    more = f" and {len(alternatives_s) - 5} more" if len(alternatives_s) > 5 else ""
    return (
        f"other offsets fit about as well: {named} s{more}; the motion repeats itself, is uniform"
        f" along a line, circle or helix, {_NOT_ONE}"
    )


_NOT_ONE = (
    "or is not one object's (noise, or several things): fly in all directions, or record one object"
    " by itself"
)
