"""One camera's object motion in; how far, how straight and how often to and fro it goes, out."""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ssac.geometry.epipolar import robust_deviation
from ssac.track.motion import Motion, ObjectMotion

Array = NDArray[np.float64]

MOST = 0.5
"""Share of the time in which the object must be seen for even sample times."""

_SEEN_STEP_S = 0.02  # as finely as events' windows tell
_MAX_STEPS = 50_000


@dataclass(frozen=True)
class Seen:
    """Whether a camera sees the object, step by step."""

    start_s: float
    step_s: float
    valid: NDArray[np.bool_]  # (n,) at the middle of each step

    @property
    def share(self) -> float:
        """Of the time."""
        return float(np.mean(self.valid)) if len(self.valid) else 0.0


def seen_of(motion: Motion, step_s: float | None = None) -> Seen:
    """Look at a motion from end to end, in steps of its own choice where none is given."""
    start_s, end_s = motion.span_s
    length_s = max(end_s - start_s, 0.0) if np.isfinite(end_s - start_s) else 0.0
    step_s = max(_SEEN_STEP_S, length_s / _MAX_STEPS) if step_s is None else step_s
    times_s = start_s + step_s * (np.arange(int(length_s / step_s), dtype=np.float64) + 0.5)
    return Seen(start_s, step_s, motion.at(times_s).valid)


def seen_times(seen: Seen, n: int) -> Array:
    """Spread n times [s] evenly over those at which one camera sees the object; empty for none."""
    return _spread(seen, seen.valid, 0, n)


def seen_by_both(one: Seen, other: Seen, t_d_s: float, n: int) -> Array | None:
    """Spread n times [s], camera 1's clock, over those at which both cameras see the object.

    None where they do so most of the time that both record, or never.

    Parameters
    ----------
    one, other
        Of camera 1 and 2, in the same steps.
    t_d_s
        What camera 2's clock shows more [s].
    n
        Times wanted.
    """
    shift = round((one.start_s + t_d_s - other.start_s) / one.step_s)  # other = one + shift
    first, last = max(0, -shift), min(len(one.valid), len(other.valid) - shift)
    if last <= first:
        return None
    both = one.valid[first:last] & other.valid[first + shift : last + shift]
    if not both.any() or np.mean(both) >= MOST:
        return None
    return _spread(one, both, first, n)


def _spread(seen: Seen, valid: NDArray[np.bool_], first: int, n: int) -> Array:
    steps = np.flatnonzero(valid)
    places = (np.arange(n) + 0.5) * len(steps) / n  # in steps of those valid
    whole = places.astype(np.intp)
    if len(steps) == 0:
        return np.empty(0)
    return np.asarray(seen.start_s + seen.step_s * (first + steps[whole] + places - whole))


Spans = NDArray[np.int64]

_SHORTEST_US, _LONGEST_US = 3_000, 30_000  # of a readout
_BESIDE_US = 5_000  # on each side of a silence, where there must be many events
_EXPECTED = 20.0  # events that a silence would hold at their rate: by chance it holds some
_LEAST = 10  # silences that make a rhythm
_MOST_PERIODS = 10  # from one of them to the next: in between, the object may hardly move
_SAME_LENGTH, _SAME_RHYTHM = 0.2, 0.05  # shares by which lengths, and beats, differ at the most
_MOST_OTHERS = 0.2  # share of the silences of that length that are off the beat
_MOST_LENGTHS = 0.4  # share of the silences of another length: an object's own, in volleys
_MOST_SHARE = 0.6  # of a period, in which a camera that is of use is blind
_MOST_INSIDE = 0.02  # events within spans, as a share of what they would hold
_LEAST_CUT = 0.5  # share of the events that lie between spans of the rhythm


def no_spans() -> Spans:
    """Give the spans (0, 2) of a camera that is never blind."""
    return np.empty((0, 2), np.int64)


@dataclass(frozen=True)
class Blind:
    """When a camera was blind."""

    spans_us: Spans = field(default_factory=no_spans)  # (g, 2) [us] in its clock, ascending
    period_s: float = np.nan  # from one to the next; NaN of none


def blind_spans(times_us: NDArray[np.int64]) -> Blind:
    """Find the readouts of frames among the times of events.

    Parameters
    ----------
    times_us
        Shape (n,) [us], sorted.

    Returns
    -------
    Blind
        Without spans unless most of the events lie in one rhythm of silences.
    """
    silences_us = _sudden_silences(times_us)
    if len(silences_us) < _LEAST:
        return Blind()
    lengths_us = np.diff(silences_us)[:, 0]
    length_us = float(np.median(lengths_us))
    alike = np.abs(lengths_us - length_us) <= _SAME_LENGTH * length_us
    if np.mean(alike) < 1.0 - _MOST_LENGTHS:
        return Blind()
    spans_us = silences_us[alike]
    since_us = np.diff(spans_us[:, 0])
    period_us = float(np.median(since_us))
    beats = np.rint(since_us / period_us)
    near = (beats >= 1.0) & (beats <= _MOST_PERIODS)
    if np.count_nonzero(near) < _LEAST - 1 or length_us > _MOST_SHARE * period_us:
        return Blind()
    period_us = float(np.sum(since_us[near]) / np.sum(beats[near]))
    on_beat = np.abs(since_us - beats * period_us) <= _SAME_RHYTHM * period_us
    if np.mean(on_beat[near]) < 1.0 - _MOST_OTHERS:
        return Blind()
    chained = near & on_beat
    spans_us = _filled(spans_us, np.where(chained, beats, 0.0).astype(np.intp))
    return Blind(spans_us, 1e-6 * period_us) if _cut(times_us, spans_us, period_us) else Blind()


