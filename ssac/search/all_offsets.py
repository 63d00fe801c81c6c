"""The offsets, of all there are, at which two object motions may show one path.

For recordings of which nothing is known but that they overlap. Every offset that leaves enough
common time is tried on a grid whose step follows from the paths' speed, with an F fitted at each;
the best few are refined, and so is the rate of camera 2's clock where it is in question. The cost
of an offset is its `relative_cost`, times by how many times less common path it leaves
than the most that any offset does: a short piece of path fits many another by chance.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from ssac.geometry.fundamental import median_after_fit
from ssac.rules import AllOffsetsRules
from ssac.track.motion import Motion

Array = NDArray[np.float64]
Progress = Callable[[float], None]  # called with the share that is done


@dataclass(frozen=True)
class Fit:
    """How thoroughly F is fitted."""

    n_pairs: int
    iterations: int


class Grid(NamedTuple):
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


def grid_of(motion: Motion, step_s: float, rules: AllOffsetsRules, rate: float = 1.0) -> Grid:
    """Sample a track at whole steps of a clock that runs `rate` times slower than its own."""
    start_s, end_s = motion.span_s
    first, last = int(np.ceil(start_s / (rate * step_s))), int(end_s / (rate * step_s))
    track = motion.at(rate * step_s * np.arange(first, last + 1, dtype=np.float64))
    seen = track.positions_px[track.valid]
    extent_px = float(np.sum(np.std(seen, axis=0))) if len(seen) else 0.0
    positions = np.where(track.valid[:, None], track.positions_px, 0.0)
    return Grid(first, positions, track.valid, rules.moved * extent_px)


def scan_lags(
    one: Grid,
    other: Grid,
    rate: float,
    fit: Fit,
    rules: AllOffsetsRules,
    progress: Progress | None,
) -> Scan:
    """Find the costs of all lags at which two paths, in steps of one length, overlap."""
    lags = np.arange(-len(one.valid) + 1, len(other.valid), dtype=np.int64)
    costs, counts = np.full(len(lags), np.nan), np.zeros(len(lags), np.int64)
    chunk = 256  # lags between two calls of `progress`
    for start in range(0, len(lags), chunk):
        part = slice(start, start + chunk)
        costs[part], counts[part] = costs_at_lags(
            one, other, lags[part], fit.n_pairs, rules.least_pairs, fit.iterations
        )
        if progress is not None:
            progress(min(1.0, (start + chunk) / len(lags)))
    most = int(np.max(counts, initial=0))
    enough = counts >= max(rules.least_pairs, rules.least_share * most)
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
    one: Grid,
    other: Grid,
    lags: NDArray[np.int64],
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
def moving_pairs(one: Grid, other: Grid, lag: int, chosen: NDArray[np.int64]) -> int:
    """Fill in the samples of track 1 that count beside those a lag later; give their number."""
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


@dataclass(frozen=True)
class Guess:
    """An offset at which both views may show one path."""

    t_d_s: float  # at t_ref
    t_ref_s: float  # camera 1's clock: the middle of the common time
    rate: float  # camera 2's clock runs so many times as fast
    cost: float
    common_s: float  # time that both see the object in motion
    lag_s: float  # t_cam2 / rate = t_cam1 + lag

    @property
    def skew_ppm(self) -> float:
        """By which camera 2's clock runs fast."""
        return 1e6 * (self.rate - 1.0)


@dataclass(frozen=True)
class AllOffsets:
    """What the search over all offsets found."""

    candidates_s: Array  # (m,) offsets tried, ascending, at the best rate
    costs: Array  # (m,) NaN where too little common path is left
    guesses: list[Guess]  # the best first; each further than some steps from the others
    step_s: float


def search_all_offsets(
    motion1: Motion,
    motion2: Motion,
    rules: AllOffsetsRules,
    rate_range: tuple[float, float] = (1.0, 1.0),
    rate_freedom: float = 0.0,
    progress: Progress | None = None,
) -> AllOffsets:
    """Try every offset that leaves enough common path, in time linear in their number.

    Rates of camera 2's clock, by camera 1's, are tried in steps that move the ends of the common
    time by a few steps of the offset; a guess may be refined away from its rate by a share, the
    freedom. Progress is called now and then with the share that is done.
    """
    step_s = min(_step_s(motion1, rules), _step_s(motion2, rules))
    are_seen = all(motion.span_s[0] < motion.span_s[1] for motion in (motion1, motion2))
    if not (are_seen and np.isfinite(step_s)):
        return AllOffsets(np.empty(0), np.empty(0), [], 0.0)
    several = rate_range[0] < rate_range[1]
    if several:
        step_s *= rules.rate_scan_step
    rates = _rates(rate_range, rules.rate_steps * step_s, motion1, motion2)
    fine = Fit(rules.pairs, rules.iterations)
    fit = Fit(rules.rate_pairs, rules.rate_iterations) if several else fine
    n_scans = len(rates) + several
    one = grid_of(motion1, step_s, rules)
    scans = [
        scan_lags(
            one,
            grid_of(motion2, step_s, rules, rate),
            rate,
            fit,
            rules,
            _part(progress, k, n_scans),
        )
        for k, rate in enumerate(rates)
    ]
    freedom = max(rate_freedom, 0.5 * (rates[1] / rates[0] - 1.0)) if several else rate_freedom
    guesses = _guesses(scans, one, motion2, step_s, freedom, rules)
    shown = scans[0]
    if several and guesses:  # the curve at the best rate, with all pairs
        step_s /= rules.rate_scan_step
        one = grid_of(motion1, step_s, rules)
        rate, said = guesses[0].rate, _part(progress, len(rates), n_scans)
        other = grid_of(motion2, step_s, rules, rate)
        shown = scan_lags(one, other, rate, fine, rules, said)
    return AllOffsets(_offset_s(shown, one, step_s), shown.costs, guesses, step_s)


