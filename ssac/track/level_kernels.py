"""Sorted events of one camera in; how dark each pixel is, in thresholds, and its image's sums, out.

A pixel makes an event whenever its brightness has changed by a threshold. Counted up, its events
say how many thresholds it is off what it shows when nothing is before it: its level. At the instant
of an event the level is a whole number; in between it is interpolated.

Boxes (n, 4) [least x, largest x, least y, largest y], ends included, hold all of the object at n
times. A pixel that is out of the box is at rest.
"""

import numba
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

NONE = -1
"""In place of an event's number."""

_NEVER = -2


@numba.njit(cache=True)
def linked_levels(
    times_us: Indices,
    x: NDArray[np.uint16],
    y: NDArray[np.uint16],
    polarities: NDArray[np.uint8],
    width: int,
    height: int,
    samples_us: Indices,
    boxes: Indices,
) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.int32], int, int]:
    """Give each event's level, positive where darker, and the events before and after it.

    A pixel is not quite back when it is bare again: up to a threshold short of it, so that the
    level at rest is 1 after darkness and -1 after light.

    Returns
    -------
    tuple
        Shapes (m,): levels just after the events; the events of the pixel, while it was in the
        box, before and after each, `NONE` without. Then how often a pixel came to rest, and how
        often it did so within a threshold of where it had been.
    """
    m, n = len(times_us), len(samples_us)
    levels = np.zeros(m, np.int32)
    before, after = np.full(m, NONE, np.int32), np.full(m, NONE, np.int32)
    level = np.zeros((height, width), np.int32)
    step = np.zeros((height, width), np.int8)  # of the pixel's last event
    run = np.zeros((height, width), np.int32)  # of its last events of one polarity
    last = np.full((height, width), NONE, np.int32)
    inside = np.full((height, width), _NEVER, np.int32)  # the last sample with it in the box
    seen_bare = np.zeros((height, width), np.bool_)
    rests, closed = 0, 0
    i = 0
    for e in range(m):
        while i < n - 1 and times_us[e] > samples_us[i]:
            for row in range(boxes[i, 2], boxes[i, 3] + 1):
                for col in range(boxes[i, 0], boxes[i, 1] + 1):
                    if inside[row, col] < i - 1:  # it comes into the box
                        last[row, col] = NONE
                        if run[row, col] > 1 or abs(level[row, col]) > 1:
                            if seen_bare[row, col] and inside[row, col] != _NEVER:
                                rests += 1
                                closed += abs(level[row, col] + step[row, col]) <= 1
                            level[row, col] = -step[row, col]
                        run[row, col] = 0
                        if i > 0:
                            seen_bare[row, col] = True
                    inside[row, col] = i
            i += 1
        col, row = x[e], y[e]
        sign = np.int8(-1 if polarities[e] else 1)
        run[row, col] = run[row, col] + 1 if step[row, col] == sign else 1
        step[row, col] = sign
        level[row, col] += sign
        if boxes[i, 0] <= col <= boxes[i, 1] and boxes[i, 2] <= row <= boxes[i, 3]:
            before[e] = last[row, col]
            if before[e] != NONE:
                after[before[e]] = e
            last[row, col] = e
        elif run[row, col] > 1 or abs(level[row, col]) > 1:
            level[row, col] = -sign
        levels[e] = level[row, col]
    return levels, before, after, rests, closed


