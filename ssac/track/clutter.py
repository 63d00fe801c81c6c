"""Find the pixels that fire by themselves, and the background noise of the others.

Lamps that flicker and hot pixels are no part of anything that moves, yet a cluster of them looks
like an object to a filter of isolated events. Unlike an object they never pause, and they have a
sharp edge: whatever moves leaves events all around the place where it stays.
"""

from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, find_objects, label

from ssac.arrays import Events, Indices, IntArray, Mask, Pixels
from ssac.rules import NoiseRules


@dataclass(frozen=True)
class Activity:
    """Events of a sensor's pixels, by those time bins in which there are any events."""

    counts: IntArray  # (height, width) events
    active: NDArray[np.int32]  # (parts, height, width) bins with events, by part of the recording
    n_bins: IntArray  # (parts,)
    background_hz: float  # events of an ordinary pixel


def activity(events: Events, width: int, height: int, rules: NoiseRules) -> Activity:
    """Count the events and active bins of each pixel of a sensor of that size [px].

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
    return Activity(counts, active, n_bins, hz)


def masked_pixels(found: Activity, rules: NoiseRules) -> Mask:
    """Tell the pixels (height, width) that fire by themselves, alone or in clusters."""
    lone = _lone_pixels(found.counts, rules)
    return np.asarray(lone | _clusters(found, ~lone, rules))


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
) -> tuple[IntArray, NDArray[np.int32], IntArray, IntArray]:
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


def _clusters(found: Activity, allowed: Mask, rules: NoiseRules) -> Mask:
    """Clusters that never pause, with few events around: slow objects leave, or blur their edge."""
    clusters = np.zeros(found.counts.shape, np.bool_)
    total = int(np.sum(found.n_bins))
    if total < rules.min_bins_per_part * rules.parts:
        return clusters
    background = 1e-6 * rules.bin_us * total * found.background_hz  # events of an ordinary pixel
    least = max(rules.min_masked_events, rules.min_over_background * background)
    restless = allowed & (found.counts > least)
    for active, n_bins in zip(found.active, found.n_bins, strict=True):
        restless &= active > rules.min_active_share * n_bins
    neighbours = np.ones((3, 3), np.bool_)
    labels = np.zeros(restless.shape, np.int32)
    label(restless, neighbours, output=labels)
    others = allowed & ~restless
    for number, parts in enumerate(find_objects(labels), start=1):
        box = tuple(slice(max(part.start - 1, 0), part.stop + 1) for part in parts)
        cluster = labels[box] == number
        ring = binary_dilation(cluster, neighbours) & others[box]
        if np.sum(cluster) < rules.min_cluster_px or not ring.any():
            continue
        own, around = (np.median(found.counts[box][part]) for part in (cluster, ring))
        if around - background <= rules.max_ring_share * (own - background):
            clusters[box] |= cluster
    return clusters
