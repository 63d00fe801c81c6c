"""Events in, the events of the moving object out: what fires by itself, or alone, removed.

How many neighbours an event needs follows from the noise that is there, and from how many events
the object makes; the paper's 20 are what an ordinary drone in ordinary light needs.
"""

from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.special import pdtrc

from ssac.config import N_MIN
from ssac.events import first_from
from ssac.track.clutter import activity, chosen_events, masked_pixels, unmasked

US_PER_MS = 1000.0

PAPER_PX, PAPER_NEIGHBOURS = 5.0, 20
"""The paper's ball [px, ms] and the neighbours in it."""

NEAR_PX, NEAR_NEIGHBOURS = 3.0, 12
"""The same where there is much noise: what lies beside the object by chance, a large ball keeps."""

NOISY_HZ = 1.0
"""Background of a pixel from which the small ball is taken."""

MOST = 0.9
"""Share of an object's events that have more neighbours, where these are asked for."""

LEAST_NEIGHBOURS = 5
"""However little noise there is."""

THIN = 2.0
"""An object of fewer events in a window than so many times the paper's N_min is thin."""

_LEAST_N_MIN = 20
_SHARE_N_MIN = 0.25  # of a thin object's events in a window
_WINDOW_S = 0.040  # whatever the config's is: what is prepared must not depend on that
_SAMPLES = 1000  # of windows

_CORE = 0.4  # of the ball's squared radius: pixels nearer than that are counted, for most events


@dataclass(frozen=True)
class Clutter:
    """What was done to the events of one camera, and why."""

    masked_pixels: int  # which fire by themselves: lamps and hot pixels
    masked_events: int
    background_hz: float  # of an ordinary pixel
    radius_px: float  # of the radius filter's ball, and in ms
    n_neighbours: int  # that an event needs in it
    n_min: int  # events that a window holds at least, unless the config says how many

    @property
    def is_adapted(self) -> bool:
        """Whether the paper's values were left."""
        used = self.radius_px, self.n_neighbours, self.n_min
        return used != (PAPER_PX, PAPER_NEIGHBOURS, N_MIN)


def without_noise(
    events: NDArray[np.void], width: int, height: int, n_neighbours: int | None = None
) -> tuple[NDArray[np.void], Clutter]:
    """Remove what fires by itself, then what fires alone.

    Parameters
    ----------
    events
        Events, dtype EVENT_DTYPE, shape (N,), sorted by time.
    width, height
        Sensor size [px].
    n_neighbours
        That an event needs in the paper's ball. None: the paper's, in little noise; in more than
        NOISY_HZ the smaller ball; fewer, if noise allows it, where the object is thin.

    Returns
    -------
    tuple
        The events left, in the same order, and what was done.
    """
    found = activity(events, width, height)
    mask = masked_pixels(found)
    n_all, hz = len(events), found.background_hz
    events, size_px = unmasked(events, mask), (width, height)
    n_masked = n_all - len(events)
    radius_px, n = PAPER_PX, n_neighbours or PAPER_NEIGHBOURS
    if n_neighbours is None and hz > NOISY_HZ:
        radius_px, n = NEAR_PX, least_neighbours(hz, width * height, NEAR_PX, NEAR_NEIGHBOURS)
        left = radius_filter(events, radius_px, n_neighbours=n, mostly_noise=True, size_px=size_px)
        fewer = radius_filter(left, radius_px, n_neighbours=NEAR_NEIGHBOURS, size_px=size_px)
        if len(fewer) > MOST * len(left):
            left, n = fewer, NEAR_NEIGHBOURS
    else:
        left = radius_filter(events, n_neighbours=n, size_px=size_px)
        if n_neighbours is None and events_per_window(left) < THIN * N_MIN:
            n = least_neighbours(hz, width * height, PAPER_PX, PAPER_NEIGHBOURS)
            left = radius_filter(events, n_neighbours=n, size_px=size_px)
    n_min, in_window = N_MIN, events_per_window(left)
    if in_window < THIN * N_MIN:
        n_min = int(np.clip(_SHARE_N_MIN * in_window, _LEAST_N_MIN, N_MIN))
    return left, Clutter(int(mask.sum()), n_masked, hz, radius_px, n, n_min)


