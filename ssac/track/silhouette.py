"""Find the object's silhouette, the centre and shape of its image, from one camera's events.

The mean of the events wanders over the object as it turns, the centre of the image's area far less.
The sum of a pixel's events is its level: by how many contrast thresholds it differs from the bare
background. It is a whole number at an event, and is interpolated in between. Boxes (n, 4)
[least x, largest x, least y, largest y], ends included, hold all of the object at n times; a pixel
outside the box is at rest.

Thresholds that differ, pixels that are blind after an event, and noise make the sums wrong. There
a pixel is assumed to come back to its level at rest, and its steps back are scaled accordingly.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d

from ssac.arrays import Array, Events, Float32Array, Indices, Int32Array, IntArray, Mask, Pixels
from ssac.camera import Camera, distort_points
from ssac.rules import SilhouetteRules

NONE = -1
"""In place of an event's index where there is no event."""


class Seen(NamedTuple):
    """The events of one camera, and the boxes that hold the object at n samples of time."""

    times_us: IntArray  # (m,)
    x: Pixels  # (m,)
    y: Pixels  # (m,)
    polarities: NDArray[np.uint8]  # (m,)
    shape: tuple[int, int]  # height and width of the sensor
    samples_us: IntArray  # (n,)
    boxes: IntArray  # (n, 4)


class Linked(NamedTuple):
    """Each event's level, and the same pixel's events beside it during its stay in the box."""

    levels: Float32Array  # (m,) just after the event
    before: Int32Array  # (m,) index of the event before; `NONE` without
    after: Int32Array  # (m,) index of the next one, likewise


@dataclass(frozen=True, eq=False)
class Images:
    """Images of the object alone, in n square windows that are w pixels wide."""

    shares: Float32Array  # (n, w, w) covered share of each pixel
    corners_px: IntArray  # (n, 2) column and row of the first pixel

    def of(self, chosen: Mask) -> "Images":
        """Return only the chosen images."""
        return Images(self.shares[chosen], self.corners_px[chosen])


@dataclass(frozen=True, eq=False)
class Silhouettes:
    """The object's image at the points of a track."""

    centres_px: Array  # (n, 2) of its area, in the distorted image; NaN: not known
    spreads_px2: Array  # (n, 3) its second moments xx, xy and yy; NaN likewise
    images: Images  # at all n points

    @property
    def known(self) -> Mask:
        """Mask (n,) of the points with a known silhouette."""
        return np.isfinite(self.centres_px[:, 0])


def silhouettes(
    recorded: Events,
    denoised: Events,
    camera: Camera,
    times_s: Array,
    points_px: Array,
    sizes_px: Array,
    rules: SilhouetteRules,
) -> Silhouettes | None:
    """Find the object's silhouettes; None if it is too small, or the events do not determine them.

    All events that the camera recorded are counted, or, if the levels do not come back to
    rest, the denoised ones, of which some are missing. The track (n,) is the undistorted mean of
    the events; sizes are root mean square radii of the image.
    """
    if len(times_s) < 2 or float(np.median(sizes_px)) < rules.min_size_px:
        return None
    # Times in whole us, positions rounded: a shift of the clock then changes no bit of the result.
    times_us = np.rint(1e6 * times_s).astype(np.int64)
    where_px, sizes_px = np.round(distort_points(camera, points_px), 4), np.round(sizes_px, 4)
    samples_us, boxes, own = _boxes(times_us, where_px, sizes_px, camera, rules)
    since_s = 1e-6 * (times_us - times_us[0])
    moving = np.gradient(where_px, since_s, axis=0)
    speeds = np.maximum(np.linalg.norm(moving, axis=1), rules.least_speed_px_s)
    ramps_us = np.interp(1e-6 * (samples_us - times_us[0]), since_s, 1e6 * rules.ramp_px / speeds)
    half = int(np.ceil(rules.window_sizes * np.percentile(sizes_px, rules.large_percentile)))
    corners = np.rint(where_px).astype(np.int64) - half
    placed = np.zeros((len(samples_us), 2), np.int64)
    placed[own] = corners
    is_large = float(np.median(sizes_px)) >= rules.large_px
    start = where_px[0], rules.window_sizes * sizes_px[0], rules.min_covered_share

    def prepared(events: Events) -> Seen | None:
        t_us, x, y, polarities = (np.ascontiguousarray(events[name]) for name in "txyp")
        shape = camera.height, camera.width
        seen = Seen(t_us, x, y, polarities, shape, samples_us, boxes)
        return _with_covered(seen, *start) if is_large else seen

    found = _counted_up(recorded, denoised, prepared, ramps_us, rules)
    if found is None:
        return None
    seen, linked, full = found
    shares = np.zeros((len(samples_us), 2 * half + 1, 2 * half + 1), np.float32)
    share_of = full, rules.curvature
    sums = _image_sums(seen, linked, ramps_us, share_of, placed, shares)[own]
    off_px = np.linalg.norm(sums[:, 1:3] - where_px, axis=1)
    good = (sums[:, 0] > 0.0) & (is_large | (sums[:, 6] == 0.0)) & (sums[:, 7] == 0.0)
    good &= off_px < rules.max_off_sizes * sizes_px
    if np.mean(good) < rules.min_share:
        return None
    known = np.where(good[:, None], sums[:, 1:6], np.nan)
    return Silhouettes(known[:, :2], known[:, 2:], Images(shares[own], corners))


