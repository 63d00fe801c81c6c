"""The search over all time offsets for those at which two object motions may show one path.

It serves recordings of which nothing is known but that they overlap. Every offset that leaves
enough common path is tried, on a grid whose step follows from the paths' speed, with an F fitted at
each; the best few are refined, and so is the rate of camera 2's clock where it is in question. The
cost of an offset is its `relative_cost`, times the ratio of the longest common path at any offset
to that at this one: a short piece of path fits many others by chance.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numba
import numpy as np

from ssac.arrays import Array, IntArray, Mask
from ssac.config import Interval
from ssac.geometry.fundamental import median_after_fit
from ssac.rules import AllOffsetsRules
from ssac.search.view import local_minima
from ssac.track.motion import Motion

Progress = Callable[[float], None]  # called with the share that is done


class Grid(NamedTuple):
    """A track sampled at whole steps of time."""

    first: int  # time of the first sample, in steps
    p_px: Array  # (n, 2)
    valid: Mask  # (n,)
    least_px: float = 0.0  # least motion between samples that count


@numba.njit(cache=True)
def costs_at_lags(
    one: Grid, other: Grid, lags: IntArray, n_pairs: int, least_pairs: int, iterations: int
) -> tuple[Array, IntArray]:
    """Costs (m,) of pairing sample i of track 1 with i + lag of track 2, and numbers of pairs (m,).

    The cost is the median Sampson distance from the best F, over the width of the thinner path:
    some F fits any two paths whatever to within that width. NaN below `least_pairs` pairs. An
    object at rest tells nothing of the offset, so a sample counts only if both images have moved by
    `least_px` since the last sample that counted.
    """
    costs, counts = np.full(len(lags), np.nan), np.zeros(len(lags), np.int64)
    chosen = np.empty(len(one.valid), np.int64)
    for m in range(len(lags)):
        lag = lags[m]
        count = moving_pairs(one, other, lag, chosen)
        counts[m] = count
        if count < least_pairs:
            continue
        n = min(count, n_pairs)
        p1, p2 = np.empty((n, 2)), np.empty((n, 2))
        for j in range(n):
            i = chosen[j * count // n]
            p1[j], p2[j] = one.p_px[i], other.p_px[i + lag]
        costs[m] = relative_cost(p1, p2, iterations)
    return costs, counts


@numba.njit(cache=True)
def moving_pairs(one: Grid, other: Grid, lag: int, chosen: IntArray) -> int:
    """Write to `chosen` the samples of track 1 whose pairs at a lag count; return their number."""
    count = 0
    x1 = y1 = x2 = y2 = 1e12
    for i in range(max(0, -lag), min(len(one.valid), len(other.valid) - lag)):
        if not (one.valid[i] and other.valid[i + lag]):
            continue
        here, there = one.p_px[i], other.p_px[i + lag]
        if abs(here[0] - x1) + abs(here[1] - y1) < one.least_px:
            continue
        if abs(there[0] - x2) + abs(there[1] - y2) < other.least_px:
            continue
        chosen[count] = i
        count += 1
        x1, y1, x2, y2 = here[0], here[1], there[0], there[1]
    return count


@numba.njit(cache=True)
def relative_cost(p1_px: Array, p2_px: Array, iterations: int) -> float:
    """Median Sampson distance of pairs (n, 2) from their best F, over the thinner path's width."""
    width_px = min(width_of(p1_px), width_of(p2_px))
    if not width_px > 0.0:
        return np.nan
    return median_after_fit(p1_px, p2_px, iterations) / width_px


@numba.njit(cache=True)
def width_of(points_px: Array) -> float:
    """Deviation [px] of points (n, 2) across their longest direction."""
    x, y = points_px[:, 0] - np.mean(points_px[:, 0]), points_px[:, 1] - np.mean(points_px[:, 1])
    xx, yy, xy = np.mean(x * x), np.mean(y * y), np.mean(x * y)
    least = 0.5 * (xx + yy) - np.sqrt(0.25 * (xx - yy) ** 2 + xy * xy)
    width_px: float = np.sqrt(max(least, 0.0))
    return width_px


