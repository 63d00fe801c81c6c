"""All events of one camera in; those of a faint object, small and far away, out."""

from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from ssac.errors import SsacError
from ssac.track.clutter import activity, masked_pixels, unmasked
from ssac.track.denoise import radius_filter

N_NEIGHBOURS, MS_PER_UNIT, N_ROUNDS = 10, 8.0, 4
"""Of the radius filter: an image of 6 px that moves by 60 px/s has some 500 events a second, and
none has the paper authors' 20 neighbours within 5 ms. Noise and the edges of clouds have two in
this larger ball, and by chance ten; but such clumps have too few among themselves, and melt when
they are filtered again, while the object's events keep each other. From there it is followed
through the others."""


def faint_object_events(events: NDArray[np.void], width: int, height: int) -> NDArray[np.void]:
    """Find the events of one object that makes too few to be told from noise by their neighbours.

    What the radius filter leaves is surely the object's, but has gaps where it is far or slow;
    through these it is followed.

    Parameters
    ----------
    events
        All events of a camera, dtype EVENT_DTYPE, shape (m,), sorted by time.
    width, height
        Sensor size [px].

    Returns
    -------
    (k,) array
        Those of the object; those that are surely its own where they are too few to follow it.

    Raises
    ------
    SsacError
        When no event is surely of an object.
    """
    kept = unmasked(events, masked_pixels(activity(events, width, height)))
    sure = kept
    for _ in range(N_ROUNDS):
        sure = radius_filter(sure, ms_per_unit=MS_PER_UNIT, n_neighbours=N_NEIGHBOURS)
    if not len(sure):
        raise SsacError(
            f"of {len(events)} events none keeps {N_NEIGHBOURS} neighbours within 5 px (a px being"
            f" {MS_PER_UNIT:g} ms): no object is seen, or it is too faint even for --faint"
        )
    found = follow(kept, sure, width, height)
    return sure if found is None else found.events


Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

BIN_US = 20_000
"""Length of a bin [us]: a slow object goes less than its own size in it."""

ACCELERATION = 200.0
"""Density of the image's acceleration [px^2/s^3]: 20 px/s in two seconds, as of a drone that flies
5 m/s at 35 m. Of 200 and 600, chosen on four flights of the outdoor twin with seeds from 71,000."""

LOST_PX = 3.0
"""Deviation of the predicted place, from which nothing more is looked for."""

SIGNIFICANT = 6.0
"""Deviations of the background's number of events, above which the object is seen. With 4, a path
followed the edges of clouds for up to a tenth of the time."""

CORRIDOR_SIGMAS = 2.5
"""Half the corridor's width, in deviations of the object's image."""

_COUNTED = 4.0  # squared deviations: the best part of the object over the least background
_HALF_PX = 20.0  # of the square that tells the background
_WINDOW_BINS = 12  # on each side: half a second in which the object is seen, or is not
_SIZE_BINS = 25  # on each side: the image's size changes within seconds
_SURE_BINS, _SURE = 5, 10  # on each side, and events in them, where the object is sure
_DEAD_END_BINS = 25  # of a path that leads on from where the object is sure, and to no such place
_MOST_ROUNDS = 12
_ONE_PLACE_PX = 10.0  # half of what an image may be wide, and may move from a bin to the next
_LEAST_IN_CLUMP = 30  # events; chance and clouds leave clumps of up to 20
_LEAST_IN_SIZE, _LEAST_IN_BIN = 40, 4  # events
_LEAST_VARIANCES_PX2 = (1.0, 0.5)
_MOST_VARIANCE_PX2 = 64.0
_LEAST_AROUND_PX2 = 50.0
_LEAST_BACKGROUND = 1e-4  # events in a bin and a pixel
_LEAST_WEIGHT = 1e-3


@dataclass(frozen=True)
class Followed:
    """An object's path in the raw image, in bins of BIN_US from the first event on."""

    start_us: int
    positions_px: Array  # (n, 2) at the bins' middles
    velocities_px_s: Array  # (n, 2)
    half_sizes_px: Array  # (n, 2) of the corridor
    seen: Flags  # (n,)
    events: NDArray[np.void]  # of the corridor, where the object is seen


