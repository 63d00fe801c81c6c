"""The loops over events behind the radius filter, compiled."""

import numba
import numpy as np
from numpy.typing import NDArray

_SLOTS = 16  # of time, on each side, in which tiles are counted
_TOGETHER, _PARTS = 64, 8  # events at most whose boxes are one, and of a box's half time
_LEAP = 16  # events by which the first that a ball may reach moves on
_LOOK = 64  # events between two looks at how many there are in a time


@numba.njit(cache=True)
def has_neighbours(
    t: NDArray[np.int64],
    x: NDArray[np.uint16],
    y: NDArray[np.uint16],
    sensor: tuple[int, int, int],
    steps: NDArray[np.int64],
    spans_us: NDArray[np.int64],
    core: tuple[int, ...],
    core_us: int,
    n_neighbours: int,
) -> NDArray[np.bool_]:
    """Whether each event has `n_neighbours` others within a ball.

    The sensor is of so many columns and rows of cells, so many of which are a margin on each side.
    The ball is of cells `steps` from an event's, the nearest first, for `spans_us` before and after
    it; all that are at most one row from `core` belong to it for `core_us`. As the core is a tuple,
    of a length that is known, loops over it are compiled without a loop; and an index without a
    sign needs no look whether it counts from the end.
    """
    n, radius_us = len(t), spans_us[0]
    longest_us = core_us // _PARTS  # events are taken by so many, so that loops are few, and long
    n_columns, n_rows, margin_px = sensor
    length = _power_above(_most_within(t, 2 * radius_us + longest_us))
    mask = np.uint32(length - 1)
    # A pixel's events are a chain from its latest one back, kept for as long as a ball reaches.
    previous, cells = np.empty(length, np.int32), np.empty(length, np.int32)
    latest = np.full(n_columns * n_rows, -1, np.int32)
    counts = np.zeros(n_columns * n_rows, np.int32)  # in the core's time, of three rows, by column
    chains, chain_spans_us = np.empty(len(steps) + 1, np.int32), np.empty(len(steps) + 1, np.int64)

    keep = np.zeros(n, np.bool_)
    start = first = end = first_of_core = end_of_core = 0
    while start < n:
        stop, last = start + 1, min(start + _TOGETHER, n)
        while stop < last and t[stop] - t[start] <= longest_us:
            stop += 1
        earliest_us, latest_us = t[start], t[stop - 1]
        # What leaves comes first, while the rings still hold it: a gap in time may be long.
        while first_of_core < end_of_core and t[first_of_core] < latest_us - core_us:
            cell = cells[np.uint32(first_of_core) & mask]
            for row in (-1, 0, 1):
                counts[np.uint32(cell + row)] -= 1
            first_of_core += 1
        while end < n and t[end] <= latest_us + radius_us:
            cell = (np.int64(x[end]) + margin_px) * n_rows + np.int64(y[end]) + margin_px
            cells[np.uint32(end) & mask] = cell
            previous[np.uint32(end) & mask] = latest[cell]
            latest[cell] = end
            end += 1
        while end_of_core < end and t[end_of_core] <= earliest_us + core_us:
            cell = cells[np.uint32(end_of_core) & mask]
            for row in (-1, 0, 1):
                counts[np.uint32(cell + row)] += 1
            end_of_core += 1
        while first + _LEAP < n and t[first + _LEAP] < earliest_us - radius_us:
            first += _LEAP  # at most the first that a ball reaches, which the rings still hold
        for i in range(start, stop):
            here = cells[np.uint32(i) & mask]
            n_found = -1  # the event finds itself
            for step in core:
                n_found += counts[np.uint32(here + step)]
            if n_found < n_neighbours:
                n_found = -1
                n_chains = 0  # of pixels where anything happened: to foresee which is no use
                for k in range(len(steps)):
                    j = chains[n_chains] = latest[np.uint32(here + steps[k])]
                    chain_spans_us[n_chains] = spans_us[k]
                    n_chains += j >= first
                for k in range(n_chains):
                    j, span_us = chains[k], chain_spans_us[k]
                    while j >= first and t[i] - t[j] <= span_us:
                        n_found += t[j] - t[i] <= span_us
                        j = previous[np.uint32(j) & mask]
                    if n_found >= n_neighbours:
                        break
            keep[i] = n_found >= n_neighbours
        start = stop
    return keep


