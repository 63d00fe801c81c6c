"""Remove noise: the events of pixels that fire by themselves, and isolated events.

Lamps that flicker and hot pixels are no part of anything that moves, yet a cluster of them looks
like an object to a filter of isolated events. Unlike an object they never pause, and they have a
sharp edge: whatever moves leaves events all around the place where it stays.

How many neighbours an event needs follows from the noise that is there, and from how many events
the object makes; the paper's 20 are what an ordinary drone in ordinary light needs.
"""

from dataclasses import dataclass

import numba
import numpy as np
from scipy.ndimage import binary_dilation, find_objects, label
from scipy.special import pdtrc

from ssac.arrays import Events, Indices, Int32Array, IntArray, Mask, Pixels
from ssac.config import N_MIN
from ssac.events import first_from
from ssac.rules import NoiseRules

US_PER_MS = 1000.0


@dataclass(frozen=True)
class Clutter:
    """What denoising found in the events of one camera, and what it did to them."""

    masked_pixels: int  # which fire by themselves: lamps and hot pixels
    masked_events: int
    background_hz: float  # of an ordinary pixel
    radius_px: float  # of the radius filter's ball, which reaches as many ms in time
    n_neighbours: int  # that an event needs in the ball
    n_min: int  # least events in a valid window, unless the config says how many

    @property
    def is_adapted(self) -> bool:
        """Whether the values differ from the paper's."""
        used = self.radius_px, self.n_neighbours, self.n_min
        return used != (NoiseRules.ball_px, NoiseRules.ball_neighbours, N_MIN)


def without_noise(
    events: Events, width: int, height: int, n_neighbours: int | None, rules: NoiseRules
) -> tuple[Events, Clutter]:
    """Remove pixels that fire by themselves, then isolated events; return the rest and a summary.

    An event needs `n_neighbours` in the paper's ball. None: the paper's number, or fewer, as noise
    allows, where the object makes few events; in much noise the smaller ball, likewise.
    """
    mask, hz = masked_pixels(events, width, height, rules)
    kept, size_px = unmasked(events, mask), (width, height)
    radius_px, n = rules.ball_px, n_neighbours or rules.ball_neighbours
    if n_neighbours is None and hz > rules.noisy_hz:
        radius_px, near_n = rules.near_ball_px, rules.near_ball_neighbours
        n = least_neighbours(hz, width * height, radius_px, near_n, rules)
        left = radius_filter(kept, radius_px, n_neighbours=n, size_px=size_px)
        fewer = radius_filter(left, radius_px, n_neighbours=near_n, size_px=size_px)
        if len(fewer) > rules.min_kept_share * len(left):
            left, n = fewer, near_n
    else:
        left = radius_filter(kept, radius_px, n_neighbours=n, size_px=size_px)
        if n_neighbours is None and _events_per_window(left, rules) < rules.thin_ratio * N_MIN:
            n = least_neighbours(hz, width * height, radius_px, rules.ball_neighbours, rules)
            left = radius_filter(kept, radius_px, n_neighbours=n, size_px=size_px)
    n_min, in_window = N_MIN, _events_per_window(left, rules)
    if in_window < rules.thin_ratio * N_MIN:
        n_min = int(np.clip(rules.thin_n_min_share * in_window, rules.least_n_min, N_MIN))
    return left, Clutter(int(mask.sum()), len(events) - len(kept), hz, radius_px, n, n_min)


def least_neighbours(
    background_hz: float, n_pixels: int, radius_px: float, most: int, rules: NoiseRules
) -> int:
    """Fewest neighbours, up to `most`, that leave at most one event of noise in a window."""
    in_ball = background_hz * 4.0 / 3.0 * np.pi * radius_px**3 / US_PER_MS
    in_window = background_hz * n_pixels * rules.window_s
    for n in range(rules.least_neighbours, most):
        if in_window * pdtrc(n - 1, in_ball) <= 1.0:  # Poisson probability of n or more
            return n
    return most