def _counted_up(
    recorded: Events,
    denoised: Events,
    prepared: Callable[[Events], Seen | None],
    ramps_us: Array,
    rules: SilhouetteRules,
) -> tuple[Seen, Linked, float] | None:
    """Sum up all events, or else the denoised ones; return the level of a covered pixel too."""
    seen = prepared(recorded)
    if seen is None:
        return None
    linked, rests, closed = _linked_levels(seen)
    is_even = closed >= rules.min_closed_share * rests
    if not is_even:  # noise, or thresholds that differ
        seen = prepared(denoised)
        if seen is None:
            return None
        linked, _, _ = _linked_levels(seen)
        quiet_us = rules.quiet_ramps * float(np.median(ramps_us))
        open_us, back_shares = 1e6 * rules.open_s, rules.back_shares
        levels, left, came_back = _evened(seen, linked, quiet_us, open_us, back_shares)
        if came_back < rules.min_back_share * left:
            return None
        linked = linked._replace(levels=levels)
    levels = np.abs(linked.levels[np.searchsorted(seen.times_us, seen.samples_us[0]) :])
    levels = levels if is_even else levels[levels > 0.0]  # lone steps have level 0
    if len(levels) == 0:
        return None
    return seen, linked, float(np.percentile(levels.astype(np.float64), rules.full_percentile))


def _with_covered(seen: Seen, start_px: Array, reach_px: float, min_share: float) -> Seen | None:
    """Put first the events with which the object would have covered its pixels at the start."""
    # A pixel gets as many as it turns lighter by when a dark object uncovers it, or darker by with
    # a light one. None unless `min_share` of these pixels are within reach of the start (2,): with
    # an object both darker and lighter than the background, every pixel is in doubt.
    levels, has_left, least, most = _levels_since_start(seen)
    is_dark = np.count_nonzero(least < -1) < np.count_nonzero(most > 1)
    bare = np.where(has_left, levels * (np.abs(levels) > 1), least if is_dark else most)
    rows, cols = np.nonzero(bare)
    bare = bare[rows, cols]
    near = np.hypot(cols - start_px[0], rows - start_px[1]) <= reach_px
    if np.count_nonzero(near) < min_share * len(near):
        return None
    start_us, n = seen.samples_us[0], np.abs(bare)
    first = np.searchsorted(seen.times_us, start_us, side="right")

    def put(covering: NDArray[Any], events: NDArray[Any]) -> NDArray[Any]:
        return np.append(np.repeat(covering, n).astype(events.dtype), events[first:])

    return seen._replace(
        times_us=put(np.full(len(n), start_us + 1), seen.times_us),
        x=put(cols, seen.x),
        y=put(rows, seen.y),
        polarities=put(bare > 0, seen.polarities),
    )