def least_neighbours(background_hz: float, n_pixels: int, radius_px: float, most: int) -> int:
    """Fewest neighbours that leave at most one event of the noise in a window, up to `most`.

    Parameters
    ----------
    background_hz
        Of each pixel, at random times.
    n_pixels
        Of the sensor.
    radius_px
        Of the ball [px, ms].
    most
        Given where even that many leave more.
    """
    in_ball = background_hz * 4.0 / 3.0 * np.pi * radius_px**3 / US_PER_MS
    in_window = background_hz * n_pixels * _WINDOW_S
    for n in range(LEAST_NEIGHBOURS, most):
        if in_window * pdtrc(n - 1, in_ball) <= 1.0:  # n or more, of a Poisson distribution
            return n
    return most


def events_per_window(events: NDArray[np.void]) -> float:
    """Median number of events within 20 ms of one of them; 0 of none."""
    t = events["t"]
    if len(t) == 0:
        return 0.0
    some = t[:: -(-len(t) // _SAMPLES)]
    half_us = round(0.5e6 * _WINDOW_S)
    return float(np.median(first_from(t, some + half_us) - first_from(t, some - half_us)))


def radius_filter(
    events: NDArray[np.void],
    radius_px: float = PAPER_PX,
    ms_per_unit: float = 1.0,
    n_neighbours: int = PAPER_NEIGHBOURS,
    *,
    mostly_noise: bool = False,
    size_px: tuple[int, int] | None = None,
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
    mostly_noise
        Most events are to be removed: another way to the same result, which is faster then.
    size_px
        The sensor's width and height; None: as far as the events reach.

    Returns
    -------
    NDArray[np.void]
        The kept events, in the same order.

    Notes
    -----
    The core of the ball, for as long as all of it lasts, has its events counted as they come and
    go, and where it holds enough the event is kept at a cost that depends neither on the rate of
    events nor on the size of the sensor. For the others, the events of each pixel around are looked
    through from the latest one on, the nearest pixels first. Where most are noise, the events of
    tiles are counted instead: those around an event hold the ball, and where they have too few it
    is removed. Both are exact.
    """
    if len(events) <= n_neighbours:
        return events[:0]
    offsets_px, spans_us = _ball(radius_px, US_PER_MS * ms_per_unit)
    where = events["t"], events["x"], events["y"]
    if mostly_noise or radius_px < 1.0:
        keep = has_neighbours_in_noise(*where, offsets_px, spans_us, n_neighbours)
        return chosen_events(events, keep)
    width, height = size_px or extent(*where[1:])
    margin_px = int(radius_px)
    n_rows = height + 2 * margin_px
    squared_px = max(_CORE * radius_px**2, 1.0)
    core_us = int(np.min(spans_us[np.sum(offsets_px**2, axis=1) <= squared_px]))
    steps = offsets_px[:, 0] * n_rows + offsets_px[:, 1]
    sensor = width + 2 * margin_px, n_rows, margin_px
    core = _core(squared_px, n_rows), core_us
    return chosen_events(
        events, has_neighbours(*where, sensor, steps, spans_us, *core, n_neighbours)
    )


def _core(squared_px: float, n_rows: int) -> tuple[int, ...]:
    """Middles of three pixels of a column each, which no circle of that radius cuts: as cells.

    Cells are numbered column by column, of `n_rows` each, from that in the circle's middle on.
    """
    reach_px, found = int(np.sqrt(squared_px)), []
    for column in range(-reach_px, reach_px + 1):
        n_threes = (2 * int(np.sqrt(squared_px - column**2)) + 1) // 3
        top = -(3 * n_threes // 2)
        found += [column * n_rows + top + 3 * k + 1 for k in range(n_threes)]
    return tuple(found)


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