@dataclass(frozen=True)
class _Binned:
    """Events by bins."""

    events: NDArray[np.void]
    start_us: int
    ages_s: Array  # (m,) from the middle of the bin on
    bounds: NDArray[np.int64]  # (n + 1,) first event of each bin

    def __len__(self) -> int:
        return len(self.bounds) - 1

    def of(self, events: NDArray[np.void]) -> NDArray[np.int64]:
        """Give the bin of each of some events (k,)."""
        return np.asarray((events["t"] - self.start_us) // BIN_US)


@dataclass(frozen=True)
class _Path:
    positions_px: Array  # (n, 2)
    velocities_px_s: Array  # (n, 2)
    variances_px2: Array  # (n, 2) of the positions
    known: Flags  # (n,) well enough to look for events


def follow(
    events: NDArray[np.void], sure: NDArray[np.void], width: int, height: int
) -> Followed | None:
    """Follow the one object that a camera sees between and beyond where it is sure.

    Parameters
    ----------
    events
        All events of the camera, dtype EVENT_DTYPE, shape (m,), sorted by time; without what fires
        by itself (`ssac.track.clutter`).
    sure
        Those of them that a strict filter leaves: next to none of noise.
    width, height
        Sensor size [px].

    Returns
    -------
    Followed or None
        None where too few events are sure for the size of the object's image.
    """
    bins = _binned(events)
    sure = _lasting(sure, bins)
    bin_of_sure = bins.of(sure)
    counts, means_px = _means(sure, bin_of_sure, len(bins))
    sizes_px2 = _sizes(sure, bin_of_sure, counts, means_px)
    if sizes_px2 is None:
        return None
    weights, n_before = counts, -1
    for _ in range(_MOST_ROUNDS):
        path = _smoothed(weights, means_px, sizes_px2, (width, height))
        rates, background, seen = _rates(bins, path, sizes_px2, (width, height))
        sums = _sums(bins, path, sizes_px2, rates, background)
        weights = sums[:, 2]
        means_px = sums[:, 3:5] / np.maximum(weights, _LEAST_WEIGHT)[:, None]
        if np.count_nonzero(seen) <= n_before:
            break
        n_before = np.count_nonzero(seen)
    is_sure = (_around(counts, _SURE_BINS) >= _SURE) & seen
    seen = seen & ~_dead_ends(seen, is_sure)
    half_sizes_px = CORRIDOR_SIGMAS * np.sqrt(sizes_px2)
    where = path.positions_px, path.velocities_px_s, half_sizes_px
    inside = in_corridor(bins.ages_s, events["x"], events["y"], bins.bounds, seen, *where)
    return Followed(bins.start_us, *where, seen, events[inside])


def _binned(events: NDArray[np.void]) -> _Binned:
    times_us = events["t"]
    start_us = int(times_us[0])
    n = int(times_us[-1] - start_us) // BIN_US + 1
    bounds = np.searchsorted(times_us, start_us + BIN_US * np.arange(n + 1))
    ages_s = 1e-6 * ((times_us - start_us) % BIN_US - 0.5 * BIN_US)
    return _Binned(events, start_us, ages_s, bounds.astype(np.int64))


def _lasting(sure: NDArray[np.void], bins: _Binned) -> NDArray[np.void]:
    """Leave out what cannot be the one object: bins in two places, and clumps that do not last.

    If such a clump is the object's after all, it is found again when the object is followed.
    """
    for _ in range(2):  # the second time by means without what the first left out
        bin_of_sure = bins.of(sure)
        means_px = _means(sure, bin_of_sure, len(bins))[1][bin_of_sure]
        away_px = np.maximum(abs(sure["x"] - means_px[:, 0]), abs(sure["y"] - means_px[:, 1]))
        sure = sure[away_px < _ONE_PLACE_PX]
    bin_of_sure = bins.of(sure)
    counts, means_px = _means(sure, bin_of_sure, len(bins))
    full = np.flatnonzero(counts)
    jumps_px = np.max(np.abs(np.diff(means_px[full], axis=0)), axis=1, initial=0.0)
    is_break = (np.diff(full) > _SURE_BINS) | (jumps_px > _ONE_PLACE_PX)
    clump = np.zeros(len(bins), np.int64)
    clump[full[1:]] = np.cumsum(is_break)
    in_clump = np.bincount(clump[bin_of_sure], minlength=1)
    return np.asarray(sure[in_clump[clump[bin_of_sure]] >= _LEAST_IN_CLUMP])


def _means(
    events: NDArray[np.void], bin_of_event: NDArray[np.int64], n_bins: int
) -> tuple[Array, Array]:
    """Count the events of each bin (n,), and give their means (n, 2)."""
    counts = np.bincount(bin_of_event, minlength=n_bins).astype(np.float64)
    sums = [np.bincount(bin_of_event, events[name], minlength=n_bins) for name in ("x", "y")]
    return counts, np.stack(sums, axis=1) / np.maximum(counts, 1.0)[:, None]


def _sizes(
    sure: NDArray[np.void], bin_of_sure: NDArray[np.int64], counts: Array, means_px: Array
) -> Array | None:
    """Variances (n, 2) of the object's events about its place; in between where it is not sure."""
    good = counts >= _LEAST_IN_BIN
    of_good = good[bin_of_sure]
    n_free = _around(np.where(good, counts - 1.0, 0.0), _SIZE_BINS)
    enough = n_free >= _LEAST_IN_SIZE
    if not enough.any():
        return None
    bins, sizes = np.arange(len(counts)), np.empty((len(counts), 2))
    for axis, name in enumerate(("x", "y")):
        squares = np.where(of_good, (sure[name] - means_px[bin_of_sure, axis]) ** 2, 0.0)
        in_bins = np.bincount(bin_of_sure, squares, minlength=len(counts))
        variances = _around(in_bins.astype(np.float64), _SIZE_BINS) / np.maximum(n_free, 1.0)
        sizes[:, axis] = np.interp(bins, bins[enough], variances[enough])
    return np.clip(sizes, _LEAST_VARIANCES_PX2, _MOST_VARIANCE_PX2)


def _smoothed(weights: Array, means_px: Array, sizes_px2: Array, size: tuple[int, int]) -> _Path:
    """Path of constant velocity but for a random acceleration, through the bins' means."""
    measured = weights > _LEAST_WEIGHT
    axes = [
        smoothed_path(
            np.ascontiguousarray(means_px[:, axis]),
            np.where(measured, sizes_px2[:, axis] / np.maximum(weights, _LEAST_WEIGHT), np.inf),
            1e-6 * BIN_US,
            ACCELERATION,
        )
        for axis in (0, 1)
    ]
    positions, velocities, variances = (
        np.stack(columns, axis=1) for columns in zip(*axes, strict=True)
    )
    inside = np.all((positions >= 0.0) & (positions <= np.array(size) - 1.0), axis=1)
    known = inside & np.all(variances <= LOST_PX**2, axis=1)
    return _Path(positions, velocities, variances, known)


def _rates(
    bins: _Binned, path: _Path, sizes_px2: Array, size: tuple[int, int]
) -> tuple[Array, Array, Flags]:
    """Events of the object in each bin, of all else in a bin and a pixel, and where it is seen."""
    nothing = np.zeros(len(bins))
    sums, known = _sums(bins, path, sizes_px2, nothing, nothing), path.known
    area_px2 = np.pi * np.sqrt(np.prod(sizes_px2 + path.variances_px2, axis=1))
    low = np.maximum(path.positions_px - _HALF_PX, -0.5)
    high = np.minimum(path.positions_px + _HALF_PX, np.array(size) - 0.5)
    around_px2 = np.prod(high - low, axis=1) - AROUND * area_px2
    around_px2 = np.maximum(around_px2, _LEAST_AROUND_PX2)
    n_around = _around(np.where(known, sums[:, 1], 0.0), _WINDOW_BINS)
    all_px2 = np.maximum(_around(np.where(known, around_px2, 0.0), _WINDOW_BINS), 1e-9)
    background = np.maximum(n_around / all_px2, _LEAST_BACKGROUND)
    expected = np.where(known, background * _COUNTED * area_px2, 0.0)
    found = _around(np.where(known, sums[:, 0], 0.0), _WINDOW_BINS)
    expected = _around(expected, _WINDOW_BINS)
    above = found - expected
    seen = known & (above > SIGNIFICANT * np.sqrt(expected + 1.0))
    n_known = np.maximum(_around(np.where(known, 1.0, 0.0), _WINDOW_BINS), 1.0)
    rates = above / n_known / (1.0 - np.exp(-0.5 * _COUNTED))
    return np.where(seen, rates, 0.0), background, seen


def _sums(bins: _Binned, path: _Path, sizes_px2: Array, rates: Array, background: Array) -> Array:
    """Sum up the events about a path, as `sums_in_bins` does."""
    return sums_in_bins(
        bins.ages_s,
        bins.events["x"],
        bins.events["y"],
        bins.bounds,
        path.known,
        path.positions_px,
        path.velocities_px_s,
        sizes_px2 + np.where(path.known[:, None], path.variances_px2, 0.0),
        _HALF_PX,
        _COUNTED,
        rates,
        background,
    )


def _dead_ends(seen: Flags, is_sure: Flags) -> Flags:
    """Bins (n,) of paths that do not lead from where the object is sure to where it is again.

    Such a path may have taken a cloud for the object: only its first half second is kept.
    """
    dead = np.zeros(len(seen), np.bool_)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], seen & ~is_sure, [False]])))
    for first, last in edges.reshape(-1, 2):
        from_sure = first > 0 and is_sure[first - 1]
        to_sure = last < len(seen) and is_sure[last]
        if from_sure and to_sure:
            continue
        start = first + _DEAD_END_BINS if from_sure else first
        end = last - _DEAD_END_BINS if to_sure else last
        dead[start : max(start, end)] = True
    return dead


