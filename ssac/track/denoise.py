"""Events in, the events of the moving object out: hot pixels and isolated events removed."""

import numba
import numpy as np
from numpy.typing import NDArray

US_PER_MS = 1000.0


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
    pixel = events["y"].astype(np.intp)
    pixel *= width
    pixel += events["x"]
    counts = np.bincount(pixel, minlength=width * height).reshape(height, width)
    rows, columns = np.nonzero(counts >= min_events)
    around = np.lib.stride_tricks.sliding_window_view(np.pad(counts, 2), (5, 5))[rows, columns]
    own = counts[rows, columns][:, None, None]
    companions = np.count_nonzero(around * count_ratio >= own, axis=(1, 2)) - 1
    hot = np.zeros((height, width), dtype=bool)
    hot[rows, columns] = companions < min_companions
    return events[~hot.ravel()[pixel]] if hot.any() else events


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
    The events are sorted into strips of columns as wide as the radius, by time within each strip.
    All neighbours of an event then lie in three strips, in each of them within one run of events
    that moves forward with time; the third strip is skipped when the first two hold enough. The
    result is exact.
    """
    if len(events) <= n_neighbours:
        return events[:0]
    us_per_px = US_PER_MS * ms_per_unit
    keep = _has_neighbours(
        events["t"],
        events["x"],
        events["y"],
        max(int(np.ceil(radius_px)), 1),
        us_per_px,
        radius_px * us_per_px,
        n_neighbours,
    )
    return events[keep]


@numba.njit(cache=True)
def _has_neighbours(
    t: NDArray[np.int64],
    x: NDArray[np.uint16],
    y: NDArray[np.uint16],
    strip_px: int,
    us_per_px: float,
    radius_us: float,
    n_neighbours: int,
) -> NDArray[np.bool_]:
    """Whether each event has `n_neighbours` others within `radius_us` of (t, us_per_px (x, y))."""
    n_strips = x.max() // strip_px + 3  # an empty one on each side
    start = np.zeros(n_strips + 1, np.int64)
    for i in range(len(t)):
        start[x[i] // strip_px + 2] += 1
    start = np.cumsum(start)

    order = np.empty(len(t), np.int32)
    ts, xs, ys = np.empty(len(t)), np.empty(len(t)), np.empty(len(t))  # by strip, then time [us]
    filled = start.copy()
    for i in range(len(t)):
        strip = x[i] // strip_px + 1
        j = filled[strip]
        filled[strip] += 1
        order[j] = i
        ts[j], xs[j], ys[j] = t[i] - t[0], x[i] * us_per_px, y[i] * us_per_px

    keep = np.zeros(len(t), np.bool_)
    for strip in range(1, n_strips - 1):
        strips = (strip, strip - 1, strip + 1)
        first = np.array([start[s] for s in strips])
        end = first.copy()
        for i in range(start[strip], start[strip + 1]):
            n_found = -1  # the event finds itself
            for k in range(3):
                while first[k] < end[k] and ts[first[k]] < ts[i] - radius_us:
                    first[k] += 1
                while end[k] < start[strips[k] + 1] and ts[end[k]] <= ts[i] + radius_us:
                    end[k] += 1
                run = slice(first[k], end[k])
                n_found += _count_within(
                    ts[run], xs[run], ys[run], (ts[i], xs[i], ys[i]), radius_us**2
                )
                if n_found >= n_neighbours:
                    keep[order[i]] = True
                    break
    return keep


@numba.njit(cache=True)
def _count_within(
    t: NDArray[np.float64],
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    centre: tuple[float, float, float],
    radius2: float,
) -> int:
    """Count the points no further from `centre` than the radius.

    One loop without a branch over whole arrays: it compiles to vector instructions.
    """
    count = 0
    for j in range(len(t)):
        dt, dx, dy = t[j] - centre[0], x[j] - centre[1], y[j] - centre[2]
        count += dt * dt + dx * dx + dy * dy <= radius2
    return count