def _sudden_silences(times_us: NDArray[np.int64]) -> Spans:
    """Find the silences (g, 2) of busy times, too long for chance."""
    at = np.flatnonzero(np.diff(times_us) >= _SHORTEST_US)
    starts_us, ends_us = times_us[at], times_us[at + 1]
    before = at + 1 - np.searchsorted(times_us, starts_us - _BESIDE_US)
    after = np.searchsorted(times_us, ends_us + _BESIDE_US, side="right") - (at + 1)
    lengths_us = ends_us - starts_us
    expected = np.minimum(before, after) * lengths_us / _BESIDE_US
    sudden = (lengths_us <= _LONGEST_US) & (expected >= _EXPECTED)
    return np.asarray(np.column_stack([starts_us, ends_us])[sudden])


def _filled(spans_us: Spans, beats: NDArray[np.intp]) -> Spans:
    """Add the spans between those that are several beats apart."""
    parts = [spans_us]
    for k in np.flatnonzero(beats > 1):
        step_us = (spans_us[k + 1] - spans_us[k]) / beats[k]
        since_us = np.rint(step_us * np.arange(1, beats[k])[:, None])
        parts.append(spans_us[k] + since_us.astype(np.int64))
    joined = np.concatenate(parts)
    return joined[np.argsort(joined[:, 0])]


