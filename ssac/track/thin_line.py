"""One camera's events before and after denoising in; those of a line that holds the object, out.

What hangs on a wire, or sits on a rod, is seen with the part of it that is next to the object: so
near, denoising does not tell the two apart, and where that part ends is nothing that two cameras
share. Further out the line is removed as noise, and there it is told from noise with ease: it
starts at the object, goes with it, and goes on in one direction. A part of the object itself, as
an antenna or a leg, ends.
"""

from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

HALF_WIDTH_PX = 2.0
"""On each side of the line's middle, whose events are taken for its own. On pendulums in a room
1.2 to 3 px served alike; a line's image is hardly a pixel wide, but its place is found to one."""

_HALF_WINDOW_US = 20_000
_SAMPLED = 5  # one window in as many tells whether there is a line, and its first course
_FIRST = 20  # of those, over all the recording: where none has a line there is none
_LEAST_SEEN, _LEAST_OF_HALF = 60, 20  # events of the object in a window, and in each half of it
_REACH = 0.9  # share of the object's events that are within its reach
_FROM_REACH, _FROM_PX = 1.5, 3.0  # times the reach, and more, from which a line is looked for
_LENGTH_PX = 60.0  # up to which it is followed from there
_LEAST_LENGTH_PX = 15.0  # within the view
_BORDER_PX = 2.0
_DIRECTIONS = 240
_LEAST_FAR = 10  # events there at all
_LEAST_ON = 12  # events of a line
_ABOVE = 4.0  # and so many times more than as wide a strip beside it has
_HALF_STRIP_PX, _BESIDE_PX = 1.5, (3.0, 9.0)
_PARTS, _LEAST_OF_PART = 5, 0.05  # of its length, each of which has such a share of the events
_GATES_PX = (3.0, 2.0, 2.0)  # on each side, of the events that a line is fitted to
_LEAST_FITTED = 8
_LEAST_CLEAR = 8  # windows with a line
_LEAST_SHARE = 0.3  # of the windows, as nothing is seen of a line that rests
_LEAST_ALIKE = 0.8  # length of the mean of its directions
_SMOOTHED = 5  # windows


@dataclass(frozen=True)
class _Window:
    """The object in a window, and what is beside it, moved to the window's middle."""

    centre_px: Array  # (2,)
    velocity_px_us: Array  # (2,)
    start_px: float  # of a line, from the centre
    far_px: Array  # (m, 2) events further out, from the centre


@dataclass(frozen=True)
class _Line:
    """A line through, or near, an object's centre."""

    angle_rad: float  # in which it goes, in the image
    offset_px: float  # to the left of the centre, as seen in its direction
    is_clear: bool = False
    has_room: bool = True  # within the view, to be clear


