"""One camera's events in; how active each pixel is, what noise there is, and what is masked, out.

Lamps that flicker and pixels that fire by themselves are no part of anything that moves, and a
cluster of them looks like an object to a filter of isolated events. They are told from an object by
never pausing, and by a sharp edge: whatever moves leaves traces all around where it stays.
"""

from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, find_objects, label

BIN_US = 100_000
"""Time in which a pixel is active, or is not."""

MIN_SHARE = 0.2
"""Of the bins of every part of a recording: what is active in more never pauses."""

PARTS = 10
"""Of a recording: an object that hovers for long still leaves, or comes, or is gone, in some."""

_BIN_S = 1e-6 * BIN_US
_MIN_BINS = 2 * PARTS  # shorter recordings do not tell what stays
_MIN_EVENTS = 50  # pixels with fewer are never masked
_ABOVE = 4.0  # times the background's events
_MIN_CLUSTER = 3  # pixels: fewer are alone
_RING_PX = 1  # around a cluster
_MAX_AROUND = 0.1  # of a cluster's events per pixel: those of the ring around it
_COMPARABLE = 8.0  # times as few events
_MIN_COMPANIONS = 2  # of a pixel that is part of an image
_CELL_PX = 16  # side of the squares whose events tell the background
_MAX_IN_CELL = 1 << 14  # and in a bin; more are counted as so many


@dataclass(frozen=True)
class Activity:
    """What the pixels of a sensor did, over the bins of BIN_US in which any did something."""

    counts: NDArray[np.int64]  # (height, width) events
    active: NDArray[np.int32]  # (PARTS, height, width) bins with events, by part of the recording
    n_bins: NDArray[np.int64]  # (PARTS,)
    background_hz: float  # of an ordinary pixel


def activity(events: NDArray[np.void], width: int, height: int) -> Activity:
    """Count what each pixel of a sensor did.

    The background is that of the middle fifth of all squares of 16 px in all bins, ordered by their
    events: of an object that covers less than 40 % of the sensor, or a burst at the start, nothing
    is in it.

    Parameters
    ----------
    events
        Events, dtype EVENT_DTYPE, shape (N,), sorted by time.
    width, height
        Sensor size [px].
    """
    starts = _starts_of_bins(events["t"])
    counts, active, n_bins, squares = _count(starts, events["x"], events["y"], width, height)
    ends = np.cumsum(squares)
    low, high = 0.4 * ends[-1], 0.6 * ends[-1]
    weights = np.clip(ends, low, high) - np.clip(ends - squares, low, high)
    of_square = float(weights @ np.arange(len(squares)) / max(high - low, 1.0))
    return Activity(counts, active, n_bins, of_square / (_CELL_PX**2 * _BIN_S))


def masked_pixels(found: Activity) -> NDArray[np.bool_]:
    """Tell the pixels (height, width) that fire by themselves, alone or in clusters."""
    lone = _lone_pixels(found.counts, _MIN_EVENTS, _COMPARABLE, _MIN_COMPANIONS)
    return np.asarray(lone | _clusters(found, ~lone))


def unmasked(events: NDArray[np.void], masked: NDArray[np.bool_]) -> NDArray[np.void]:
    """Events (n,) without those of masked pixels (height, width); the very array where none is."""
    if not masked.any():
        return events
    return chosen_events(events, of_pixels(~masked, events["x"], events["y"]))


def chosen_events(events: NDArray[np.void], chosen: NDArray[np.bool_]) -> NDArray[np.void]:
    """Copy the events (n,) where `chosen` (n,) holds: as indexing does, but four times as fast."""
    found = np.empty(np.count_nonzero(chosen), events.dtype)
    _gather(events, chosen, found)
    return found


@numba.njit(cache=True)
def _gather(events: NDArray[np.void], chosen: NDArray[np.bool_], found: NDArray[np.void]) -> None:
    """Fill in the chosen events, in memory of NumPy's: that in large pages is ready sooner."""
    n = 0
    for i in range(len(chosen)):
        if chosen[i]:
            found[n] = events[i]
            n += 1


@numba.njit(cache=True)
def of_pixels(
    chosen: NDArray[np.bool_], x: NDArray[np.uint16], y: NDArray[np.uint16]
) -> NDArray[np.bool_]:
    """Whether each event (n,) is of a chosen pixel (height, width), with no other array (n,)."""
    found = np.empty(len(x), np.bool_)
    for i in range(len(x)):
        found[i] = chosen[y[i], x[i]]
    return found