@numba.njit(cache=True)
def _levels_since_start(seen: Seen) -> tuple[Int32Array, Mask, Int32Array, Int32Array]:
    """Sum each pixel's events, +1 for darker, until it leaves the box for the first time."""
    # Returned are the levels then, whether it left, and the least and largest levels before.
    times_us, x, y, polarities, shape, samples_us, boxes = seen
    n = len(samples_us)
    inside = np.zeros(shape, np.int32)  # last sample until which the pixel stayed in the box
    level = np.zeros(shape, np.int32)
    least, most = level.copy(), level.copy()
    i = 1
    for e in range(np.searchsorted(times_us, samples_us[0], side="right"), len(times_us)):
        while i < n and times_us[e] > samples_us[i]:
            for row in range(boxes[i, 2], boxes[i, 3] + 1):
                for col in range(boxes[i, 0], boxes[i, 1] + 1):
                    if inside[row, col] == i - 1:
                        inside[row, col] = i
            i += 1
        col, row = x[e], y[e]
        if inside[row, col] == i - 1:
            level[row, col] += -1 if polarities[e] else 1
            least[row, col] = min(least[row, col], level[row, col])
            most[row, col] = max(most[row, col], level[row, col])
    return level, inside < i - 1, least, most


def _boxes(
    times_us: IntArray, where_px: Array, sizes_px: Array, camera: Camera, rules: SilhouetteRules
) -> tuple[IntArray, IntArray, Indices]:
    """Return samples' times [us] and boxes, the whole view in gaps, and the points' indices."""
    largest_px = maximum_filter1d(sizes_px, 2 * rules.box_points + 1)
    reach_px = rules.box_sizes * largest_px + rules.box_px
    most = np.array([camera.width - 1, camera.height - 1])
    low = np.clip(np.floor(where_px - reach_px[:, None]), 0, most)
    high = np.clip(np.ceil(where_px + reach_px[:, None]), 0, most)
    boxes = np.column_stack([low[:, 0], high[:, 0], low[:, 1], high[:, 1]]).astype(np.int64)
    steps_us = np.diff(times_us)
    gaps = np.flatnonzero(steps_us > rules.gap_steps * np.median(steps_us)) + 1
    places = np.concatenate([[0], gaps])
    between_us = np.concatenate([[times_us[0] - 1000], times_us[gaps] - steps_us[gaps - 1] // 2])
    whole_view = np.array([0, camera.width - 1, 0, camera.height - 1])
    samples_us = np.insert(times_us, places, between_us)
    boxes = np.insert(boxes, places, whole_view, axis=0)
    indices = np.arange(len(times_us))
    return samples_us, boxes, indices + np.searchsorted(places, indices, side="right")


@numba.njit(cache=True)
def _linked_levels(seen: Seen) -> tuple[Linked, int, int]:
    """Return each event's level, positive for darker, and the events before and after it."""
    # The level at rest is 1 after a darker and -1 after a lighter spell: a pixel stops up to one
    # threshold short of its old value. Also returned are how often pixels came to rest, and how
    # often they did so within a threshold of their old level.
    times_us, x, y, polarities, shape, samples_us, boxes = seen
    m, n = len(times_us), len(samples_us)
    levels = np.zeros(m, np.float32)
    before, after = np.full(m, NONE, np.int32), np.full(m, NONE, np.int32)
    level = np.zeros(shape, np.int32)
    step = np.zeros(shape, np.int8)  # sign of the pixel's last event
    run = np.zeros(shape, np.int32)  # number of its last events of one polarity
    last = np.full(shape, NONE, np.int32)
    never = -2
    inside = np.full(shape, never, np.int32)  # last sample with the pixel in the box
    seen_bare = np.zeros(shape, np.bool_)
    rests, closed = 0, 0
    i = 0
    for e in range(m):
        while i < n - 1 and times_us[e] > samples_us[i]:
            for row in range(boxes[i, 2], boxes[i, 3] + 1):
                for col in range(boxes[i, 0], boxes[i, 1] + 1):
                    if inside[row, col] < i - 1:  # the pixel enters the box
                        last[row, col] = NONE
                        if run[row, col] > 1 or abs(level[row, col]) > 1:
                            if seen_bare[row, col] and inside[row, col] != never:
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
    return Linked(levels, before, after), rests, closed


@numba.njit(cache=True)
def _evened(
    seen: Seen, linked: Linked, quiet_us: float, open_us: float, back_shares: tuple[float, float]
) -> tuple[Float32Array, int, int]:
    """Return the events' levels (m,), scaled so that each pixel comes back to its level at rest."""
    # A lone step is noise, and so is an excursion without any step back, except in the last
    # `open_us` of the recording. Also returned are the number of all larger excursions but open
    # ones, and the number that come back by themselves, as `_excursion` tells.
    times_us, (_, before, after) = seen.times_us, linked
    left, came_back = 0, 0
    levels = np.zeros(len(times_us), np.float32)
    for e in range(len(times_us)):
        first = e if before[e] == NONE else NONE
        while first != NONE:
            last, peak, darker, lighter, is_back = _excursion(
                first, seen, after, quiet_us, back_shares
            )
            steps_away, steps_back = (darker, lighter) if peak > 0 else (lighter, darker)
            is_open = not is_back and times_us[last] >= times_us[-1] - open_us
            left += abs(peak) > 1 and not is_open
            came_back += abs(peak) > 1 and is_back
            if abs(peak) > 1 and (is_open or steps_back > 0):
                by = 1.0 if is_open else steps_away / steps_back
                level = 0.0
                i = first
                while i != after[last]:
                    level += 1.0 if (seen.polarities[i] == 0) == (peak > 0) else -by
                    levels[i] = max(level, 0.0) if peak > 0 else -max(level, 0.0)
                    i = after[i]
                if not is_open:
                    levels[last] = 0.0  # without rounding errors
            first = after[last]
    return levels, left, came_back


@numba.njit(cache=True)
def _excursion(
    first: int, seen: Seen, after: Int32Array, quiet_us: float, back_shares: tuple[float, float]
) -> tuple[int, int, int, int, bool]:
    """Follow a pixel's level from an event until it is back at rest."""
    # It is back if no event follows for `quiet_us` and at most the first share of the peak is left,
    # or the second if it turns away next; also if it turns away where it has reached zero. Returned
    # are the last event, the peak, the numbers of darker and lighter steps, and whether it is back.
    times_us, polarities = seen.times_us, seen.polarities
    darker, lighter, peak = 0, 0, 0
    e = first
    while True:
        darker += polarities[e] == 0
        lighter += polarities[e] != 0
        level = darker - lighter
        if abs(level) > abs(peak):
            peak = level
        following = after[e]
        is_last = following == NONE
        is_quiet = is_last or times_us[following] - times_us[e] > quiet_us
        is_away = (polarities[e] == 0) == (peak > 0)
        turns = not is_away and (is_last or (polarities[following] == 0) == (peak > 0))
        is_little = abs(level) <= max(1.0, back_shares[0] * abs(peak))
        is_back = is_little and (is_quiet or (turns and level * peak <= 0))
        is_back |= turns and is_quiet and abs(level) <= back_shares[1] * abs(peak)
        if is_back or is_last:
            return e, peak, darker, lighter, is_back
        e = following


@numba.njit(cache=True)
def _image_sums(
    seen: Seen,
    linked: Linked,
    ramps_us: Array,
    share_of: tuple[float, float],
    corners: IntArray,
    images: Float32Array,
) -> Array:
    """Return sums (n, 8) over the object's image at n samples, from linked levels."""
    # Sums are area [px], its centre x and y [px], its second moments xx, xy, yy [px^2], how many
    # pixels of the box were never seen bare, and how many covered ones are on the border. During a
    # ramp (n,) [us] an edge changes a level by one. `share_of` is the level of a fully covered
    # pixel, and its log contrast. Corners (n, 2) are column and row of each image's first pixel;
    # images (n, w, w) are written in place.
    times_us, x, y, _, shape, samples_us, boxes = seen
    _, before, after = linked
    (height, width), (full, curvature) = shape, share_of
    m, n = len(times_us), len(samples_us)
    sums = np.zeros((n, 8))
    last = np.full(shape, NONE, np.int32)
    inside = np.full(shape, -2, np.int32)  # last sample with the pixel in the box
    seen_bare = np.zeros(shape, np.bool_)
    # For each event, the first event of the pixel's next stay in the box.
    following = np.full(m, NONE, np.int32)
    coming = np.full(shape, NONE, np.int32)
    bare_us = np.zeros((*shape, 2), np.int64)  # between which the pixel is surely bare
    bare_us[:, :, 1] = np.iinfo(np.int64).max
    longest_us = np.max(ramps_us)
    for e in range(m - 1, -1, -1):
        following[e] = coming[y[e], x[e]]
        if before[e] == NONE:
            coming[y[e], x[e]] = e
            bare_us[y[e], x[e]] = _bare_us(NONE, e, times_us, linked, longest_us)
    whole = 1.0 - np.exp(-curvature)
    size = images.shape[1]
    e = 0
    for i in range(n):
        left, right, top, bottom = boxes[i]
        time_us = samples_us[i]
        while e < m and times_us[e] <= time_us:
            last[y[e], x[e]], coming[y[e], x[e]] = e, following[e]
            bare_us[y[e], x[e]] = _bare_us(e, after[e], times_us, linked, longest_us)
            e += 1
        for row in range(top, bottom + 1):
            for col in range(left, right + 1):
                if inside[row, col] < i - 1:
                    if i > 0:
                        seen_bare[row, col] = True
                    if last[row, col] != NONE and times_us[last[row, col]] <= samples_us[i - 1]:
                        last[row, col], b = NONE, coming[row, col]
                        bare_us[row, col] = _bare_us(NONE, b, times_us, linked, longest_us)
                inside[row, col] = i
                sums[i, 6] += not seen_bare[row, col]
                if bare_us[row, col, 0] <= time_us < bare_us[row, col, 1]:
                    continue
                a = last[row, col]
                b = after[a] if a != NONE else coming[row, col]
                level = _level_at(time_us, a, b, times_us, linked, ramps_us[i])
                if level <= 0.0:
                    continue
                share = min(1.0, (1.0 - np.exp(-curvature * level / full)) / whole)
                sums[i, 7] += col == 0 or row == 0 or col == width - 1 or row == height - 1
                u, v = col - corners[i, 0], row - corners[i, 1]
                if 0 <= u < size and 0 <= v < size:
                    images[i, v, u] = share
                u, v = col - left, row - top
                su, sv = share * u, share * v
                for k, term in enumerate((share, su, sv, su * u, su * v, sv * v)):
                    sums[i, k] += term
        if sums[i, 0] > 0.0:
            sums[i, 1:6] /= sums[i, 0]
            u, v = sums[i, 1], sums[i, 2]
            sums[i, 3:6] -= np.array([u * u, u * v, v * v])
            sums[i, 1], sums[i, 2] = left + u, top + v
    return sums


@numba.njit(cache=True)
def _bare_us(
    a: int, b: int, times_us: IntArray, linked: Linked, longest_us: float
) -> tuple[int, int]:
    """Return times [us] between which `_level_at` is 0, for all ramps up to the longest."""
    levels, before, _ = linked
    start_us, level_a, shrank = 0, 0.0, True
    if a != NONE:
        level_a = abs(float(levels[a]))
        shrank = before[a] != NONE and abs(levels[before[a]]) > level_a
        fade_us = min(longest_us, float(times_us[a] - times_us[before[a]])) if shrank else 0.0
        start_us = times_us[a] + int(np.ceil(max(fade_us, 1.0)))
    if level_a > 1.0:
        return 0, 0
    if b == NONE:
        return start_us, np.iinfo(np.int64).max
    level_b = abs(float(levels[b]))
    if level_b <= level_a or not (shrank or times_us[b] - times_us[a] > 3.0 * longest_us):
        return 0, 0
    return start_us, times_us[b] - int(np.ceil(max(longest_us * level_b, 1.0)))


@numba.njit(cache=True)
def _level_at(
    time_us: int, a: int, b: int, times_us: IntArray, linked: Linked, ramp_us: float
) -> float:
    """Return a pixel's absolute level between its events a and b; either may be `NONE`."""
    # From level 1 it becomes bare, unless b is near; it fades as before a, and rises as after b.
    levels, before, after = linked
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
                if grows == shrank:  # it turns in between, and keeps a's level until near b
                    coming_us = max(min(ramp_us, lasting_us), 1.0)
                    done = max(0.0, 1.0 - (lasting_us - ago_us) / coming_us)
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
