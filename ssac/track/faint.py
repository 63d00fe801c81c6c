"""Find the events of a faint object, small and far away, among all that one camera recorded.

A filter that only counts neighbours loses a distant object where it is slow or far. The path before
and after then tells where the object must be, and a corridor of its own size about that place holds
little noise. The path is smoothed with the events of the corridor, each weighted by the object's
share of all events there, which extends the known path at both ends. This is repeated until no more
is gained.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numba
import numpy as np

from ssac.arrays import Array, Events, IntArray, Mask, Pixels
from ssac.errors import SsacError
from ssac.points import PointTrack
from ssac.rules import FaintRules, NoiseRules, Rules
from ssac.track.denoise import least_neighbours, masked_pixels, radius_filter, unmasked


@dataclass(frozen=True)
class Followed:
    """An object's path in the raw image, in even bins of time from the first event on."""

    start_us: int
    positions_px: Array  # (n, 2) at the bins' middles
    variances_px2: Array  # (n, 2) of the positions
    seen: Mask  # (n,)
    events: Events  # of a corridor about the path, where the object is seen


class _Binned(NamedTuple):
    """Events by bins."""

    x: Pixels  # (m,)
    y: Pixels  # (m,)
    ages_s: Array  # (m,) from the middle of their bin
    bounds: IntArray  # (n + 1,) first event of each bin
    start_us: int
    bin_us: int

    def of(self, events: Events) -> IntArray:
        """Return the bin (k,) of each of k events."""
        return np.asarray((events["t"] - self.start_us) // self.bin_us)


class _Path(NamedTuple):
    positions_px: Array  # (n, 2)
    velocities_px_s: Array  # (n, 2)
    variances_px2: Array  # (n, 2) of the positions
    known: Mask  # (n,) well enough to look for events
    around_px2: Array  # (n, 2) variances of the object's events about the path


_Limits = tuple[float, float, float, float]
"""`half_px`, `counted`, `inside` and `around` of the rules."""


def faint_object_events(events: Events, width: int, height: int, by: Rules | None = None) -> Events:
    """Find the events of one object that makes too few to be told from noise by their neighbours.

    What the radius filter leaves is surely the object's, with gaps through which it is followed;
    only this is returned if it is too little. SsacError if no event is surely an object's.
    """
    by = by or Rules()
    rules = by.faint
    kept, sure = _sure(events, width, height, by.noise, rules)
    if not len(sure):
        raise SsacError(
            f"of {len(events)} events none keeps {rules.n_neighbours} neighbours or more within 5"
            f" px (a px being {rules.ms_per_px:g} ms): no object is seen, or it is too faint even"
            " for --faint"
        )
    found = follow(kept, sure, width, height, rules)
    return sure if found is None else found.events


def faint_track(
    events: Events, width: int, height: int, noise: NoiseRules, rules: FaintRules
) -> tuple[PointTrack, int] | None:
    """Follow one object that makes too few events for a window to hold enough of them.

    Returns a point for each bin in which its place is well known, smoothed with the events before
    and after, and how many events are the object's. None if too few events are sure to follow it.
    """
    kept, sure = _sure(events, width, height, noise, rules)
    found = follow(kept, sure, width, height, rules) if len(sure) else None
    if found is None:
        return None
    variances_px2 = np.max(found.variances_px2, axis=1)
    is_sound = np.all(found.variances_px2 > 0.0, axis=1)  # fails only by rounding
    known = np.flatnonzero(found.seen & is_sound & (variances_px2 < rules.max_sigma_px**2))
    times_s = 1e-6 * (found.start_us + rules.bin_us * (known.astype(np.float64) + 0.5))
    if not len(known):
        return None
    sigmas_px: Array = np.sqrt(variances_px2[known])
    track = PointTrack(times_s, found.positions_px[known], sigmas_px)
    return track, len(found.events)


def _sure(
    events: Events, width: int, height: int, noise: NoiseRules, rules: FaintRules
) -> tuple[Events, Events]:
    """Return events without pixels that fire by themselves, and those surely an object's."""
    masked, hz = masked_pixels(events, width, height, noise)
    kept = unmasked(events, masked)
    as_large_px = rules.ms_per_px ** (1 / 3) * noise.ball_px  # same volume, 1 ms per px
    most = rules.most_neighbours
    n = max(rules.n_neighbours, least_neighbours(hz, width * height, as_large_px, most, noise))
    sure = kept
    for _ in range(rules.rounds):
        sure = radius_filter(sure, noise.ball_px, rules.ms_per_px, n)
    return kept, sure


def follow(
    events: Events, sure: Events, width: int, height: int, rules: FaintRules
) -> Followed | None:
    """Follow the one object that a camera sees between and beyond its sure events.

    Events are sorted by time, without pixels that fire by themselves; almost none of the sure ones
    is noise. None where the sure ones are too few to give the size of the image.
    """
    bins, size = _binned(events, rules.bin_us), (width, height)
    sure = _lasting(sure, bins, rules)
    bin_of_sure, counts, means_px = _means(sure, bins)
    sizes_px2 = _sizes(sure, bin_of_sure, counts, means_px, rules)
    if sizes_px2 is None:
        return None
    limits = rules.half_px, rules.counted, rules.inside, rules.around
    weights, n_before = counts, -1
    for _ in range(rules.max_rounds):
        path = _smoothed(weights, means_px, sizes_px2, size, rules)
        rates, background, seen = _rates(bins, path, limits, size, rules)
        sums = _sums(bins, path, limits, rates, background)
        weights = sums[:, 2]
        means_px = sums[:, 3:5] / np.maximum(weights, _LEAST_WEIGHT)[:, None]
        if np.count_nonzero(seen) <= n_before:
            break
        n_before = np.count_nonzero(seen)
    is_sure = (_around(counts, rules.sure_bins) >= rules.min_sure_events) & seen
    seen = seen & ~_dead_ends(seen, is_sure, rules.dead_end_bins)
    half_sizes_px = rules.corridor_sigmas * np.sqrt(sizes_px2)
    bin_of_event = bins.of(events)
    in_seen = np.flatnonzero(seen[bin_of_event])
    k, ages_s = bin_of_event[in_seen], bins.ages_s[in_seen, None]
    away_px = np.column_stack([events["x"], events["y"]])[in_seen] - path.positions_px[k]
    away_px = (away_px - path.velocities_px_s[k] * ages_s) / half_sizes_px[k]
    inside = in_seen[away_px[:, 0] ** 2 + away_px[:, 1] ** 2 < 1.0]
    return Followed(bins.start_us, path.positions_px, path.variances_px2, seen, events[inside])


_LEAST_WEIGHT = 1e-3  # of a bin that counts as measured, in events


def _binned(events: Events, bin_us: int) -> _Binned:
    times_us, start_us = events["t"], int(events["t"][0])
    n = int(times_us[-1] - start_us) // bin_us + 1
    bounds = np.searchsorted(times_us, start_us + bin_us * np.arange(n + 1))
    ages_s = 1e-6 * ((times_us - start_us) % bin_us - 0.5 * bin_us)
    bounds = bounds.astype(np.int64)
    return _Binned(events["x"], events["y"], ages_s, bounds, start_us, bin_us)


def _lasting(sure: Events, bins: _Binned, rules: FaintRules) -> Events:
    """Leave out events that cannot be the object's: far off their bin's mean or in small clumps."""
    for _ in range(2):  # the second time by means without what the first left out
        bin_of_sure, _, means_px = _means(sure, bins)
        x_px, y_px = means_px[bin_of_sure].T
        away_px = np.maximum(abs(sure["x"] - x_px), abs(sure["y"] - y_px))
        sure = sure[away_px < rules.one_place_px]
    bin_of_sure, counts, means_px = _means(sure, bins)
    full = np.flatnonzero(counts)
    jumps_px = np.max(np.abs(np.diff(means_px[full], axis=0)), axis=1, initial=0.0)
    is_break = (np.diff(full) > rules.sure_bins) | (jumps_px > rules.one_place_px)
    clump = np.zeros(len(counts), np.int64)
    clump[full[1:]] = np.cumsum(is_break)
    in_clump = np.bincount(clump[bin_of_sure], minlength=1)
    return np.asarray(sure[in_clump[clump[bin_of_sure]] >= rules.min_clump_events])


def _means(events: Events, bins: _Binned) -> tuple[IntArray, Array, Array]:
    """Return the bin (k,) of each event, and the numbers (n,) and means (n, 2) of each bin's."""
    bin_of_event, n_bins = bins.of(events), len(bins.bounds) - 1
    counts = np.bincount(bin_of_event, minlength=n_bins).astype(np.float64)
    sums = [np.bincount(bin_of_event, events[name], minlength=n_bins) for name in ("x", "y")]
    return bin_of_event, counts, np.stack(sums, axis=1) / np.maximum(counts, 1.0)[:, None]


def _sizes(
    sure: Events, bin_of_sure: IntArray, counts: Array, means_px: Array, rules: FaintRules
) -> Array | None:
    """Variances (n, 2) of the object's events about it; interpolated where it is not sure."""
    good = counts >= rules.min_bin_events
    of_good = good[bin_of_sure]
    n_free = _around(np.where(good, counts - 1.0, 0.0), rules.size_bins)
    enough = n_free >= rules.min_size_events
    if not enough.any():
        return None
    bins, sizes = np.arange(len(counts)), np.empty((len(counts), 2))
    for axis, name in enumerate(("x", "y")):
        squares = np.where(of_good, (sure[name] - means_px[bin_of_sure, axis]) ** 2, 0.0)
        in_bins = np.bincount(bin_of_sure, squares, minlength=len(counts))
        variances = _around(in_bins.astype(np.float64), rules.size_bins) / np.maximum(n_free, 1.0)
        sizes[:, axis] = np.interp(bins, bins[enough], variances[enough])
    return np.clip(sizes, rules.least_variances_px2, rules.max_variance_px2)


def _smoothed(
    weights: Array, means_px: Array, sizes_px2: Array, size: tuple[int, int], rules: FaintRules
) -> _Path:
    """Path of constant velocity but for a random acceleration, through the bins' means."""
    measured = weights > _LEAST_WEIGHT
    axes = [
        smoothed_path(
            np.ascontiguousarray(means_px[:, axis]),
            np.where(measured, sizes_px2[:, axis] / np.maximum(weights, _LEAST_WEIGHT), np.inf),
            1e-6 * rules.bin_us,
            rules.acceleration,
            rules.max_speed_variance,
        )
        for axis in (0, 1)
    ]
    positions, velocities, variances = (
        np.stack(columns, axis=1) for columns in zip(*axes, strict=True)
    )
    inside = np.all((positions >= 0.0) & (positions <= np.array(size) - 1.0), axis=1)
    known = inside & np.all(variances <= rules.lost_px**2, axis=1)
    around_px2 = sizes_px2 + np.where(known[:, None], variances, 0.0)
    return _Path(positions, velocities, variances, known, around_px2)


def _rates(
    bins: _Binned, path: _Path, limits: _Limits, size: tuple[int, int], rules: FaintRules
) -> tuple[Array, Array, Mask]:
    """Object's events in each bin, background events per bin and pixel, and where it is seen."""
    nothing, known = np.zeros(len(path.known)), path.known

    def around(values: Array) -> Array:
        return _around(np.where(known, values, 0.0), rules.window_bins)

    sums = _sums(bins, path, limits, nothing, nothing)
    area_px2 = np.pi * np.sqrt(np.prod(path.around_px2, axis=1))
    low = np.maximum(path.positions_px - rules.half_px, -0.5)
    high = np.minimum(path.positions_px + rules.half_px, np.array(size) - 0.5)
    around_px2 = np.prod(high - low, axis=1) - rules.around * area_px2
    around_px2 = np.maximum(around_px2, rules.least_around_px2)
    n_around, all_px2 = around(sums[:, 1]), np.maximum(around(around_px2), 1e-9)
    background = np.maximum(n_around / all_px2, rules.least_background)
    expected = around(background * rules.counted * area_px2)
    above = around(sums[:, 0]) - expected
    seen = known & (above > rules.significant * np.sqrt(expected + 1.0))
    n_known = np.maximum(around(np.ones(len(known))), 1.0)
    rates = above / n_known / (1.0 - np.exp(-0.5 * rules.counted))
    return np.where(seen, rates, 0.0), background, seen


def _dead_ends(seen: Mask, is_sure: Mask, dead_end_bins: int) -> Mask:
    """Mask (n,) of paths that join no two sure stretches, but for the bins next to a sure one."""
    dead = np.zeros(len(seen), np.bool_)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], seen & ~is_sure, [False]])))
    for first, last in edges.reshape(-1, 2):
        from_sure = first > 0 and is_sure[first - 1]
        to_sure = last < len(seen) and is_sure[last]
        if from_sure and to_sure:
            continue
        start = first + dead_end_bins if from_sure else first
        end = last - dead_end_bins if to_sure else last
        dead[start : max(start, end)] = True
    return dead