@dataclass(frozen=True)
class Guess:
    """An offset at which both views may show one path."""

    t_d_s: float  # at t_ref
    t_ref_s: float  # camera 1's clock: the middle of the common time
    rate: float  # of camera 2's clock over camera 1's
    cost: float

    def at(self, time_s: float) -> float:
        """Give the offset [s] at a time [s] of camera 1's clock."""
        return self.t_d_s + (self.rate - 1.0) * (time_s - self.t_ref_s)


@dataclass(frozen=True)
class AllOffsets:
    """What the search over all offsets found."""

    candidates_s: Array  # (m,) offsets tried, ascending, at the best rate
    costs: Array  # (m,) NaN where too little common path is left
    guesses: list[Guess]  # the best first; more than `apart_steps` steps from each other
    step_s: float


def search_all_offsets(
    motion1: Motion,
    motion2: Motion,
    rules: AllOffsetsRules,
    rate_range: tuple[float, float] = (1.0, 1.0),
    rate_freedom: float = 0.0,
    progress: Progress | None = None,
    spans_s: tuple[Interval, Interval] | None = None,
) -> AllOffsets:
    """Try every offset that leaves enough common path, and fit F to a limited number of its pairs.

    Rates of camera 2's clock over camera 1's are tried in steps that move the ends of the common
    time by a few steps of the offset. Refinement may change a guess's rate by the share
    `rate_freedom`, or by half a step of the rates if that is more. `progress` is called repeatedly
    with the share that is done. `spans_s` limits each path, on its camera's clock.
    """
    motions, spans_s = (motion1, motion2), spans_s or (motion1.span_s, motion2.span_s)
    step_s = min(_step_s(*path, rules) for path in zip(motions, spans_s, strict=True))
    are_seen = all(start_s < end_s for start_s, end_s in spans_s)
    if not (are_seen and np.isfinite(step_s)):
        return AllOffsets(np.empty(0), np.empty(0), [], 0.0)
    low, high = rate_range
    if not low < high:
        search = _Search(*motions, spans_s, rules, step_s, rate_freedom, progress)
        return search.guessed([search.scan(low, rules.pairs, rules.iterations, (0, 1))])
    half_s = 0.5 * min(end_s - start_s for start_s, end_s in spans_s)
    wide_s = step_s * rules.rate_scan_step
    n = int(np.ceil(np.log(high / low) * half_s / (rules.rate_steps * wide_s))) + 1
    rates = [float(rate) for rate in np.geomspace(low, high, max(n, 2))]
    freedom = max(rate_freedom, 0.5 * (rates[1] / rates[0] - 1.0))
    search = _Search(*motions, spans_s, rules, wide_s, freedom, progress)
    few, n_scans = (rules.rate_pairs, rules.rate_iterations), len(rates) + 1
    found = search.guessed([search.scan(rate, *few, (k, n_scans)) for k, rate in enumerate(rates)])
    if not found.guesses:
        return found
    # Scan the best rate again, with the ordinary step and number of pairs.
    fine_s = wide_s / rules.rate_scan_step
    fine = _Search(*motions, spans_s, rules, fine_s, freedom, progress)
    rate, last = found.guesses[0].rate, (len(rates), n_scans)
    shown = fine.shown(fine.scan(rate, rules.pairs, rules.iterations, last))
    return replace(shown, guesses=found.guesses)


def _step_s(motion: Motion, span_s: Interval, rules: AllOffsetsRules) -> float:
    """Step of the offset [s] in which a path moves by a share of its width; inf if unknown."""
    start_s, end_s = span_s
    if not end_s > start_s:
        return np.inf
    n_samples = 2000
    times_s = start_s + (end_s - start_s) * (np.arange(n_samples) + 0.5) / n_samples
    times_s = times_s[motion.at(times_s).valid]
    positions = motion.at(times_s).positions_px
    speeds = np.linalg.norm(motion.velocities_at(times_s), axis=1)
    speeds = speeds[np.isfinite(speeds)]
    if len(speeds) < 2:
        return np.inf
    speed = float(np.sqrt(np.mean(speeds**2)))
    step_s = rules.step_widths * width_of(positions) / max(speed, 1e-9)
    return float(np.clip(step_s, rules.least_step_s, rules.most_step_s))


