"""One camera's object motion in; how far, how straight and how often to and fro it goes, out."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ssac.geometry.robust import robust_deviation
from ssac.search.blind import Blind, blind_spans
from ssac.search.seen import MOST, Seen, seen_of, seen_times
from ssac.track.motion import Motion, ObjectMotion

Array = NDArray[np.float64]

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