def _step_s(motion: Motion, rules: AllOffsetsRules) -> float:
    """Step of the offset [s] in which a path goes a share of its width; inf of none."""
    start_s, end_s = motion.span_s
    if not end_s > start_s:
        return np.inf
    n_samples = 2000
    times_s = start_s + (end_s - start_s) * (np.arange(n_samples) + 0.5) / n_samples
    valid = motion.at(times_s).valid
    positions = motion.at(times_s[valid]).positions_px
    speeds = np.linalg.norm(motion.velocities_at(times_s[valid]), axis=1)
    speeds = speeds[np.isfinite(speeds)]
    if len(speeds) < 2:
        return np.inf
    speed = float(np.sqrt(np.mean(speeds**2)))
    step_s = rules.step_widths * width_of(positions) / max(speed, 1e-9)
    return float(np.clip(step_s, rules.least_step_s, rules.most_step_s))


def _rates(
    rate_range: tuple[float, float], end_step_s: float, motion1: Motion, motion2: Motion
) -> list[float]:
    low, high = rate_range
    if not low < high:
        return [low]
    half_s = 0.5 * min(float(np.ptp(motion1.span_s)), float(np.ptp(motion2.span_s)))
    n = int(np.ceil(np.log(high / low) * half_s / end_step_s)) + 1
    return [float(rate) for rate in np.geomspace(low, high, max(n, 2))]


def _guesses(
    scans: list[Scan],
    one: Grid,
    motion2: Motion,
    step_s: float,
    freedom: float,
    rules: AllOffsetsRules,
) -> list[Guess]:
    """Refine the least minima of all scans, and sort them; the nearest to each other are one."""
    most = max(scan.most for scan in scans)
    starts = sorted(
        (float(scan.costs[m]) * most / max(scan.most, 1), k, m)
        for k, scan in enumerate(scans)
        for m in local_minima(scan.costs, rules.max_guesses)
    )
    apart_s = rules.apart_steps * step_s
    tried: list[tuple[float, float]] = []
    found: list[Guess] = []
    for _, k, m in starts:
        scan = scans[k]
        lag_s = step_s * float(scan.lags[m] + scan.shift)
        if any(
            abs(lag_s - other_s) < apart_s and abs(scan.rate / rate - 1.0) <= freedom
            for other_s, rate in tried
        ):
            continue
        tried.append((lag_s, scan.rate))
        guess = _refined(one, motion2, step_s, int(scan.lags[m]), scan, freedom, most, rules)
        if guess is not None:
            found.append(guess)
        if len(tried) >= rules.max_guesses:
            break
    found.sort(key=lambda guess: guess.cost)
    apart: list[Guess] = []
    for guess in found:
        if all(abs(guess.lag_s - other.lag_s) > apart_s for other in apart):
            apart.append(guess)
    return apart


def _refined(
    one: Grid,
    motion2: Motion,
    step_s: float,
    lag: int,
    scan: Scan,
    freedom: float,
    most: int,
    rules: AllOffsetsRules,
) -> Guess | None:
    """Refine an offset, and the rate where it is free, by ever shorter steps."""
    other = grid_of(motion2, step_s, rules, scan.rate)
    chosen = np.empty(len(one.valid), np.int64)
    count = moving_pairs(one, other, lag, chosen)
    if count < rules.least_pairs:
        return None
    n = min(count, 2 * rules.pairs)
    places = chosen[np.arange(n) * count // n]
    times_s = step_s * (one.first + places).astype(np.float64)
    t_ref_s = 0.5 * float(times_s[0] + times_s[-1])
    p1 = one.p_px[places]

    def cost(t_d_s: float, rate: float) -> float:
        track = motion2.at(t_ref_s + t_d_s + rate * (times_s - t_ref_s))
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
    (t_d_s, rate), value = best[1], best[0]
    if not np.isfinite(value):
        return None
    lag_s = (t_ref_s + t_d_s) / rate - t_ref_s
    return Guess(t_d_s, t_ref_s, rate, value * most / count, step_s * count, lag_s)


def _compass(
    cost: Callable[[float, float], float], start: tuple[float, float], steps: tuple[float, float]
) -> tuple[float, tuple[float, float]]:
    """Least cost along two axes, by steps to and fro that are halved where none leads down."""
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


def _offset_s(scan: Scan, one: Grid, step_s: float) -> Array:
    """Offsets t_d (m,) [s] of a scan's lags, at the middle of camera 1's recording."""
    middle_s = step_s * (one.first + 0.5 * len(one.valid))
    lags_s = step_s * (scan.lags + scan.shift).astype(np.float64)
    return np.asarray(scan.rate * (middle_s + lags_s) - middle_s)


def _part(progress: Progress | None, k: int, n: int) -> Progress | None:
    """Progress of part k of n."""
    if progress is None:
        return None
    return lambda share: progress((k + share) / n)