def _cut(times_us: NDArray[np.int64], spans_us: Spans, period_us: float) -> bool:
    """Whether next to no events lie within the spans, and most lie between them."""
    lengths_us = np.diff(spans_us)[:, 0]
    middles_us = spans_us + np.outer(lengths_us // 10, [1, -1])  # ends are not to the microsecond
    inside = np.sum(np.diff(np.searchsorted(times_us, middles_us)))
    within = np.diff(spans_us[:, 0]) <= 1.5 * period_us
    bounds = np.searchsorted(times_us, spans_us[:, 0])
    n_cut = np.sum(np.diff(bounds)[within])
    expected = n_cut * float(np.median(lengths_us)) / period_us
    return bool(inside <= _MOST_INSIDE * expected and n_cut >= _LEAST_CUT * len(times_us))


MAX_WIDTH = 0.3
"""Largest deviation of a track from a straight line, over the object's rms size."""

MAX_SLENDERNESS = 1.0 / 8.0
"""The same over its deviation along the line."""

MAX_RETURN = 0.2
"""Mean distance of a path from itself a lag later, over its extent, of one that repeats itself."""

_RETURN_STEP_S = 0.002  # of the lags tried
_MAX_RETURN_STEPS = 120_000  # of a path: of one longer than 4 minutes they are longer
_RETURN_SAMPLES = 60  # times at which each is tried
_VIEW_SAMPLES = 200  # of a track
_SIZE_SAMPLES = 16  # of the image's size, which takes a pass over the events


@dataclass(frozen=True)
class View:
    """How one camera saw the object move, over all of its recording."""

    extent_px: float  # rms distance of the track from its middle
    width_px: float  # deviation across the track's longest direction, robust
    length_px: float  # deviation along it
    size_px: float  # rms size of the object's image
    swing_hz: float  # how often it goes to and fro, on average: see `swing_hz`
    middle_px: Array  # (2,)
    direction: Array  # (2,) unit vector along the track's longest direction

    @property
    def is_straight(self) -> bool:
        """Whether nothing but noise and the object's turning leads off a straight line."""
        limit_px = min(MAX_WIDTH * self.size_px, MAX_SLENDERNESS * self.length_px)
        return self.width_px < limit_px


def view_of(motion: Motion) -> View | None:
    """Sum up a track; None when it has no two valid samples."""
    start_s, end_s = motion.span_s
    if not end_s > start_s:
        return None
    times_s = start_s + (end_s - start_s) * (np.arange(_VIEW_SAMPLES) + 0.5) / _VIEW_SAMPLES
    track = motion.at(times_s)
    if np.mean(track.valid) < MOST:
        times_s = seen_times(seen_of(motion), _VIEW_SAMPLES)
        track = motion.at(times_s)
    positions = track.positions_px[track.valid]
    if len(positions) < 2:
        return None
    middle = np.mean(positions, axis=0)
    _, deviations, axes = np.linalg.svd(positions - middle, full_matrices=False)
    across = (positions - middle) @ axes[1]
    return View(
        extent_px=float(np.linalg.norm(deviations) / np.sqrt(len(positions))),
        width_px=robust_deviation(across),
        length_px=float(deviations[0] / np.sqrt(len(positions))),
        size_px=size_px(motion, times_s[track.valid]),
        swing_hz=swing_hz(positions, motion.velocities_at(times_s[track.valid])),
        middle_px=middle,
        direction=axes[0],
    )


def size_px(motion: Motion, times_s: Array) -> float:
    """Median rms size of the object's image over some of the times; NaN of none."""
    some_s = times_s[:: max(1, len(times_s) // _SIZE_SAMPLES)]
    sizes = motion.sharp_at(some_s).sizes_px
    sizes = sizes[np.isfinite(sizes)]
    return float(np.median(sizes)) if len(sizes) else np.nan


def swing_hz(positions_px: Array, velocities_px_s: Array) -> float:
    """How often a path goes to and fro [1/s]: its rms speed over pi times its rms extent.

    Rice's formula for the mean crossings of a random motion.
    """
    squares = np.sum(velocities_px_s**2, axis=1)
    squares = squares[np.isfinite(squares)]
    speed_px_s = np.sqrt(np.mean(squares)) if len(squares) else 0.0
    extent_px = np.sqrt(np.sum(np.var(positions_px, axis=0))) + 1e-12
    return float(speed_px_s / (np.pi * extent_px))


def returns_s(motion: Motion, view: View | None, longest_s: float) -> Array:
    """Lags (k,) up to `longest_s` [s] after which a path that repeats itself is back on itself.

    What fits at one offset then fits a lag further as well, in a valley that may be too narrow for
    the search's first steps.
    """
    start_s, end_s = motion.span_s
    step_s = max(_RETURN_STEP_S, (end_s - start_s) / _MAX_RETURN_STEPS)
    n = int((end_s - start_s) / step_s) if end_s > start_s else 0
    if view is None or n < 4:
        return np.empty(0)
    track = motion.at(start_s + step_s * np.arange(n, dtype=np.float64))
    path_px = np.where(track.valid[:, None], track.positions_px, np.nan)
    lags = np.arange(1, int(min(n // 2, longest_s / step_s + 2)))
    here = np.linspace(0, n - 1 - lags[-1], _RETURN_SAMPLES).astype(np.intp)
    there_px = path_px[here[:, None] + lags]
    distances_px = np.linalg.norm(there_px - path_px[here][:, None], axis=2)
    known = np.isfinite(distances_px)
    distances_px = np.minimum(np.where(known, distances_px, 0.0), 2.0 * view.extent_px)
    counts = np.count_nonzero(known, axis=0)
    means_px = np.where(
        counts >= _RETURN_SAMPLES // 2,
        np.sum(distances_px, axis=0) / np.maximum(counts, 1),
        np.inf,
    )
    left = np.cumsum(means_px > 0.5 * view.extent_px) > 0
    padded = np.pad(means_px, 1, constant_values=np.inf)
    is_least = (means_px <= padded[:-2]) & (means_px < padded[2:])
    is_back = left & is_least & (means_px < MAX_RETURN * view.extent_px)
    return np.asarray(step_s * lags[is_back])


@dataclass(frozen=True, eq=False)
class Alone:
    """What each of two motions says on its own, found when it is asked for and once."""

    motions: tuple[Motion, Motion]
    longest_s: float  # of the lags in `returns_s`

    def is_of(self, motions: tuple[Motion, Motion], longest_s: float) -> bool:
        """Whether it is of these very motions and of lags up to this one [s]."""
        same = all(one is other for one, other in zip(self.motions, motions, strict=True))
        return same and self.longest_s == longest_s

    @cached_property
    def views(self) -> tuple[View | None, View | None]:
        """As of `TwoViews`, and so are those below."""
        return view_of(self.motions[0]), view_of(self.motions[1])

    @cached_property
    def returns_s(self) -> Array:
        """Lags (k,) [s] after which camera 1's path repeats itself."""
        return returns_s(self.motions[0], self.views[0], self.longest_s)

    @cached_property
    def repeats(self) -> bool:
        """Whether it does so after any lag."""
        return len(returns_s(self.motions[0], self.views[0], np.inf)) > 0

    @cached_property
    def seen(self) -> tuple[Seen, Seen] | None:
        """When each camera sees the object; None where both do so most of the time."""
        if any(motion.span_s[1] <= motion.span_s[0] for motion in self.motions):
            return None
        one, other = (seen_of(motion) for motion in self.motions)
        if one.share + other.share - 1.0 >= MOST:
            return None
        step_s = max(one.step_s, other.step_s)
        return seen_of(self.motions[0], step_s), seen_of(self.motions[1], step_s)

    @cached_property
    def blind(self) -> tuple[Blind, Blind]:
        """When each camera was blind, in its own clock."""
        one, other = (
            blind_spans(motion.times_us) if isinstance(motion, ObjectMotion) else Blind()
            for motion in self.motions
        )
        return one, other
