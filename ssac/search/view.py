"""One camera's view of the object: its path's extent and straightness, and when it is seen.

If the object is seen most of the time, sample times are even and some samples are invalid. In
flights spread over an hour nearly all would be, so only times at which it is seen are sampled.

A camera that takes frames beside events, as a DAVIS does, is blind while it reads a frame out: all
events are lost. A recording need not say so, but its events do: they stop and begin again abruptly,
with silences of equal length in one rhythm. An object that comes to rest, or whose edges cross rows
of pixels all at once, makes silences too, but never such regular ones.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ssac.arrays import Array, Indices, IntArray, Mask
from ssac.config import MIN_SWINGS
from ssac.events import no_gaps
from ssac.geometry.epipolar import robust_deviation
from ssac.geometry.fundamental import median_after_fit
from ssac.geometry.pose import homography
from ssac.rules import BlindRules, ViewRules
from ssac.track.motion import Motion, ObjectMotion


@dataclass(frozen=True)
class Seen:
    """Whether a camera sees the object, step by step."""

    start_s: float
    step_s: float
    valid: Mask  # (n,) at the middle of each step

    @property
    def share(self) -> float:
        """Share of the time in which the object is seen."""
        return float(np.mean(self.valid)) if len(self.valid) else 0.0

    def spread(self, n: int, some: slice = slice(None), more: Mask | bool = True) -> Array:
        """Spread n times [s] evenly over the steps in slice `some` that are valid and in `more`."""
        steps = np.flatnonzero(self.valid[some] & more)
        if len(steps) == 0:
            return np.empty(0)
        places = (np.arange(n) + 0.5) * len(steps) / n  # in valid steps
        whole, first = places.astype(np.intp), some.start or 0
        return np.asarray(self.start_s + self.step_s * (first + steps[whole] + places - whole))


def seen_of(motion: Motion, step_s: float | None = None) -> Seen:
    """Tell in which steps of a motion's span it is valid; by default, choose the step."""
    start_s, end_s = motion.span_s
    length_s = max(end_s - start_s, 0.0) if np.isfinite(end_s - start_s) else 0.0
    if step_s is None:  # windows of events resolve no finer
        step_s = max(0.02, length_s / 50_000)
    times_s = start_s + step_s * (np.arange(int(length_s / step_s), dtype=np.float64) + 0.5)
    return Seen(start_s, step_s, motion.at(times_s).valid)


def seen_by_both(one: Seen, other: Seen, t_d_s: float, n: int, even_share: float) -> Array | None:
    """Spread n times [s] of camera 1's clock over the time in which both cameras see the object.

    None if that time is zero, or at least `even_share` of the time in which both record.
    """
    shift = round((one.start_s + t_d_s - other.start_s) / one.step_s)  # other = one + shift
    first, last = max(0, -shift), min(len(one.valid), len(other.valid) - shift)
    if last <= first:
        return None
    there = other.valid[first + shift : last + shift]
    both = one.valid[first:last] & there
    if not both.any() or np.mean(both) >= even_share:
        return None
    return one.spread(n, slice(first, last), there)


def blind_spans(times_us: IntArray, rules: BlindRules) -> IntArray:
    """Find the spans (g, 2) [us], ascending, of frame readouts from the sorted times of events.

    There are none unless most of the events lie between silences of one rhythm.
    """
    silences_us = _sudden_silences(times_us, rules)
    if len(silences_us) < rules.least_silences:
        return no_gaps()
    lengths_us = np.diff(silences_us)[:, 0]
    length_us = float(np.median(lengths_us))
    alike = np.abs(lengths_us - length_us) <= rules.same_length * length_us
    if np.mean(alike) < 1.0 - rules.most_lengths:
        return no_gaps()
    spans_us = silences_us[alike]
    since_us = np.diff(spans_us[:, 0])
    period_us = float(np.median(since_us))
    beats = np.rint(since_us / period_us)
    near = (beats >= 1.0) & (beats <= rules.most_periods)
    few = np.count_nonzero(near) < rules.least_silences - 1
    if few or length_us > rules.most_share * period_us:
        return no_gaps()
    period_us = float(np.sum(since_us[near]) / np.sum(beats[near]))
    on_beat = np.abs(since_us - beats * period_us) <= rules.same_rhythm * period_us
    if np.mean(on_beat[near]) < 1.0 - rules.most_others:
        return no_gaps()
    chained = near & on_beat
    spans_us = _filled(spans_us, np.where(chained, beats, 0.0).astype(np.intp))
    return spans_us if _cut(times_us, spans_us, period_us, rules) else no_gaps()