@numba.njit(cache=True)
def _starts_of_bins(t: NDArray[np.int64]) -> NDArray[np.intp]:
    """Index of the first event of each bin in which there are events, and their number at last."""
    starts, first = [0], 0
    while first < len(t):
        end_us = t[first] + BIN_US - (t[first] - t[0]) % BIN_US
        first += np.searchsorted(t[first:], end_us)
        starts.append(first)
    return np.array(starts)


@numba.njit(cache=True)
def _count(
    starts: NDArray[np.intp],
    x: NDArray[np.uint16],
    y: NDArray[np.uint16],
    width: int,
    height: int,
) -> tuple[NDArray[np.int64], NDArray[np.int32], NDArray[np.int64], NDArray[np.int64]]:
    """Count events and active bins by pixel, bins by part, and squares by their events in a bin.

    Each event is counted once, in its bin; all else is of the pixels that the bin touched.
    """
    n_pixels = height * width
    counts, active = np.zeros(n_pixels, np.int64), np.zeros((PARTS, n_pixels), np.int32)
    in_bin, touched = np.zeros(n_pixels, np.int32), np.empty(n_pixels + 1, np.int32)
    n_bins = np.zeros(PARTS, np.int64)
    in_square = np.zeros((height // _CELL_PX + 1, width // _CELL_PX + 1), np.int64)
    squares = np.zeros(_MAX_IN_CELL + 1, np.int64)
    total = len(starts) - 1
    for k in range(total):
        part = k * PARTS // total
        n_bins[part] += 1
        n_touched = 0
        for i in range(starts[k], starts[k + 1]):
            pixel = np.uint32(np.int64(y[i]) * width + x[i])
            touched[n_touched] = pixel  # and written over, where it was touched before
            n_touched += in_bin[pixel] == 0
            in_bin[pixel] += 1
        for pixel in touched[:n_touched]:
            n = in_bin[pixel]
            in_bin[pixel] = 0
            counts[pixel] += n
            active[part, pixel] += 1
            in_square[pixel // width // _CELL_PX, pixel % width // _CELL_PX] += n
        _end_bin(in_square, squares, width, height)
    shape = height, width
    return counts.reshape(shape), active.reshape((PARTS, *shape)), n_bins, squares


@numba.njit(cache=True)
def _end_bin(
    in_square: NDArray[np.int64], squares: NDArray[np.int64], width: int, height: int
) -> None:
    """Enter the events of the whole squares in one bin, and begin the next."""
    for row in range(height // _CELL_PX):
        for column in range(width // _CELL_PX):
            squares[min(in_square[row, column], _MAX_IN_CELL)] += 1
    in_square[:] = 0


@numba.njit(cache=True)
def _lone_pixels(
    counts: NDArray[np.int64], min_events: int, count_ratio: float, min_companions: int
) -> NDArray[np.bool_]:
    """Whether each pixel (height, width) has many events, and too few of those around it have.

    Whatever an object does, its image is larger than a pixel, and an edge of it that passes, or
    stays, leaves similar counts along itself; a hot pixel, or two side by side, stand alone. Pixel
    by pixel: the neighbourhoods of all of them side by side would be 25 times the sensor.
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


def _clusters(found: Activity, allowed: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Pixels (height, width) of clusters that never pause, and around which there is little.

    Of a slow or hovering object either fails: it is not there all the time, or where it is most of
    the time blurs into where it seldom is.
    """
    nothing = np.zeros(found.counts.shape, np.bool_)
    total = int(np.sum(found.n_bins))
    if total < _MIN_BINS:
        return nothing
    background = _BIN_S * total * found.background_hz  # events of an ordinary pixel
    restless = allowed & (found.counts > max(_MIN_EVENTS, _ABOVE * background))
    for active, n_bins in zip(found.active, found.n_bins, strict=True):
        restless &= active > MIN_SHARE * n_bins
    neighbours = np.ones((3, 3), np.bool_)
    labels = np.zeros(restless.shape, np.int32)
    label(restless, neighbours, output=labels)
    clusters, others = nothing, allowed & ~restless
    for number, (rows, columns) in enumerate(find_objects(labels), start=1):
        box = _wider(rows), _wider(columns)
        cluster = labels[box] == number
        ring = binary_dilation(cluster, neighbours, _RING_PX) & others[box]
        if np.sum(cluster) < _MIN_CLUSTER or not ring.any():
            continue
        own, around = (np.median(found.counts[box][part]) for part in (cluster, ring))
        if around - background <= _MAX_AROUND * (own - background):
            clusters[box] |= cluster
    return clusters


def _wider(part: slice) -> slice:
    return slice(max(part.start - _RING_PX, 0), part.stop + _RING_PX)