def _around(values: Array, bins: int) -> Array:
    """Sum up the values (n,) of each bin and of `bins` more on each side."""
    ends, index = np.append(0.0, np.cumsum(values)), np.arange(len(values))
    last = np.minimum(index + bins + 1, len(values))
    return np.asarray(ends[last] - ends[np.maximum(index - bins, 0)])


@numba.njit(cache=True)
def smoothed_path(
    means_px: Array, variances_px2: Array, step_s: float, density: float, max_speed_variance: float
) -> tuple[Array, Array, Array]:
    """Smooth one coordinate: a Kalman filter forward, Rauch, Tung and Striebel's smoother back.

    Bins (n,) of length `step_s` in which nothing was measured have an infinite variance. The
    acceleration is white noise of a density [px^2/s^3]; the velocity's variance [px^2/s^2] between
    two sights has a limit. Returns position, velocity and position variance in each bin (n,).
    """
    unknown = 1e6  # variance of what is not known yet, [px^2] and [px^2/s^2]
    n = len(means_px)
    states, covariances = np.zeros((n, 2)), np.zeros((n, 3))
    predicted, before = np.zeros((n, 2)), np.zeros((n, 3))
    x, v = 0.0, 0.0
    xx, xv, vv = unknown, 0.0, min(unknown, max_speed_variance)
    for k in range(n):
        if k > 0:
            x += step_s * v
            xx += 2.0 * step_s * xv + step_s**2 * vv + density * step_s**3 / 3.0
            xv += step_s * vv + density * step_s**2 / 2.0
            vv = min(vv + density * step_s, max_speed_variance)
        predicted[k, 0], predicted[k, 1] = x, v
        before[k, 0], before[k, 1], before[k, 2] = xx, xv, vv
        if np.isfinite(variances_px2[k]):
            total = xx + variances_px2[k]
            gain_x, gain_v = xx / total, xv / total
            innovation = means_px[k] - x
            x += gain_x * innovation
            v += gain_v * innovation
            vv -= gain_v * xv
            xv -= gain_x * xv
            xx -= gain_x * xx
        states[k, 0], states[k, 1] = x, v
        covariances[k, 0], covariances[k, 1], covariances[k, 2] = xx, xv, vv
    positions, velocities, variances = np.empty(n), np.empty(n), np.empty(n)
    positions[n - 1], velocities[n - 1], variances[n - 1] = x, v, xx
    for k in range(n - 2, -1, -1):
        a, b, c = covariances[k]
        p, q, r = before[k + 1]
        determinant = p * r - q * q
        a, b_next = a + step_s * b, b + step_s * c
        g_xx, g_xv = (a * r - b * q) / determinant, (b * p - a * q) / determinant
        g_vx, g_vv = (b_next * r - c * q) / determinant, (c * p - b_next * q) / determinant
        d_x, d_v = positions[k + 1] - predicted[k + 1, 0], velocities[k + 1] - predicted[k + 1, 1]
        positions[k] = states[k, 0] + g_xx * d_x + g_xv * d_v
        velocities[k] = states[k, 1] + g_vx * d_x + g_vv * d_v
        d_xx, d_xv, d_vv = xx - p, xv - q, vv - r
        t_xx, t_xv = g_xx * d_xx + g_xv * d_xv, g_xx * d_xv + g_xv * d_vv
        t_vx, t_vv = g_vx * d_xx + g_vv * d_xv, g_vx * d_xv + g_vv * d_vv
        xx = covariances[k, 0] + t_xx * g_xx + t_xv * g_xv
        xv = covariances[k, 1] + t_xx * g_vx + t_xv * g_vv
        vv = covariances[k, 2] + t_vx * g_vx + t_vv * g_vv
        variances[k] = xx
    return positions, velocities, variances