@numba.njit(cache=True)
def image_sums(
    times_us: Indices,
    x: NDArray[np.uint16],
    y: NDArray[np.uint16],
    levels: NDArray[np.int32],
    before: NDArray[np.int32],
    after: NDArray[np.int32],
    width: int,
    height: int,
    samples_us: Indices,
    boxes: Indices,
    ramps_us: Array,
    full: float,
    curvature: float,
    corners: Indices,
    images: NDArray[np.float32],
) -> Array:
    """Sum up the images of the object at the samples.

    Parameters
    ----------
    times_us, x, y
        Of the events.
    levels, before, after
        Of `linked_levels`.
    width, height, samples_us, boxes
        As there.
    ramps_us
        Shape (n,): time in which an edge may change a level by one, at most.
    full
        Level of a pixel that is covered all over.
    curvature
        Log contrast of such a pixel, by which the share that is covered is told from the level.
    corners, images
        Shapes (n, 2) and (n, w, w): column and row of each image's first pixel, and the images,
        whose shares are written in place.

    Returns
    -------
    Array
        Shape (n, 8): area [px], its centre x and y [px], its second moments xx, xy, yy [px^2], how
        many pixels of the box were never seen bare, and how many covered ones are on the border.
    """
    m, n = len(times_us), len(samples_us)
    sums = np.zeros((n, 8))
    last = np.full((height, width), NONE, np.int32)
    inside = np.full((height, width), _NEVER, np.int32)
    seen_bare = np.zeros((height, width), np.bool_)
    # The first event of each stay in the box is found from the one of the stay before.
    following = np.full(m, NONE, np.int32)
    coming = np.full((height, width), NONE, np.int32)
    for e in range(m - 1, -1, -1):
        following[e] = coming[y[e], x[e]]
        if before[e] == NONE:
            coming[y[e], x[e]] = e
    whole = 1.0 - np.exp(-curvature)
    size = images.shape[1]
    e = 0
    for i in range(n):
        left, right, top, bottom = boxes[i]
        time_us = samples_us[i]
        while e < m and times_us[e] <= time_us:
            last[y[e], x[e]] = e
            coming[y[e], x[e]] = following[e]
            e += 1
        area, sum_x, sum_y, sum_xx, sum_xy, sum_yy = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for row in range(top, bottom + 1):
            for col in range(left, right + 1):
                if inside[row, col] < i - 1:
                    if i > 0:
                        seen_bare[row, col] = True
                    if last[row, col] != NONE and times_us[last[row, col]] <= samples_us[i - 1]:
                        last[row, col] = NONE
                inside[row, col] = i
                sums[i, 6] += not seen_bare[row, col]
                a = last[row, col]
                b = after[a] if a != NONE else coming[row, col]
                level = _level_at(time_us, a, b, times_us, levels, before, after, ramps_us[i])
                if level <= 0.0:
                    continue
                share = min(1.0, (1.0 - np.exp(-curvature * level / full)) / whole)
                sums[i, 7] += col == 0 or row == 0 or col == width - 1 or row == height - 1
                u, v = col - corners[i, 0], row - corners[i, 1]
                if 0 <= u < size and 0 <= v < size:
                    images[i, v, u] = share
                u, v = col - left, row - top
                area += share
                sum_x += share * u
                sum_y += share * v
                sum_xx += share * u * u
                sum_xy += share * u * v
                sum_yy += share * v * v
        sums[i, 0] = area
        if area > 0.0:
            u, v = sum_x / area, sum_y / area
            sums[i, 1], sums[i, 2] = left + u, top + v
            sums[i, 3] = sum_xx / area - u * u
            sums[i, 4] = sum_xy / area - u * v
            sums[i, 5] = sum_yy / area - v * v
    return sums


@numba.njit(cache=True)
def _level_at(
    time_us: int,
    a: int,
    b: int,
    times_us: Indices,
    levels: NDArray[np.int32],
    before: NDArray[np.int32],
    after: NDArray[np.int32],
    ramp_us: float,
) -> float:
    """Give a pixel's level, without sign, between its event a and its next, b; either may be none.

    A pixel of level 1 is one that the object left, unless the next event is near: there the level
    fades as fast as it did before, and comes as fast as it goes on.
    """
    fading, coming = 0.0, 0.0
    if a != NONE:
        level_a, ago_us = float(levels[a]), float(time_us - times_us[a])
        shrank = before[a] != NONE and abs(levels[before[a]]) > abs(levels[a])
        if b != NONE:
            level_b, lasting_us = float(levels[b]), float(times_us[b] - times_us[a])
            grows = abs(level_b) > abs(level_a)
            was_left = abs(level_a) <= 1.0 and grows and (shrank or lasting_us > 3.0 * ramp_us)
            if not was_left:
                done = ago_us / max(lasting_us, 1.0)
                if grows == shrank:  # it turns in between, and stays as it was until near b
                    done = max(
                        0.0, 1.0 - (lasting_us - ago_us) / max(min(ramp_us, lasting_us), 1.0)
                    )
                return abs(level_a + (level_b - level_a) * done)
        elif abs(level_a) > 1.0:
            return abs(level_a)
        if shrank:
            fade_us = min(ramp_us, float(times_us[a] - times_us[before[a]]))
            fading = abs(level_a) * (1.0 - ago_us / max(fade_us, 1.0))
    if b != NONE:
        level_b = abs(float(levels[b]))
        come_us = ramp_us
        if after[b] != NONE:
            come_us = min(ramp_us, float(times_us[after[b]] - times_us[b]))
        ahead_us = float(times_us[b] - time_us)
        coming = level_b * (1.0 - ahead_us / max(come_us * level_b, 1.0))
    return max(fading, coming, 0.0)
