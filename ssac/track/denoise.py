"""Events in, the events of the moving object out: hot pixels and isolated events removed."""

import numba
import numpy as np
from numpy.typing import NDArray

US_PER_MS = 1000.0

_SLOTS = 16  # of time, on each side, in the box that is counted
_BOX = 0.4  # half the side of the box that is counted, over the radius: it settles most events


def remove_hot_pixels(
    events: NDArray[np.void],
    width: int,
    height: int,
    min_events: int = 50,
    count_ratio: float = 8.0,
    min_companions: int = 2,
) -> NDArray[np.void]:
    """Events without those of pixels that fire by themselves.

    A pixel is hot when it has many events and fewer than `min_companions` of the 24 pixels around
    it have a comparable number. Whatever the object does, its image is larger than a pixel and an
    edge of it that passes, or stays, leaves similar counts along itself; a hot pixel stands alone.

    Parameters
    ----------
    events
        Events, dtype EVENT_DTYPE, shape (N,).
    width, height
        Sensor size [px].
    min_events
        Pixels with fewer events are never called hot.
    count_ratio
        Another pixel is comparable when its count times this ratio reaches the pixel's own.
    min_companions
        Comparable pixels that make a pixel part of an image; so up to this many hot pixels side by
        side are still found.

    Returns
    -------
    NDArray[np.void]
        The events of all other pixels, in the same order.
    """
    counts = _event_counts(events["x"], events["y"], width, height)
    hot = _lone_pixels(counts, min_events, count_ratio, min_companions)
    if not hot.any():
        return events
    return chosen_events(events, of_pixels(~hot, events["x"], events["y"]))


@numba.njit(cache=True)
def _event_counts(
    x: NDArray[np.uint16], y: NDArray[np.uint16], width: int, height: int
) -> NDArray[np.int64]:
    """Count the events of each pixel (height, width)."""
    counts = np.zeros((height, width), np.int64)
    for i in range(len(x)):
        counts[y[i], x[i]] += 1
    return counts


@numba.njit(cache=True)
def _lone_pixels(
    counts: NDArray[np.int64], min_events: int, count_ratio: float, min_companions: int
) -> NDArray[np.bool_]:
    """Whether each pixel (height, width) has many events, and too few of those around it have.

    Pixel by pixel: the neighbourhoods of all of them side by side would be 25 times the sensor.
    """
    height, width = counts.shape
    lone = np.zeros((height, width), np.bool_)
    for row in range(height):
        for column in range(width):
            own = counts[row, column]
            if own < min_events:
                continue
            n_companions = -1  # the pixel finds itself
            for i in range(max(row - 2, 0), min(row + 3, height)):
                for j in range(max(column - 2, 0), min(column + 3, width)):
                    n_companions += counts[i, j] * count_ratio >= own
            lone[row, column] = n_companions < min_companions
    return lone


@numba.njit(cache=True)
def chosen_events(events: NDArray[np.void], chosen: NDArray[np.bool_]) -> NDArray[np.void]:
    """Copy the events (n,) where `chosen` (n,) holds: as indexing does, but four times as fast."""
    n = 0
    for i in range(len(chosen)):
        n += chosen[i]
    found = np.empty(n, events.dtype)
    n = 0
    for i in range(len(chosen)):
        if chosen[i]:
            found[n] = events[i]
            n += 1
    return found


@numba.njit(cache=True)
def of_pixels(
    chosen: NDArray[np.bool_], x: NDArray[np.uint16], y: NDArray[np.uint16]
) -> NDArray[np.bool_]:
    """Whether each event (n,) is of a chosen pixel (height, width), with no other array (n,)."""
    found = np.empty(len(x), np.bool_)
    for i in range(len(x)):
        found[i] = chosen[y[i], x[i]]
    return found


def radius_filter(
    events: NDArray[np.void],
    radius_px: float = 5.0,
    ms_per_unit: float = 1.0,
    n_neighbours: int = 20,
) -> NDArray[np.void]:
    """Events with enough neighbours in a ball of x-y-t space, as the paper's authors filter.

    Time is scaled so that `ms_per_unit` milliseconds count as much as one pixel. An event is kept
    when at least `n_neighbours` other events lie within `radius_px` of it (the boundary counts).

    Parameters
    ----------
    events
        Events, dtype EVENT_DTYPE, shape (N,), sorted by time.
    radius_px
        Radius of the ball [px].
    ms_per_unit
        Length of the time axis's unit [ms/px].
    n_neighbours
        Neighbours needed, the event itself not counted.

    Returns
    -------
    NDArray[np.void]
        The kept events, in the same order.

    Notes
    -----
    A box that fits into the ball has its events counted as they come and go, and where it holds
    enough the event is kept at a cost that depends neither on the rate of events nor on the size of
    the sensor. For the others, the events of each pixel around are looked through from the latest
    one on, the nearest pixels first. The result is exact.
    """
    if len(events) <= n_neighbours:
        return events[:0]
    box_px = int(_BOX * radius_px)
    offsets_px, spans_us = _ball(radius_px, US_PER_MS * ms_per_unit)
    of_box = np.max(np.abs(offsets_px), axis=1) <= box_px
    keep = _has_neighbours(
        events["t"],
        events["x"],
        events["y"],
        offsets_px,
        spans_us,
        box_px,
        int(np.min(spans_us[of_box])),
        n_neighbours,
    )
    return chosen_events(events, keep)