@numba.njit(cache=True)
def _sums(bins: _Binned, path: _Path, limits: _Limits, rates: Array, background: Array) -> Array:
    """Return (n, 5): events counted, events around; sums of weights, of weighted x and y."""
    # An event's weight is the object's share of the density of events there.
    x, y, ages_s, bounds, _, _ = bins
    positions_px, velocities_px_s, _, known, variances_px2 = path
    half_px, counted, inside, around = limits
    sums = np.zeros((len(known), 5))
    for k in range(len(known)):
        if not known[k]:
            continue
        a, b = variances_px2[k]
        peak = rates[k] / (2.0 * np.pi * np.sqrt(a * b))
        for i in range(bounds[k], bounds[k + 1]):
            dx = x[i] - positions_px[k, 0] - velocities_px_s[k, 0] * ages_s[i]
            dy = y[i] - positions_px[k, 1] - velocities_px_s[k, 1] * ages_s[i]
            if abs(dx) > half_px or abs(dy) > half_px:
                continue
            squares = dx * dx / a + dy * dy / b
            sums[k, 0] += squares < counted
            sums[k, 1] += squares > around
            if squares < inside and peak > 0.0:
                density = peak * np.exp(-0.5 * squares)
                weight = density / (density + background[k])
                sums[k, 2] += weight
                sums[k, 3] += weight * (dx + positions_px[k, 0])
                sums[k, 4] += weight * (dy + positions_px[k, 1])
    return sums