def _around(values: Array, bins: int) -> Array:
    """Sum up the values (n,) of each bin and so many on each side."""
    ends = np.concatenate([[0.0], np.cumsum(values)])
    index = np.arange(len(values))
    last = np.minimum(index + bins + 1, len(values))
    return np.asarray(ends[last] - ends[np.maximum(index - bins, 0)])


INSIDE = 9.0
"""Squared deviations up to which an event may be the object's."""

AROUND = 20.0
"""Squared deviations from which an event tells how much there is beside the object."""

N_SUMS = 5  # columns of `sums_in_bins`

_UNKNOWN = 1e6  # variance of what is not known yet, [px^2] and [px^2/s^2]
_FASTEST = 1e4  # variance of velocities between two sights [px^2/s^2]


@numba.njit(cache=True)
def smoothed_path(
    means_px: Array, variances_px2: Array, step_s: float, density: float
) -> tuple[Array, Array, Array]:
    """Smooth one coordinate: a Kalman filter forward, Rauch, Tung and Striebel's smoother back.

    Parameters
    ----------
    means_px, variances_px2
        Measured in each bin (n,); of infinite variance where nothing was.
    step_s
        Length of a bin.
    density
        Of the acceleration, which is white noise [px^2/s^3].

    Returns
    -------
    tuple
        Position [px], velocity [px/s] and the position's variance [px^2] in each bin (n,).
    """
    n = len(means_px)
    states, covariances = np.zeros((n, 2)), np.zeros((n, 3))
    predicted, before = np.zeros((n, 2)), np.zeros((n, 3))
    x, v = 0.0, 0.0
    xx, xv, vv = _UNKNOWN, 0.0, _UNKNOWN
    for k in range(n):
        if k > 0:
            x += step_s * v
            xx += 2.0 * step_s * xv + step_s**2 * vv + density * step_s**3 / 3.0
            xv += step_s * vv + density * step_s**2 / 2.0
            vv = min(vv + density * step_s, _FASTEST)
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
def sums_in_bins(
    ages_s: Array,
    x: NDArray[np.uint16],
    y: NDArray[np.uint16],
    bounds: NDArray[np.int64],
    known: NDArray[np.bool_],
    positions_px: Array,
    velocities_px_s: Array,
    variances_px2: Array,
    half_px: float,
    counted: float,
    rates: Array,
    background: Array,
) -> Array:
    """Sum up the events about a path, bin by bin.

    Parameters
    ----------
    ages_s
        Of the events (m,), from the middle of their bins on.
    x, y
        Of the events (m,).
    bounds
        First event of each bin, and the one after the last (n + 1,).
    known
        Bins (n,) to be summed up.
    positions_px, velocities_px_s
        Of the path (n, 2).
    variances_px2
        Of the events about the path (n, 2).
    half_px
        Half the side of the square in which what lies around is counted.
    counted
        Squared deviations up to which an event is counted.
    rates, background
        Events of the object in a bin (n,), and of all else in a bin and a pixel (n,).

    Returns
    -------
    Array
        (n, N_SUMS): events counted, events around; weights, of each event the share of the
        object in all that is there; and weighted sums of x and y.
    """
    sums = np.zeros((len(known), N_SUMS))
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
            sums[k, 1] += squares > AROUND
            if squares < INSIDE and peak > 0.0:
                density = peak * np.exp(-0.5 * squares)
                weight = density / (density + background[k])
                sums[k, 2] += weight
                sums[k, 3] += weight * (dx + positions_px[k, 0])
                sums[k, 4] += weight * (dy + positions_px[k, 1])
    return sums


@numba.njit(cache=True)
def in_corridor(
    ages_s: Array,
    x: NDArray[np.uint16],
    y: NDArray[np.uint16],
    bounds: NDArray[np.int64],
    seen: NDArray[np.bool_],
    positions_px: Array,
    velocities_px_s: Array,
    half_sizes_px: Array,
) -> NDArray[np.bool_]:
    """Tell which events (m,) lie in an ellipse of half axes (n, 2) about a path, where it is seen.

    Other parameters as of `sums_in_bins`.
    """
    inside = np.zeros(len(ages_s), np.bool_)
    for k in range(len(seen)):
        if not seen[k]:
            continue
        for i in range(bounds[k], bounds[k + 1]):
            dx = x[i] - positions_px[k, 0] - velocities_px_s[k, 0] * ages_s[i]
            dy = y[i] - positions_px[k, 1] - velocities_px_s[k, 1] * ages_s[i]
            inside[i] = (dx / half_sizes_px[k, 0]) ** 2 + (dy / half_sizes_px[k, 1]) ** 2 < 1.0
    return inside