def _ball(radius_px: float, us_per_px: float) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Pixels (k, 2) [px] that a ball about a pixel reaches, the nearest first, and how far (k,).

    That is the most that two events of these pixels may lie apart in time [us].
    """
    axis_px = np.arange(-int(radius_px), int(radius_px) + 1)
    offsets_px = np.stack(np.meshgrid(axis_px, axis_px, indexing="ij"), axis=-1).reshape(-1, 2)
    squares_px = np.sum(offsets_px**2, axis=1)
    order = np.argsort(squares_px, kind="stable")
    order = order[squares_px[order] <= radius_px**2]
    left = (radius_px**2 - squares_px[order]) * us_per_px**2
    spans_us = np.floor(np.sqrt(left))
    spans_us += (spans_us + 1.0) ** 2 <= left  # the root of a whole square may come out below it
    return offsets_px[order], spans_us.astype(np.int64)


@numba.njit(cache=True)
def _has_neighbours(
    t: NDArray[np.int64],
    x: NDArray[np.uint16],
    y: NDArray[np.uint16],
    offsets_px: NDArray[np.int64],
    spans_us: NDArray[np.int64],
    box_px: int,
    box_us: int,
    n_neighbours: int,
) -> NDArray[np.bool_]:
    """Whether each event has `n_neighbours` others within the ball of `offsets_px`, `spans_us`.

    All within `box_px` of an event's column and row and `box_us` of its time lie in that ball.
    """
    n, radius_us = len(t), spans_us[0]
    slot_us = box_us // (_SLOTS + 1) + 1  # events are taken by slots: few, and long, loops
    n_slots = (box_us + 1) // slot_us - 1  # of the box, on each side of a slot
    margin_px = np.max(offsets_px)
    n_rows = int(y.max()) + 1 + 2 * margin_px
    n_columns = int(x.max()) + 1 + 2 * margin_px
    steps = offsets_px[:, 0] * n_rows + offsets_px[:, 1]
    length = _power_above(_most_within(t, 2 * radius_us + slot_us))
    # A pixel's events are a chain from its latest one back, kept for as long as a ball reaches.
    previous, cells = np.empty(length, np.int64), np.empty(length, np.int64)
    latest = np.full(n_columns * n_rows, -1, np.int64)
    counts = np.zeros(n_columns * n_rows, np.int32)  # in the box's time, of its rows, by column

    keep = np.zeros(n, np.bool_)
    start = first = end = first_of_box = end_of_box = 0
    while start < n:
        slot_start_us = t[0] + (t[start] - t[0]) // slot_us * slot_us
        slot_end_us = slot_start_us + slot_us
        # What leaves comes first, while the rings still hold it: a gap in time may be long.
        while first_of_box < end_of_box and t[first_of_box] < slot_start_us - n_slots * slot_us:
            cell = cells[first_of_box & (length - 1)]
            for k in range(cell - box_px, cell + box_px + 1):
                counts[k] -= 1
            first_of_box += 1
        while end < n and t[end] < slot_end_us + radius_us:
            cell = (x[end] + margin_px) * n_rows + y[end] + margin_px
            cells[end & (length - 1)] = cell
            previous[end & (length - 1)] = latest[cell]
            latest[cell] = end
            end += 1
        while t[first] < slot_start_us - radius_us:
            first += 1
        while end_of_box < n and t[end_of_box] < slot_end_us + n_slots * slot_us:
            cell = cells[end_of_box & (length - 1)]
            for k in range(cell - box_px, cell + box_px + 1):
                counts[k] += 1
            end_of_box += 1
        while start < n and t[start] < slot_end_us:
            here = cells[start & (length - 1)]
            n_found = -1  # the event finds itself
            for k in range(here - box_px * n_rows, here + box_px * n_rows + 1, n_rows):
                n_found += counts[k]
            if n_found < n_neighbours:
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
def _most_within(t: NDArray[np.int64], duration_us: int) -> int:
    """Count the events of the busiest stretch of time, both ends included."""
    most = first = 0
    for i in range(len(t)):
        while t[i] - t[first] > duration_us:
            first += 1
        most = max(most, i + 1 - first)
    return most


@numba.njit(cache=True)
def _power_above(number: int) -> int:
    power = 1
    while power < number:
        power *= 2
    return power