def _sudden_silences(times_us: IntArray, rules: BlindRules) -> IntArray:
    """Find the silences (g, 2) [us] too long for chance at the rate of events beside them."""
    at = np.flatnonzero(np.diff(times_us) >= rules.shortest_us)
    starts_us, ends_us = times_us[at], times_us[at + 1]
    before = at + 1 - np.searchsorted(times_us, starts_us - rules.beside_us)
    after = np.searchsorted(times_us, ends_us + rules.beside_us, side="right") - (at + 1)
    lengths_us = ends_us - starts_us
    expected = np.minimum(before, after) * lengths_us / rules.beside_us
    sudden = (lengths_us <= rules.longest_us) & (expected >= rules.least_expected)
    return np.asarray(np.column_stack([starts_us, ends_us])[sudden])


def _filled(spans_us: IntArray, beats: Indices) -> IntArray:
    """Fill in the missing spans between neighbours that are several beats apart."""
    parts = [spans_us]
    for k in np.flatnonzero(beats > 1):
        step_us = (spans_us[k + 1] - spans_us[k]) / beats[k]
        since_us = np.rint(step_us * np.arange(1, beats[k])[:, None])
        parts.append(spans_us[k] + since_us.astype(np.int64))
    joined = np.concatenate(parts)
    return joined[np.argsort(joined[:, 0])]


