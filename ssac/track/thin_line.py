"""Find the events of a thin line that holds the object, such as a thread, a wire or a rod.

Next to the object, denoising keeps the line's events with the object's, up to a point that is not
the same for two cameras. Further out it removes the line as noise, and there the line is easy to
find: it starts at the object, moves with it and goes on in one direction. An antenna or a leg ends.
"""

from dataclasses import dataclass

import numba
import numpy as np
from scipy.ndimage import median_filter

from ssac.arrays import Array, Events, IntArray, Mask
from ssac.events import first_from
from ssac.rules import LineRules


@dataclass(frozen=True)
class _Window:
    """The object in a time window, and the events beside it, moved to the window's middle time."""

    size_px: tuple[int, int]  # of the view
    centre_px: Array  # (2,)
    velocity_px_us: Array  # (2,)
    start_px: float  # from the centre, beyond which a line is looked for
    far_px: Array  # (m, 2) events further out, relative to the centre


@dataclass(frozen=True)
class _Line:
    """A line through, or near, an object's centre."""

    angle_rad: float  # of its direction in the image
    offset_px: float  # from the centre, along the direction turned by 90 deg from x to y
    is_clear: bool = False
    has_room: bool = True  # it is long enough within the view to be clear


def events_on_line(
    events: Events, kept: Events, width: int, height: int, rules: LineRules
) -> Mask | None:
    """Find the events of a thin line that leads from the object far beyond it.

    Returns the mask (n,) of the events `kept` by denoising, out of all `events`, that lie on such a
    line; both are sorted by time. None unless much of the recording shows it on the same side.
    """
    if len(kept) < rules.min_events:
        return None
    start_us, length_us = kept["t"][0], 2 * rules.half_window_us
    starts_us = np.arange(start_us, kept["t"][-1] + 1, length_us)
    ends = first_from(kept["t"], np.append(starts_us[1:], kept["t"][-1] + 1))
    middles_us = starts_us[np.diff(ends, prepend=0) > 0] + rules.half_window_us  # with events
    numbers = list(range(0, len(middles_us), rules.look_every))
    step = max(1, len(numbers) // rules.first_windows)
    clear: dict[int, _Line] = {}
    n_tested = 0
    for some in (numbers[::step], [k for i, k in enumerate(numbers) if i % step]):
        for k in some:
            window = _window(events, kept, middles_us[k], (width, height), rules)
            line = None if window is None else _voted(window, rules)
            n_tested += window is not None and (line is None or line.has_room)
            if line is not None and line.is_clear:
                clear[k] = line
        if not clear:
            return None
    if len(clear) < max(rules.min_clear_windows, rules.min_clear_share * n_tested):
        return None
    sampled = dict(sorted(clear.items()))
    angles_rad = np.array([line.angle_rad for line in sampled.values()])
    if np.abs(np.mean(np.exp(1j * angles_rad))) < rules.min_alike:
        return None
    places = np.arange(len(middles_us))
    guesses_rad = np.interp(places, list(sampled), np.unwrap(angles_rad))
    offsets_px = np.interp(places, list(sampled), [one.offset_px for one in sampled.values()])
    course = np.full((len(middles_us), 6), np.nan)  # centre, velocity, angle, offset
    for k, middle_us in enumerate(middles_us):
        window = _window(events, kept, middle_us, (width, height), rules)
        if window is None:
            continue
        course[k, :2], course[k, 2:4] = window.centre_px, window.velocity_px_us
        line = sampled.get(k) or _fitted(window, guesses_rad[k], offsets_px[k], rules)
        if line is not None and line.is_clear:
            course[k, 4:] = line.angle_rad, line.offset_px
    return _beside(kept, middles_us, course, rules)


def _window(
    events: Events, kept: Events, middle_us: np.int64, size_px: tuple[int, int], rules: LineRules
) -> _Window | None:
    """Measure the object in the window about a time; None where it has too few events."""
    edges_us = middle_us + rules.half_window_us * np.array([-1, 0, 1])
    first, middle, last = first_from(kept["t"], edges_us)
    halves = middle - first, last - middle
    if sum(halves) < rules.min_events or min(halves) < rules.min_half_events:
        return None
    centre, velocity, squares_px2 = np.empty(2), np.empty(2), np.zeros(last - first)
    ages_us = kept["t"][first:last] - middle_us
    for axis, pixels in enumerate((kept["x"], kept["y"])):
        shift_px = np.median(pixels[middle:last]) - np.median(pixels[first:middle])
        velocity[axis] = shift_px / rules.half_window_us
        places = pixels[first:last] - ages_us * velocity[axis]
        centre[axis] = np.median(places)
        squares_px2 += (places - centre[axis]) ** 2
    reach_px = float(np.quantile(np.sqrt(squares_px2), rules.reach_share))
    start_px = rules.from_reach * reach_px + rules.from_px
    first, last = first_from(events["t"], np.delete(edges_us, 1))
    every = events[first:last]
    ages_us = every["t"] - middle_us
    points = [
        every[name] - (ages_us * velocity[axis] + centre[axis])
        for axis, name in enumerate(("x", "y"))
    ]
    away_px = np.sqrt(points[0] ** 2 + points[1] ** 2)
    far = (away_px > start_px) & (away_px < start_px + rules.length_px)
    return _Window(size_px, centre, velocity, start_px, np.column_stack(points)[far])


def _voted(window: _Window, rules: LineRules) -> _Line | None:
    """Find the line through the object with the most events; None where there are few."""
    if len(window.far_px) < rules.min_far_events:
        return None
    half = int((window.start_px - rules.from_px) / rules.from_reach)  # the line meets the object
    found = _votes(window.far_px, window.start_px, rules.n_directions, half + 1)
    strips = found[:, :-2] + found[:, 1:-1] + found[:, 2:]
    direction, strip = np.unravel_index(int(np.argmax(strips)), strips.shape)
    angle_rad = 2.0 * np.pi * float(direction) / rules.n_directions
    return _fitted(window, angle_rad, float(strip) - half, rules)


@numba.njit(cache=True)
def _votes(points: Array, start_px: float, n_directions: int, most_px: int) -> IntArray:
    """Count the events in strips 1 px wide (directions, 2 * most_px + 1), by angle and offset."""
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


def _fitted(window: _Window, angle_rad: float, offset_px: float, rules: LineRules) -> _Line | None:
    """Fit a line to the events near a first line, and test if it is clear; None of too few."""
    for gate_px in (rules.first_gate_px, rules.gate_px, rules.gate_px):
        along, across = _turned(window.far_px, angle_rad)
        near = (np.abs(across - offset_px) < gate_px) & (along > window.start_px)
        if np.count_nonzero(near) < rules.min_fitted_events:
            return None
        mean = along[near].mean()
        ages = along[near] - mean
        slope = float(ages @ across[near] / (ages @ ages + 1e-9))
        turn_rad = float(np.arctan(slope))
        offset_px = float(across[near].mean() - slope * mean) * float(np.cos(turn_rad))
        angle_rad += turn_rad
    along, across = _turned(window.far_px, angle_rad)
    aside = np.abs(across - offset_px)
    direction = np.array([np.cos(angle_rad), np.sin(angle_rad)])
    ends_px = np.where(direction > 0.0, np.array(window.size_px) - 1.0, 0.0) - window.centre_px
    room_px = float(np.min(ends_px / np.where(direction == 0.0, 1e-9, direction)))
    end_px = min(window.start_px + rules.length_px, room_px - rules.border_px)
    if end_px - window.start_px < rules.min_length_px:
        return _Line(angle_rad, offset_px, has_room=False)
    within = (along > window.start_px) & (along < end_px)
    on = within & (aside < rules.half_strip_px)
    beside = within & (aside > rules.beside_from_px) & (aside < rules.beside_to_px)
    n_on = int(np.count_nonzero(on))
    beside_px = rules.beside_to_px - rules.beside_from_px
    by_chance = np.count_nonzero(beside) * rules.half_strip_px / beside_px
    parts = np.histogram(along[on], rules.parts, (window.start_px, end_px))[0]
    is_even = bool(parts.min() >= rules.min_part_share * n_on)
    least = rules.min_line_events + rules.min_over_beside * by_chance
    return _Line(angle_rad, offset_px, is_even and n_on >= least)


def _turned(points: Array, angle_rad: float | Array) -> tuple[Array, Array]:
    """Coordinates (n,) along a direction, and across it."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    x, y = points[:, 0], points[:, 1]
    return np.asarray(x * c + y * s), np.asarray(y * c - x * s)


def _beside(kept: Events, middles_us: IntArray, course: Array, rules: LineRules) -> Mask:
    """Mask the events near the line, whose course (m, 6) is known in some of the windows."""
    middles = middles_us.astype(np.float64)
    turns = np.isfinite(course[:, 4])
    course[turns, 4] = np.unwrap(course[turns, 4])
    for column in course.T:
        known = np.isfinite(column)
        column[:] = np.interp(middles, middles[known], column[known])
    course[:, 4:] = median_filter(course[:, 4:], (rules.smoothed_windows, 1), mode="nearest")
    times = kept["t"].astype(np.float64)
    at = np.searchsorted(middles_us + rules.half_window_us, kept["t"], side="right")
    ages_us = times - middles[at]
    points = np.column_stack([kept["x"].astype(np.float64), kept["y"].astype(np.float64)])
    points -= course[at, :2] + ages_us[:, None] * course[at, 2:4]
    along, across = _turned(points, np.interp(times, middles, course[:, 4]))
    aside = np.abs(across - np.interp(times, middles, course[:, 5]))
    return np.asarray((along > 0.0) & (aside < rules.half_width_px))