@dataclass(frozen=True)
class _Scan:
    """Costs at all lags, for one rate of camera 2's clock."""

    rate: float
    lags: IntArray  # (m,) index in grid 2 less index in grid 1
    shift: int  # first step of grid 2 less that of grid 1; lag + shift is a delay in steps
    costs: Array  # (m,) weighted: the less common path, the higher
    most: int  # largest number of pairs at any lag


@dataclass(frozen=True)
class _Search:
    """The search over all lags, with both paths on grids of one step."""

    motion1: Motion
    motion2: Motion
    spans_s: tuple[Interval, Interval]
    rules: AllOffsetsRules
    step_s: float
    freedom: float  # share by which a guess's rate may differ from its scan's
    progress: Progress | None

    @cached_property
    def one(self) -> Grid:
        """Camera 1's path on its grid."""
        return self._grid(self.motion1, self.spans_s[0])

    def _grid(self, motion: Motion, span_s: Interval, rate: float = 1.0) -> Grid:
        """Sample a track at whole steps of a clock that runs `rate` times slower than its own."""
        (start_s, end_s), step_s = span_s, rate * self.step_s
        first, last = int(np.ceil(start_s / step_s)), int(end_s / step_s)
        track = motion.at(step_s * np.arange(first, last + 1, dtype=np.float64))
        seen = track.positions_px[track.valid]
        extent_px = float(np.sum(np.std(seen, axis=0))) if len(seen) else 0.0
        positions = np.where(track.valid[:, None], track.positions_px, 0.0)
        return Grid(first, positions, track.valid, self.rules.moved * extent_px)

    def scan(self, rate: float, pairs: int, iterations: int, part: tuple[int, int]) -> _Scan:
        """Compute the costs of all lags at which the paths overlap; `part` (k, n): scan k of n."""
        one, least = self.one, self.rules.least_pairs
        other = self._grid(self.motion2, self.spans_s[1], rate)
        lags = np.arange(-len(one.valid) + 1, len(other.valid), dtype=np.int64)
        costs, counts = np.full(len(lags), np.nan), np.zeros(len(lags), np.int64)
        chunk, (k, n) = 256, part  # lags between two calls of `progress`
        for start in range(0, len(lags), chunk):
            some = slice(start, start + chunk)
            costs[some], counts[some] = costs_at_lags(
                one, other, lags[some], pairs, least, iterations
            )
            if self.progress is not None:
                self.progress((k + min(1.0, (start + chunk) / len(lags))) / n)
        most = int(np.max(counts, initial=0))
        enough = counts >= max(least, self.rules.least_share * most)
        weighed = np.where(enough, costs * most / np.maximum(counts, 1), np.nan)
        return _Scan(rate, lags, other.first - one.first, weighed, most)

    def shown(self, scan: _Scan) -> AllOffsets:
        """Return a scan's costs by offset at the middle of camera 1's path, without guesses."""
        middle_s = self.step_s * (self.one.first + 0.5 * len(self.one.valid))
        lags_s = self.step_s * (scan.lags + scan.shift).astype(np.float64)
        offsets_s = np.asarray(scan.rate * (middle_s + lags_s) - middle_s)
        return AllOffsets(offsets_s, scan.costs, [], self.step_s)

    def guessed(self, scans: list[_Scan]) -> AllOffsets:
        """Refine the least minima of all scans; keep the best of any near each other, sorted."""
        most, rules = max(scan.most for scan in scans), self.rules
        starts = sorted(
            (float(scan.costs[m]) * most / max(scan.most, 1), k, m)
            for k, scan in enumerate(scans)
            for m in local_minima(scan.costs)[: rules.max_guesses].tolist()
        )
        apart_s = rules.apart_steps * self.step_s
        tried: list[tuple[float, float]] = []
        found: list[Guess] = []
        for _, k, m in starts:
            scan = scans[k]
            lag_s = self.step_s * float(scan.lags[m] + scan.shift)
            if any(
                abs(lag_s - other_s) < apart_s and abs(scan.rate / rate - 1.0) <= self.freedom
                for other_s, rate in tried
            ):
                continue
            tried.append((lag_s, scan.rate))
            guess = self._refined(int(scan.lags[m]), scan, most)
            found += [] if guess is None else [guess]
            if len(tried) >= rules.max_guesses:
                break
        apart: list[Guess] = []
        for guess in sorted(found, key=lambda one: one.cost):
            if all(abs(guess.t_d_s - other.at(guess.t_ref_s)) > apart_s for other in apart):
                apart.append(guess)
        return replace(self.shown(scans[0]), guesses=apart)

    def _refined(self, lag: int, scan: _Scan, most: int) -> Guess | None:
        """Refine the offset of a lag, and the rate where it is free, by compass search."""
        rules, step_s, one, freedom = self.rules, self.step_s, self.one, self.freedom
        chosen = np.empty(len(one.valid), np.int64)
        other = self._grid(self.motion2, self.spans_s[1], scan.rate)
        count = moving_pairs(one, other, lag, chosen)
        if count < rules.least_pairs:
            return None
        n = min(count, 2 * rules.pairs)
        places = chosen[np.arange(n) * count // n]
        times_s = step_s * (one.first + places).astype(np.float64)
        t_ref_s = 0.5 * float(times_s[0] + times_s[-1])
        p1 = one.p_px[places]

        def cost(t_d_s: float, rate: float) -> float:
            track = self.motion2.at(t_ref_s + t_d_s + rate * (times_s - t_ref_s))
            if np.count_nonzero(track.valid) < max(rules.least_pairs, len(times_s) // 2):
                return np.inf
            p2 = track.positions_px[track.valid]
            value = relative_cost(p1[track.valid], p2, rules.fine_iterations)
            return float(value) if np.isfinite(value) else np.inf

        t_d_s = scan.rate * (t_ref_s + step_s * (lag + scan.shift)) - t_ref_s
        best = _compass(cost, (t_d_s, scan.rate), (0.5 * step_s, 0.0))
        half_s = 0.5 * float(times_s[-1] - times_s[0])
        if freedom > 0.0:
            step = min(0.5 * freedom, 2.0 * step_s / half_s)
            starts = [scan.rate * (1.0 + part * freedom) for part in (-0.5, 0.0, 0.5)]
            free = min(_compass(cost, (best[1][0], rate), (0.5 * step_s, step)) for rate in starts)
            if free[0] < rules.worth * best[0] and abs(free[1][1] / scan.rate - 1.0) <= freedom:
                best = free
        value, (t_d_s, rate) = best
        if not np.isfinite(value):
            return None
        return Guess(t_d_s, t_ref_s, rate, value * most / count)


def _compass(
    cost: Callable[[float, float], float], start: tuple[float, float], steps: tuple[float, float]
) -> tuple[float, tuple[float, float]]:
    """Minimise a cost of offset and rate by steps along both axes, halved where none helps."""
    best, (offset_s, rate) = cost(*start), start
    step_s, step = steps
    while step_s > 1e-3:
        tries = [(offset_s + step_s, rate), (offset_s - step_s, rate)]
        if step > 0.0:
            tries += [(offset_s, rate + step), (offset_s, rate - step)]
        values = [cost(*place) for place in tries]
        least = int(np.argmin(values))
        if values[least] < best:
            best, (offset_s, rate) = values[least], tries[least]
        else:
            step_s, step = 0.5 * step_s, 0.5 * step
    return best, (offset_s, rate)