def events_on_line(
    events: NDArray[np.void], kept: NDArray[np.void], width: int, height: int
) -> Mask | None:
    """Find the events of a thin line that goes from the object on, far beyond it.

    Parameters
    ----------
    events
        As recorded, shape (N,), sorted by time.
    kept
        Those that denoising left, shape (n,).
    width, height
        Sensor size [px].

    Returns
    -------
    NDArray or None
        Shape (n,), which of those left lie where such a line is, the object's own there among
        them. None, unless there is one in much of the recording, on one side of the object.
    """
    if len(kept) < _LEAST_SEEN:
        return None
    middles_us = _middles_us(kept["t"])
    numbers = list(range(0, len(middles_us), _SAMPLED))
    step = max(1, len(numbers) // _FIRST)
    clear: dict[int, _Line] = {}
    n_tested = 0
    for some in (numbers[::step], [k for i, k in enumerate(numbers) if i % step]):
        for k in some:
            window = _window(events, kept, middles_us[k])
            line = None if window is None else _voted(window, width, height)
            n_tested += window is not None and (line is None or line.has_room)
            if line is not None and line.is_clear:
                clear[k] = line
        if not clear:
            return None
    if len(clear) < max(_LEAST_CLEAR, _LEAST_SHARE * n_tested):
        return None
    sampled = dict(sorted(clear.items()))
    angles_rad = np.array([line.angle_rad for line in sampled.values()])
    if np.abs(np.mean(np.exp(1j * angles_rad))) < _LEAST_ALIKE:
        return None
    places = np.arange(len(middles_us))
    guesses_rad = np.interp(places, list(sampled), np.unwrap(angles_rad))
    offsets_px = np.interp(places, list(sampled), [one.offset_px for one in sampled.values()])
    course = np.full((len(middles_us), 6), np.nan)  # centre, velocity, angle, offset
    for k, middle_us in enumerate(middles_us):
        window = _window(events, kept, middle_us)
        if window is None:
            continue
        course[k, :2], course[k, 2:4] = window.centre_px, window.velocity_px_us
        line = sampled.get(k) or _fitted(window, guesses_rad[k], offsets_px[k], width, height)
        if line is not None and line.is_clear:
            course[k, 4:] = line.angle_rad, line.offset_px
    return _beside(kept, middles_us, course)


@numba.njit(cache=True)
def _middles_us(times_us: NDArray[np.int64]) -> NDArray[np.int64]:
    """Cut a recording into windows, and give the middles (m,) of those that hold an event."""
    length_us = 2 * _HALF_WINDOW_US
    middles_us = np.empty((times_us[-1] - times_us[0]) // length_us + 1, np.int64)
    m = first = 0
    while first < len(times_us):
        start_us = times_us[first] - (times_us[first] - times_us[0]) % length_us
        middles_us[m] = start_us + _HALF_WINDOW_US
        m += 1
        first += np.searchsorted(times_us[first:], start_us + length_us)
    return middles_us[:m]


def _window(
    events: NDArray[np.void], kept: NDArray[np.void], middle_us: np.int64
) -> _Window | None:
    """Look at the object about a time; None where too little of it is seen."""
    object_at = _object_at(kept["t"], kept["x"], kept["y"], middle_us)
    if object_at is None:
        return None
    centre, velocity, reach_px = object_at
    start_px = _FROM_REACH * reach_px + _FROM_PX
    far = _far_from(events["t"], events["x"], events["y"], middle_us, centre, velocity, start_px)
    return _Window(centre, velocity, start_px, far)


@numba.njit(cache=True)
def _object_at(
    t: NDArray[np.int64], x: NDArray[np.uint16], y: NDArray[np.uint16], middle_us: np.int64
) -> tuple[Array, Array, float] | None:
    """Median place (2,) [px] of a window's events, their velocity (2,) [px/us] and reach [px]."""
    first, middle, last = _bounds(t, middle_us)
    n, n_early = last - first, middle - first
    if n < _LEAST_SEEN or min(n_early, n - n_early) < _LEAST_OF_HALF:
        return None
    centre, velocity, away_px = np.empty(2), np.empty(2), np.zeros(n)
    places = np.empty(n)
    for axis, pixels in enumerate((x, y)):
        shift_px = _median(pixels[middle:last]) - _median(pixels[first:middle])
        velocity[axis] = shift_px / _HALF_WINDOW_US
        for i in range(n):
            places[i] = pixels[first + i] - (t[first + i] - middle_us) * velocity[axis]
        centre[axis] = np.median(places)
        for i in range(n):
            away_px[i] += (places[i] - centre[axis]) ** 2
    return centre, velocity, _quantile(np.sqrt(away_px), _REACH)


@numba.njit(cache=True)
def _median(pixels: NDArray[np.uint16]) -> float:
    """Median of whole numbers (n,), n > 0, by counting: three times as fast as by sorting."""
    least, most = pixels[0], pixels[0]
    for i in range(len(pixels)):
        least, most = min(least, pixels[i]), max(most, pixels[i])
    counts = np.zeros(most - least + 1, np.int32)
    for i in range(len(pixels)):
        counts[pixels[i] - least] += 1
    total, sides = 0, 0
    for k in range(len(counts)):  # the two in the middle, or twice the one
        before, total = total, total + counts[k]
        for place in ((len(pixels) - 1) // 2, len(pixels) // 2):
            sides += k * (before <= place < total)
    median: float = least + 0.5 * sides
    return median


@numba.njit(cache=True)
def _quantile(values: Array, share: float) -> float:
    """`np.quantile` of values (n,), n > 1, to the last bit, which numba's own is not."""
    place = share * (len(values) - 1)
    k = int(place)
    ordered = np.partition(values, k)
    low, high, after = ordered[k], np.min(ordered[k + 1 :]), place - k
    gap = high - low
    found: float = low + gap * after if after < 0.5 else high - gap * (1.0 - after)
    return found


@numba.njit(cache=True)
def _far_from(
    t: NDArray[np.int64],
    x: NDArray[np.uint16],
    y: NDArray[np.uint16],
    middle_us: np.int64,
    centre: Array,
    velocity: Array,
    start_px: float,
) -> NDArray[np.float64]:
    """Places (m, 2) [px], from a moving centre, of a window's events where a line may be."""
    first, _, last = _bounds(t, middle_us)
    found = np.empty((last - first, 2))
    m = 0
    for i in range(first, last):
        age_us = t[i] - middle_us
        found[m, 0] = x[i] - (age_us * velocity[0] + centre[0])
        found[m, 1] = y[i] - (age_us * velocity[1] + centre[1])
        away_px = np.sqrt(found[m, 0] ** 2 + found[m, 1] ** 2)
        m += start_px < away_px < start_px + _LENGTH_PX  # else it is written over
    return found[:m].copy()


@numba.njit(cache=True)
def _bounds(t: NDArray[np.int64], middle_us: np.int64) -> tuple[np.intp, np.intp, np.intp]:
    """Index of the first event of a window, of its second half, and after it."""
    half_us = _HALF_WINDOW_US
    first, last = np.searchsorted(t, middle_us - half_us), np.searchsorted(t, middle_us + half_us)
    return first, first + np.searchsorted(t[first:last], middle_us), last


def _voted(window: _Window, width: int, height: int) -> _Line | None:
    """Find the line through the object with the most events; None where there are few."""
    if len(window.far_px) < _LEAST_FAR:
        return None
    half = int((window.start_px - _FROM_PX) / _FROM_REACH)  # a line meets the object
    found = _votes(window.far_px, window.start_px, _DIRECTIONS, half + 1)
    strips = found[:, :-2] + found[:, 1:-1] + found[:, 2:]
    direction, strip = np.unravel_index(int(np.argmax(strips)), strips.shape)
    angle_rad = 2.0 * np.pi * float(direction) / _DIRECTIONS
    return _fitted(window, angle_rad, float(strip) - half, width, height)


@numba.njit(cache=True)
def _votes(points: Array, start_px: float, n_directions: int, most_px: int) -> NDArray[np.int64]:
    """Count the events of strips of a pixel (directions, 2 * most_px + 1), by their offsets."""
    found = np.zeros((n_directions, 2 * most_px + 1), np.int64)
    step_rad = 2.0 * np.pi / n_directions
    for i in range(len(points)):
        x, y = points[i]
        aside = min((most_px + 1.0) / np.hypot(x, y), 1.0)
        first = int(np.ceil((np.arctan2(y, x) - np.arcsin(aside)) / step_rad))
        last = int(np.floor((np.arctan2(y, x) + np.arcsin(aside)) / step_rad))
        for j in range(first, last + 1):
            c, s = np.cos(j * step_rad), np.sin(j * step_rad)
            strip = int(np.floor(y * c - x * s + most_px + 0.5))
            if x * c + y * s > start_px and 0 <= strip <= 2 * most_px:
                found[j % n_directions, strip] += 1
    return found


def _fitted(
    window: _Window, angle_rad: float, offset_px: float, width: int, height: int
) -> _Line | None:
    """Fit a line to the events near a first one, and tell whether it is clear; None of few."""
    for gate_px in _GATES_PX:
        along, across = _turned(window.far_px, angle_rad)
        near = (np.abs(across - offset_px) < gate_px) & (along > window.start_px)
        if np.count_nonzero(near) < _LEAST_FITTED:
            return None
        mean = along[near].mean()
        ages = along[near] - mean
        slope = float(ages @ across[near] / (ages @ ages + 1e-9))
        turn_rad = float(np.arctan(slope))
        offset_px = float(across[near].mean() - slope * mean) * float(np.cos(turn_rad))
        angle_rad += turn_rad
    along, across = _turned(window.far_px, angle_rad)
    aside = np.abs(across - offset_px)
    end_px = _room_px(window.centre_px, angle_rad, width, height) - _BORDER_PX
    end_px = min(window.start_px + _LENGTH_PX, end_px)
    if end_px - window.start_px < _LEAST_LENGTH_PX:
        return _Line(angle_rad, offset_px, has_room=False)
    within = (along > window.start_px) & (along < end_px)
    on = within & (aside < _HALF_STRIP_PX)
    beside = within & (aside > _BESIDE_PX[0]) & (aside < _BESIDE_PX[1])
    n_on = int(np.count_nonzero(on))
    by_chance = np.count_nonzero(beside) * _HALF_STRIP_PX / (_BESIDE_PX[1] - _BESIDE_PX[0])
    parts = np.histogram(along[on], _PARTS, (window.start_px, end_px))[0]
    is_even = bool(parts.min() >= _LEAST_OF_PART * n_on)
    return _Line(angle_rad, offset_px, is_even and n_on >= _LEAST_ON + _ABOVE * by_chance)


def _turned(points: Array, angle_rad: float | Array) -> tuple[Array, Array]:
    """Coordinates (n,) along a direction, and across it."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    x, y = points[:, 0], points[:, 1]
    return np.asarray(x * c + y * s), np.asarray(y * c - x * s)


def _room_px(centre_px: Array, angle_rad: float, width: int, height: int) -> float:
    """How far it is from a place to the border of the view."""
    direction = np.array([np.cos(angle_rad), np.sin(angle_rad)])
    ends = np.where(direction > 0.0, [width - 1.0, height - 1.0], 0.0)
    return float(np.min((ends - centre_px) / np.where(direction == 0.0, 1e-9, direction)))


def _beside(kept: NDArray[np.void], middles_us: NDArray[np.int64], course: Array) -> Mask:
    """Tell the events near the line whose course (m, 6) is known in some windows."""
    middles = middles_us.astype(np.float64)
    turns = np.isfinite(course[:, 4])
    course[turns, 4] = np.unwrap(course[turns, 4])
    for column in course.T:
        known = np.isfinite(column)
        column[:] = np.interp(middles, middles[known], column[known])
    course[:, 4:] = median_filter(course[:, 4:], (_SMOOTHED, 1), mode="nearest")
    times = kept["t"].astype(np.float64)
    at = np.searchsorted(middles_us + _HALF_WINDOW_US, kept["t"], side="right")
    ages_us = times - middles[at]
    points = np.column_stack([kept["x"].astype(np.float64), kept["y"].astype(np.float64)])
    points -= course[at, :2] + ages_us[:, None] * course[at, 2:4]
    along, across = _turned(points, np.interp(times, middles, course[:, 4]))
    aside = np.abs(across - np.interp(times, middles, course[:, 5]))
    return np.asarray((along > 0.0) & (aside < HALF_WIDTH_PX))