def _events_per_window(events: Events, rules: NoiseRules) -> float:
    """Median number of events in windows about up to a thousand of them; 0 without events."""
    t = events["t"]
    if len(t) == 0:
        return 0.0
    some = t[:: -(-len(t) // 1000)]
    half_us = round(0.5e6 * rules.window_s)
    return float(np.median(first_from(t, some + half_us) - first_from(t, some - half_us)))


def radius_filter(
    events: Events,
    radius_px: float = NoiseRules.ball_px,
    ms_per_unit: float = 1.0,
    n_neighbours: int = NoiseRules.ball_neighbours,
    size_px: tuple[int, int] | None = None,
) -> Events:
    """Keep the events with enough neighbours in a ball of x-y-t space, as the paper's authors do.

    Of events sorted by time, one is kept when at least `n_neighbours` others lie within `radius_px`
    of it (the boundary counts), where `ms_per_unit` milliseconds count as one pixel. The sensor's
    width and height are `size_px`; None: as far as the events reach.

    Events in the core of the ball are counted as they enter and leave it, and an event whose core
    holds enough is kept at once. For any other event the pixels of the ball are searched, the
    nearest first, each from its latest event back.
    """
    if len(events) <= n_neighbours:
        return events[:0]
    t, x, y = events["t"], events["x"], events["y"]
    offsets_px, spans_us = _ball(radius_px, US_PER_MS * ms_per_unit)
    width, height = size_px or (int(x.max()) + 1, int(y.max()) + 1)
    margin_px = int(radius_px)
    n_rows = height + 2 * margin_px
    # The core: pixels within 0.4 of the squared radius. The share does not change the result.
    squared_px = max(0.4 * radius_px**2, 1.0)
    core_us = int(np.min(spans_us[np.sum(offsets_px**2, axis=1) <= squared_px]))
    if radius_px < 1.0:  # the core is larger than the ball: it counts nothing
        core_us = -(1 << 61)
    steps = offsets_px[:, 0] * n_rows + offsets_px[:, 1]
    sensor = width + 2 * margin_px, n_rows, margin_px
    ball = steps, spans_us, _core(squared_px, n_rows), core_us
    longest_us = max(core_us, 0) // 8
    return events.compress(_has_neighbours(t, x, y, sensor, *ball, longest_us, n_neighbours))


def _core(squared_px: float, n_rows: int) -> tuple[int, ...]:
    """Offsets, by columns of `n_rows`, to the middles of vertical pixel triples in the circle."""
    reach_px, found = int(np.sqrt(squared_px)), []
    for column in range(-reach_px, reach_px + 1):
        n_threes = (2 * int(np.sqrt(squared_px - column**2)) + 1) // 3
        top = -(3 * n_threes // 2)
        found += [column * n_rows + top + 3 * k + 1 for k in range(n_threes)]
    return tuple(found)


def _ball(radius_px: float, us_per_px: float) -> tuple[IntArray, IntArray]:
    """Offsets (k, 2) [px] of a ball's pixels, nearest first; its half-lengths there (k,) [us]."""
    axis_px = np.arange(-int(radius_px), int(radius_px) + 1)
    offsets_px = np.stack(np.meshgrid(axis_px, axis_px, indexing="ij"), axis=-1).reshape(-1, 2)
    squares_px = np.sum(offsets_px**2, axis=1)
    order = np.argsort(squares_px, kind="stable")
    order = order[squares_px[order] <= radius_px**2]
    left = (radius_px**2 - squares_px[order]) * us_per_px**2
    spans_us = np.floor(np.sqrt(left))
    spans_us += (spans_us + 1.0) ** 2 <= left  # a perfect square's root may come out too small
    return offsets_px[order], spans_us.astype(np.int64)


@numba.njit(cache=True)
def _has_neighbours(
    t: IntArray,
    x: Pixels,
    y: Pixels,
    sensor: tuple[int, int, int],
    steps: IntArray,
    spans_us: IntArray,
    core: tuple[int, ...],
    core_us: int,
    longest_us: int,
    n_neighbours: int,
) -> Mask:
    """Tell which events have `n_neighbours` others at `steps` from their cells, in `spans_us`."""
    # All cells at most one row from those of `core` are in the ball for `core_us`. Loops over a
    # tuple are unrolled, and an unsigned index is not checked for negative values.
    n, radius_us = len(t), spans_us[0]
    together = 64  # events in a batch, so that loops are few, and long
    n_columns, n_rows, margin_px = sensor
    # A pixel's events are a linked list from its latest one back.
    previous, cells = np.empty(n, np.int32), np.empty(n, np.int32)
    latest = np.full(n_columns * n_rows, -1, np.int32)
    counts = np.zeros(n_columns * n_rows, np.int32)  # within `core_us`, in three rows of a column
    chains, chain_spans_us = np.empty(len(steps) + 1, np.int32), np.empty(len(steps) + 1, np.int64)

    keep = np.zeros(n, np.bool_)
    start = first = end = first_of_core = end_of_core = 0
    while start < n:
        stop, last = start + 1, min(start + together, n)
        while stop < last and t[stop] - t[start] <= longest_us:
            stop += 1
        earliest_us, latest_us = t[start], t[stop - 1]
        while first_of_core < end_of_core and t[first_of_core] < latest_us - core_us:
            cell = cells[np.uint32(first_of_core)]
            for row in (-1, 0, 1):
                counts[np.uint32(cell + row)] -= 1
            first_of_core += 1
        while end < n and t[end] <= latest_us + radius_us:
            cell = (np.int64(x[end]) + margin_px) * n_rows + np.int64(y[end]) + margin_px
            cells[np.uint32(end)] = cell
            previous[np.uint32(end)] = latest[cell]
            latest[cell] = end
            end += 1
        while end_of_core < end and t[end_of_core] <= earliest_us + core_us:
            cell = cells[np.uint32(end_of_core)]
            for row in (-1, 0, 1):
                counts[np.uint32(cell + row)] += 1
            end_of_core += 1
        while t[first] < earliest_us - radius_us:
            first += 1
        for i in range(start, stop):
            here = cells[np.uint32(i)]
            n_found = -1  # the event finds itself
            for step in core:
                n_found += counts[np.uint32(here + step)]
            if n_found < n_neighbours:
                n_found = -1
                n_chains = 0  # of pixels with events; counted without a branch to predict
                for k in range(len(steps)):
                    j = chains[n_chains] = latest[np.uint32(here + steps[k])]
                    chain_spans_us[n_chains] = spans_us[k]
                    n_chains += j >= first
                for k in range(n_chains):
                    j, span_us = chains[k], chain_spans_us[k]
                    while j >= first and t[i] - t[j] <= span_us:
                        n_found += t[j] - t[i] <= span_us
                        j = previous[np.uint32(j)]
                    if n_found >= n_neighbours:
                        break
            keep[i] = n_found >= n_neighbours
        start = stop
    return keep


def masked_pixels(events: Events, width: int, height: int, rules: NoiseRules) -> tuple[Mask, float]:
    """Tell the pixels (height, width) that fire by themselves, and the background of others [Hz].

    The background is the mean of the middle fifth of all squares in all bins, ordered by events: an
    object that covers less than 40 % of the sensor, or a burst at the start, has no part in it.
    """
    starts = _starts_of_bins(events["t"], rules.bin_us)
    counts, active, n_bins, squares = _count(
        starts, events["x"], events["y"], width, height, rules.parts, rules.square_px
    )
    ends = np.cumsum(squares)
    low, high = 0.4 * ends[-1], 0.6 * ends[-1]
    weights = np.clip(ends, low, high) - np.clip(ends - squares, low, high)
    of_square = float(weights @ np.arange(len(squares)) / max(high - low, 1.0))
    hz = of_square / (rules.square_px**2 * (1e-6 * rules.bin_us))
    lone = _lone_pixels(counts, rules)
    return lone | _clusters(counts, active, n_bins, hz, lone, rules), hz


def unmasked(events: Events, masked: Mask) -> Events:
    """Leave out events (n,) of masked pixels (height, width); the same array if none is masked."""
    if not masked.any():
        return events
    return events.compress(of_pixels(~masked, events["x"], events["y"]))


@numba.njit(cache=True)
def of_pixels(chosen: Mask, x: Pixels, y: Pixels) -> Mask:
    """Tell which events (n,) are of chosen pixels (height, width); it makes no other array (n,)."""
    found = np.empty(len(x), np.bool_)
    for i in range(len(x)):
        found[i] = chosen[y[i], x[i]]
    return found


@numba.njit(cache=True)
def _starts_of_bins(t: IntArray, bin_us: int) -> Indices:
    """Index of the first event of each bin that has events; the last is the number of events."""
    starts, first = [0], 0
    while first < len(t):
        end_us = t[first] + bin_us - (t[first] - t[0]) % bin_us
        first += np.searchsorted(t[first:], end_us)
        starts.append(first)
    return np.array(starts)


@numba.njit(cache=True)
def _count(
    starts: Indices, x: Pixels, y: Pixels, width: int, height: int, parts: int, square_px: int
) -> tuple[IntArray, Int32Array, IntArray, IntArray]:
    """Count events and active bins by pixel, bins by part, and squares by their events in a bin."""
    n_pixels = height * width
    counts, active = np.zeros(n_pixels, np.int64), np.zeros((parts, n_pixels), np.int32)
    in_bin, touched = np.zeros(n_pixels, np.int32), np.empty(n_pixels + 1, np.int32)
    n_bins = np.zeros(parts, np.int64)
    in_square = np.zeros((height // square_px + 1, width // square_px + 1), np.int64)
    squares = np.zeros((1 << 14) + 1, np.int64)  # squares with more events count as the last
    total = len(starts) - 1
    for k in range(total):
        part = k * parts // total
        n_bins[part] += 1
        n_touched = 0
        for i in range(starts[k], starts[k + 1]):
            pixel = np.uint32(np.int64(y[i]) * width + x[i])
            touched[n_touched] = pixel  # overwritten if the pixel was touched before
            n_touched += in_bin[pixel] == 0
            in_bin[pixel] += 1
        for pixel in touched[:n_touched]:
            n = in_bin[pixel]
            in_bin[pixel] = 0
            counts[pixel] += n
            active[part, pixel] += 1
            in_square[pixel // width // square_px, pixel % width // square_px] += n
        for row in range(height // square_px):
            for column in range(width // square_px):
                squares[min(in_square[row, column], len(squares) - 1)] += 1
        in_square[:] = 0
    shape = height, width
    return counts.reshape(shape), active.reshape((parts, *shape)), n_bins, squares


def _lone_pixels(counts: IntArray, rules: NoiseRules) -> Mask:
    """Pixels with many events beside few such pixels: an object's edge has as many all along."""
    rows, columns = np.nonzero(counts >= rules.min_masked_events)
    own, around = counts[rows, columns], np.pad(counts, 2, constant_values=-1)
    n_companions = np.full(len(own), -1)  # the pixel finds itself
    for i, j in np.ndindex(5, 5):
        n_companions += around[rows + i, columns + j] * rules.comparable_ratio >= own
    lone = np.zeros(counts.shape, np.bool_)
    lone[rows, columns] = n_companions < rules.min_companions
    return lone


def _clusters(
    counts: IntArray, active: Int32Array, n_bins: IntArray, hz: float, lone: Mask, rules: NoiseRules
) -> Mask:
    """Clusters that never pause, with few events around: slow objects leave, or blur their edge."""
    clusters = np.zeros(counts.shape, np.bool_)
    total = int(np.sum(n_bins))
    if total < rules.min_bins_per_part * rules.parts:
        return clusters
    background = 1e-6 * rules.bin_us * total * hz  # events of an ordinary pixel
    least = max(rules.min_masked_events, rules.min_over_background * background)
    restless = ~lone & (counts > least)
    for in_part, n in zip(active, n_bins, strict=True):
        restless &= in_part > rules.min_active_share * n
    neighbours = np.ones((3, 3), np.bool_)
    labels = np.zeros(restless.shape, np.int32)
    label(restless, neighbours, output=labels)
    others = ~lone & ~restless
    for number, parts in enumerate(find_objects(labels), start=1):
        box = tuple(slice(max(part.start - 1, 0), part.stop + 1) for part in parts)
        cluster = labels[box] == number
        ring = binary_dilation(cluster, neighbours) & others[box]
        if np.sum(cluster) < rules.min_cluster_px or not ring.any():
            continue
        own, around = (np.median(counts[box][part]) for part in (cluster, ring))
        if around - background <= rules.max_ring_share * (own - background):
            clusters[box] |= cluster
    return clusters