def _cut(times_us: IntArray, spans_us: IntArray, period_us: float, rules: BlindRules) -> bool:
    """Whether next to no events lie within the spans, and most lie between them."""
    lengths_us = np.diff(spans_us)[:, 0]
    middles_us = spans_us + np.outer(lengths_us // 10, [1, -1])  # without the inexact ends
    inside = np.sum(np.diff(np.searchsorted(times_us, middles_us)))
    within = np.diff(spans_us[:, 0]) <= 1.5 * period_us
    bounds = np.searchsorted(times_us, spans_us[:, 0])
    n_cut = np.sum(np.diff(bounds)[within])
    expected = n_cut * float(np.median(lengths_us)) / period_us
    return bool(inside <= rules.most_inside * expected and n_cut >= rules.least_cut * len(times_us))


@dataclass(frozen=True)
class View:
    """How one camera saw the object move, over all of its recording."""

    extent_px: float  # rms distance of the track from its middle
    width_px: float  # deviation across the track's longest direction, robust
    length_px: float  # deviation along that direction
    size_px: float  # rms size of the object's image
    swing_hz: float  # mean rate of going to and fro: see `swing_hz`
    middle_px: Array  # (2,) mean position
    direction: Array  # (2,) unit vector along the track's longest direction
    is_straight: bool  # only noise and the object's turning make it leave a straight line


def view_of(motion: Motion, rules: ViewRules) -> View | None:
    """Summarise a motion; None if fewer than two of its samples are valid."""
    start_s, end_s = motion.span_s
    if not end_s > start_s:
        return None
    n_samples = 200
    times_s = start_s + (end_s - start_s) * (np.arange(n_samples) + 0.5) / n_samples
    track = motion.at(times_s)
    if np.mean(track.valid) < rules.even_share:
        times_s = seen_of(motion).spread(n_samples)
        track = motion.at(times_s)
    positions = track.positions_px[track.valid]
    if len(positions) < 2:
        return None
    middle = np.mean(positions, axis=0)
    _, deviations, axes = np.linalg.svd(positions - middle, full_matrices=False)
    across = (positions - middle) @ axes[1]
    root_n, seen_s = np.sqrt(len(positions)), times_s[track.valid]
    width_px, length_px = robust_deviation(across), float(deviations[0] / root_n)
    image_px = size_px(motion, seen_s)
    return View(
        extent_px=float(np.linalg.norm(deviations) / root_n),
        width_px=width_px,
        length_px=length_px,
        size_px=image_px,
        swing_hz=swing_hz(positions, motion.velocities_at(seen_s)),
        middle_px=middle,
        direction=axes[0],
        is_straight=width_px < min(rules.max_width * image_px, rules.max_slenderness * length_px),
    )


def size_px(motion: Motion, times_s: Array) -> float:
    """Median rms size [px] of the object's image at some of the times; NaN if none is known."""
    some_s = times_s[:: max(1, len(times_s) // 16)]  # each takes a pass over its window's events
    sizes = motion.sharp_at(some_s).sizes_px
    sizes = sizes[np.isfinite(sizes)]
    return float(np.median(sizes)) if len(sizes) else np.nan


def swing_hz(positions_px: Array, velocities_px_s: Array) -> float:
    """How often a path goes to and fro [1/s], by Rice's formula for a random motion's crossings."""
    squares = np.sum(velocities_px_s**2, axis=1)
    squares = squares[np.isfinite(squares)]
    speed_px_s = np.sqrt(np.mean(squares)) if len(squares) else 0.0
    extent_px = np.sqrt(np.sum(np.var(positions_px, axis=0))) + 1e-12
    return float(speed_px_s / (np.pi * extent_px))


def returns_s(motion: Motion, view: View | None, longest_s: float, rules: ViewRules) -> Array:
    """Find the lags (k,) up to `longest_s` [s], ascending, after which a path repeats itself."""
    start_s, end_s = motion.span_s
    n_samples = 60  # for each lag
    step_s = max(0.002, (end_s - start_s) / 120_000)  # longer if a path lasts over 4 minutes
    n = int((end_s - start_s) / step_s) if end_s > start_s else 0
    if view is None or n < 4:
        return np.empty(0)
    track = motion.at(start_s + step_s * np.arange(n, dtype=np.float64))
    path_px = np.where(track.valid[:, None], track.positions_px, np.nan)
    lags = np.arange(1, int(min(n // 2, longest_s / step_s + 2)))
    here = np.linspace(0, n - 1 - lags[-1], n_samples).astype(np.intp)
    there_px = path_px[here[:, None] + lags]
    distances_px = np.linalg.norm(there_px - path_px[here][:, None], axis=2)
    known = np.isfinite(distances_px)
    distances_px = np.minimum(np.where(known, distances_px, 0.0), 2.0 * view.extent_px)
    counts = np.count_nonzero(known, axis=0)
    means_px = np.sum(distances_px, axis=0) / np.maximum(counts, 1)
    means_px = np.where(counts >= n_samples // 2, means_px, np.inf)
    left = np.cumsum(means_px > 0.5 * view.extent_px) > 0
    is_back = left & (means_px < rules.max_return * view.extent_px)
    least = np.sort(local_minima(means_px))
    return np.asarray(step_s * lags[least[is_back[least]]])


def is_uniform(motion: Motion, view: View | None, rules: ViewRules) -> bool:
    """Whether a path fits itself after any lag, as a camera elsewhere would see it.

    This is so of a uniform turn, lift or both: on a circle, helix or line each offset fits, with a
    pose of its own. A path in a plane is tried by a homography, as it leaves F open; a short one
    fits anything.
    """
    (start_s, end_s), n_samples, least, rounds = motion.span_s, 200, 50, 8
    if view is None or view.is_straight or view.swing_hz * (end_s - start_s) < MIN_SWINGS:
        return False
    most_px = rules.max_uniform * view.extent_px
    for share in rules.uniform_lags:
        lag_s = share * (end_s - start_s)
        times_s = np.linspace(start_s, end_s - lag_s, n_samples, dtype=np.float64)
        here, there = motion.at(times_s), motion.at(times_s + lag_s)
        both = here.valid & there.valid
        if np.count_nonzero(both) < least:
            return False
        p1, p2 = here.positions_px[both], there.positions_px[both]
        if median_after_fit(p1, p2, rounds) > most_px and homography(p1, p2)[1] > most_px:
            return False
    return True


def local_minima(values: Array) -> Indices:
    """Find the local minima of values (n,) as indices, the least first; NaN counts as infinite."""
    padded = np.pad(np.where(np.isfinite(values), values, np.inf), 1, constant_values=np.inf)
    places = np.flatnonzero((padded[1:-1] <= padded[:-2]) & (padded[1:-1] < padded[2:]))
    return places[np.argsort(values[places], kind="stable")]


@dataclass(frozen=True)
class Alone:
    """Properties of each of two motions on its own, computed on first use and cached."""

    motions: tuple[Motion, Motion]
    longest_s: float  # largest lag in `returns_s`
    rules: ViewRules
    of_blind: BlindRules

    @cached_property
    def views(self) -> tuple[View | None, View | None]:
        """Summary of each view; None where fewer than two samples are valid."""
        return view_of(self.motions[0], self.rules), view_of(self.motions[1], self.rules)

    @property
    def are_straight(self) -> bool:
        """Whether the path is a straight line in both views."""
        return all(view is not None and view.is_straight for view in self.views)

    @cached_property
    def returns_s(self) -> Array:
        """Lags (k,) [s] after which camera 1's path repeats itself."""
        return returns_s(self.motions[0], self.views[0], self.longest_s, self.rules)

    @cached_property
    def repeats(self) -> bool:
        """Whether camera 1's path repeats itself after any lag."""
        return len(returns_s(self.motions[0], self.views[0], np.inf, self.rules)) > 0

    @cached_property
    def are_uniform(self) -> bool:
        """Whether both cameras see a path that fits itself after any lag."""
        both = zip(self.motions, self.views, strict=True)
        return all(is_uniform(motion, view, self.rules) for motion, view in both)

    @cached_property
    def seen(self) -> tuple[Seen, Seen] | None:
        """When each camera sees the object; None if both do most of the time, or one never does."""
        if any(motion.span_s[1] <= motion.span_s[0] for motion in self.motions):
            return None
        one, other = (seen_of(motion) for motion in self.motions)
        if one.share + other.share - 1.0 >= self.rules.even_share:
            return None
        step_s = max(one.step_s, other.step_s)
        return seen_of(self.motions[0], step_s), seen_of(self.motions[1], step_s)

    @cached_property
    def blind_us(self) -> list[IntArray]:
        """Spans (g, 2) [us] in which each camera was blind, on its own clock."""
        return [
            blind_spans(one.times_us, self.of_blind) if isinstance(one, ObjectMotion) else no_gaps()
            for one in self.motions
        ]