@numba.njit(cache=True)
def has_neighbours_in_noise(
    t: NDArray[np.int64],
    x: NDArray[np.uint16],
    y: NDArray[np.uint16],
    offsets_px: NDArray[np.int64],
    spans_us: NDArray[np.int64],
    n_neighbours: int,
) -> NDArray[np.bool_]:
    """Tell the same as `has_neighbours`, fast where next to all events have too few.

    The events of square tiles are counted over the ball's time: few counters, which stay near.
    """
    n, radius_us = len(t), spans_us[0]
    slot_us = radius_us // _SLOTS + 1
    margin_px = int(np.max(offsets_px))
    n_columns, n_rows = extent(x, y)
    n_columns, n_rows = n_columns + 2 * margin_px, n_rows + 2 * margin_px
    steps = offsets_px[:, 0] * n_rows + offsets_px[:, 1]
    bits = 0  # a tile's side is a power of two, at least the ball's radius
    while 1 << bits < margin_px:
        bits += 1
    tiles = np.zeros(((n_columns >> bits) + 1, (n_rows >> bits) + 1), np.int32)
    length = _power_above(_most_within(t, 2 * radius_us + slot_us))
    previous = np.empty(length, np.int64)
    latest = np.full(n_columns * n_rows, -1, np.int64)

    keep = np.zeros(n, np.bool_)
    start = first = end = 0
    while start < n:
        slot_start_us = t[0] + (t[start] - t[0]) // slot_us * slot_us
        slot_end_us = slot_start_us + slot_us
        while first < end and t[first] < slot_start_us - radius_us:
            tiles[(x[first] + margin_px) >> bits, (y[first] + margin_px) >> bits] -= 1
            first += 1
        while end < n and t[end] < slot_end_us + radius_us:
            column, row = x[end] + margin_px, y[end] + margin_px
            tiles[column >> bits, row >> bits] += 1
            previous[end & (length - 1)] = latest[column * n_rows + row]
            latest[column * n_rows + row] = end
            end += 1
        while start < n and t[start] < slot_end_us:
            column, row = int(x[start]), int(y[start])
            n_around = -1  # the event finds itself
            for i in range(column >> bits, ((column + 2 * margin_px) >> bits) + 1):
                for j in range(row >> bits, ((row + 2 * margin_px) >> bits) + 1):
                    n_around += tiles[i, j]
            if n_around >= n_neighbours:
                here = (column + margin_px) * n_rows + row + margin_px
                n_found = -1
                for k in range(len(steps)):
                    j = latest[here + steps[k]]
                    while j >= first and t[start] - t[j] <= spans_us[k]:
                        n_found += t[j] - t[start] <= spans_us[k]
                        j = previous[j & (length - 1)]
                    if n_found >= n_neighbours:
                        break
                keep[start] = n_found >= n_neighbours
            start += 1
    return keep


@numba.njit(cache=True)
def extent(x: NDArray[np.uint16], y: NDArray[np.uint16]) -> tuple[int, int]:
    """Columns and rows that hold all events."""
    largest_x = largest_y = 0
    for i in range(len(x)):
        largest_x, largest_y = max(largest_x, x[i]), max(largest_y, y[i])
    return largest_x + 1, largest_y + 1


@numba.njit(cache=True)
def _most_within(t: NDArray[np.int64], duration_us: int) -> int:
    """Bound the events of the busiest stretch of time, both ends included, from above.

    By looking at every 64th event alone.
    """
    most = end = 0
    for start in range(0, len(t) + _LOOK, _LOOK):
        last_us = t[min(start, len(t) - 1)] + duration_us
        while end < len(t) and t[end] <= last_us:
            end += _LOOK
        most = max(most, end - start + _LOOK)  # any stretch that begins after `start - _LOOK`
    return most


@numba.njit(cache=True)
def _power_above(number: int) -> int:
    power = 1
    while power < number:
        power *= 2
    return power
