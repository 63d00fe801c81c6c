"""Tracks, and a search's cost curve, in; what they cannot tell, and why, out.

What an estimate is judged by is in units of the object's own image and motion, so that it holds for
any resolution, speed and size. Each threshold lies in the gap between ordinary simulated flights
and those that leave something open; `docs/refusal.md` has the figures on both sides.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ssac.geometry.robust import robust_deviation
from ssac.search.offset_search import COARSEST, RIVAL, Pairs, sample_pairs
from ssac.track.motion import ObjectMotion

Array = NDArray[np.float64]

MIN_EXTENT = 0.6
"""Least rms distance of the track from its middle, over the object's rms size: else at rest."""

MIN_SWINGS = 3.5
"""Least times to and fro that a path must go to tell F's 7 parameters and t_d: see `swings`."""

MAX_WIDTH = 0.3
"""Largest deviation of a track from a straight line, over the object's rms size."""

MAX_SLENDERNESS = 1.0 / 8.0
"""The same over its deviation along the line."""

MAX_RESIDUAL = 0.4
"""Largest mean epipolar distance over the rms size: else both views show different things."""

MAX_RETURN = 0.2
"""Mean distance of a path from itself a lag later, over its extent, of one that repeats itself."""

MAX_VALLEY_S = 0.3
"""Such offsets in one piece say nothing of where in it the offset lies when they span more."""

ORDINARY_SWING_HZ = 2.0
"""Motion that goes to and fro more often is searched in shorter steps."""

_LEAST_STEP = 5  # in fine steps
_ONE_VALLEY_S = 0.05  # offsets nearer than that belong together, whatever lies between
_RETURN_STEP_S = 0.002  # of the lags tried
_RETURN_SAMPLES = 60  # times at which each is tried
_VIEW_SAMPLES = 200  # of a track
_SPEED_SAMPLES = 100  # of a path's speed
_SIZE_SAMPLES = 16  # of the image's size, which takes a pass over the events
_MAX_GAP_S = 0.5  # of a path that is known


@dataclass(frozen=True)
class Refusal:
    """Why there is no estimate, or not of all."""

    status: str
    reason: str


@dataclass(frozen=True)
class View:
    """How one camera saw the object move, over all of its recording."""

    extent_px: float  # rms distance of the track from its middle
    width_px: float  # deviation across the track's longest direction, robust
    length_px: float  # deviation along it
    size_px: float  # rms size of the object's image
    swing_hz: float  # how often it goes to and fro, on average: see `swings`
    middle_px: Array  # (2,)
    direction: Array  # (2,) unit vector along the track's longest direction

    @property
    def is_straight(self) -> bool:
        """Whether nothing but noise and the object's turning leads off a straight line."""
        limit_px = min(MAX_WIDTH * self.size_px, MAX_SLENDERNESS * self.length_px)
        return self.width_px < limit_px


@dataclass(frozen=True)
class Valley:
    """Neighbouring offsets of low cost."""

    first_s: float
    last_s: float
    least_s: float  # where the cost is least

    @property
    def length_s(self) -> float:
        """From end to end [s]."""
        return self.last_s - self.first_s


def view_of(motion: ObjectMotion) -> View | None:
    """Sum up a track; None when it has no two valid samples."""
    start_s, end_s = motion.span_s
    if not end_s > start_s:
        return None
    times_s = start_s + (end_s - start_s) * (np.arange(_VIEW_SAMPLES) + 0.5) / _VIEW_SAMPLES
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
        swing_hz=_swing_hz(positions, motion.velocities_at(times_s[track.valid])),
        middle_px=middle,
        direction=axes[0],
    )


def size_px(motion: ObjectMotion, times_s: Array) -> float:
    """Median rms size of the object's image over some of the times; NaN of none."""
    some_s = times_s[:: max(1, len(times_s) // _SIZE_SAMPLES)]
    sizes = motion.sharp_at(some_s).sizes_px
    sizes = sizes[np.isfinite(sizes)]
    return float(np.median(sizes)) if len(sizes) else np.nan


def at_rest(views: tuple[View | None, View | None]) -> Refusal | None:
    """Refuse an object that hardly leaves its own outline, in either view."""
    for number, view in enumerate(views, start=1):
        if view is not None and view.extent_px <= MIN_EXTENT * view.size_px:
            return Refusal(
                "no_motion",
                f"in camera {number} the object moves by {view.extent_px:.1f} px rms only, of its"
                f" own rms size of {view.size_px:.1f} px: it is at rest, or lost in noise",
            )
    return None


def swings(motion1: ObjectMotion, motion2: ObjectMotion, pairs: Pairs, m: int = 0) -> float:
    """How many times the object goes to and fro while both cameras see it, the fewer of two views.

    From Rice's formula for the mean crossings of a random motion: rms speed times duration, over pi
    times the rms distance from the middle. A path of n swings has about 4 n independent
    coordinates in two views, of which the epipolar constraint tests about 2 n.
    """
    valid = pairs.valid[m]
    times_s = pairs.times_s[m, valid]
    if len(times_s) < 2:
        return 0.0
    shift_s = float(pairs.t_d_s[m])
    duration_s = float(np.sum(np.minimum(np.diff(times_s), _MAX_GAP_S)))
    counts = []
    some = slice(None, None, -(-len(times_s) // _SPEED_SAMPLES))
    for motion, clock_s, positions in (
        (motion1, times_s, pairs.p1_px[m, valid]),
        (motion2, times_s + shift_s, pairs.p2_px[m, valid]),
    ):
        counts.append(duration_s * _swing_hz(positions, motion.velocities_at(clock_s[some])))
    return min(counts)


def lasting_share(
    motion1: ObjectMotion, motion2: ObjectMotion, t_d_s: float, n_samples: int
) -> float:
    """Share, up to 1, of an object's bias that stays all along: attitudes change as it turns back.

    All of it in motion too little for an unknown pose, and a tenth or so in an ordinary flight.
    """
    pairs = sample_pairs(motion1, motion2, np.array([t_d_s]), n_samples)
    return float(min(1.0, (MIN_SWINGS / max(swings(motion1, motion2, pairs), 1e-12)) ** 2))


def _swing_hz(positions_px: Array, velocities_px_s: Array) -> float:
    squares = np.sum(velocities_px_s**2, axis=1)
    squares = squares[np.isfinite(squares)]
    speed_px_s = np.sqrt(np.mean(squares)) if len(squares) else 0.0
    extent_px = np.sqrt(np.sum(np.var(positions_px, axis=0))) + 1e-12
    return float(speed_px_s / (np.pi * extent_px))


def coarsest_step(views: tuple[View | None, View | None]) -> int:
    """First step of the search, in fine steps: shorter for motion that turns back more often."""
    swing_hz = max((view.swing_hz for view in views if view is not None), default=0.0)
    return int(np.clip(COARSEST * ORDINARY_SWING_HZ / max(swing_hz, 1e-12), _LEAST_STEP, COARSEST))


def returns_s(motion: ObjectMotion, view: View | None, longest_s: float) -> Array:
    """Lags (k,) up to `longest_s` [s] after which a path that repeats itself is back on itself.

    What fits at one offset then fits a lag further as well, in a valley that may be too narrow for
    the search's first steps.
    """
    start_s, end_s = motion.span_s
    n = int((end_s - start_s) / _RETURN_STEP_S) if end_s > start_s else 0
    if view is None or n < 4:
        return np.empty(0)
    track = motion.at(start_s + _RETURN_STEP_S * np.arange(n, dtype=np.float64))
    path_px = np.where(track.valid[:, None], track.positions_px, np.nan)
    lags = np.arange(1, int(min(n // 2, longest_s / _RETURN_STEP_S + 2)))
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
    return np.asarray(_RETURN_STEP_S * lags[is_back])


def too_little_motion(n_swings: float) -> Refusal | None:
    """Refuse a path too short to tell an offset and a pose from chance."""
    if n_swings >= MIN_SWINGS:
        return None
    return Refusal(
        "too_little_motion",
        f"the object goes to and fro {n_swings:.1f} times while both cameras see it, and"
        f" {MIN_SWINGS} are needed to tell offset and pose: record longer, or a livelier flight",
    )


def no_match(distance_px: float, object_px: float) -> Refusal | None:
    """Refuse what fits the two views no better than two unrelated paths."""
    if not distance_px > MAX_RESIDUAL * object_px:
        return None
    return Refusal(
        "no_match",
        f"at the best offset the two paths still disagree by {distance_px:.1f} px, and the object's"
        f" rms size is {object_px:.1f} px: the cameras see different objects, or the offset lies"
        " outside the search",
    )


def valleys(candidates_s: Array, costs: Array, t_d_s: float) -> list[Valley]:
    """Pieces of the cost curve below RIVAL times the cost at `t_d_s`; the one with it comes first.

    Parameters
    ----------
    candidates_s, costs
        The curve, shapes (M,), ascending offsets [s]; NaN costs are left out.
    t_d_s
        The offset of least cost.
    """
    known = np.isfinite(costs)
    candidates_s, costs = candidates_s[known], costs[known]
    here = int(np.argmin(np.abs(candidates_s - t_d_s)))
    low = np.flatnonzero(costs < RIVAL * costs[here])
    if len(low) == 0:  # at a cost of zero
        return [Valley(t_d_s, t_d_s, t_d_s)]
    ends = np.flatnonzero(np.diff(candidates_s[low]) > _ONE_VALLEY_S)
    found = [
        Valley(
            float(candidates_s[piece[0]]),
            float(candidates_s[piece[-1]]),
            float(candidates_s[piece[np.argmin(costs[piece])]]),
        )
        for piece in np.split(low, ends + 1)
    ]
    return sorted(
        found, key=lambda valley: not valley.first_s <= candidates_s[here] <= valley.last_s
    )


def ambiguous_offset(found: list[Valley]) -> Refusal | None:
    """Refuse a cost curve with several valleys as deep as each other, or one without an end."""
    alternatives_s = sorted(valley.least_s for valley in found[1:])
    if alternatives_s:
        return Refusal("ambiguous_offset", other_offsets(alternatives_s))
    if found[0].length_s > MAX_VALLEY_S:
        return Refusal(
            "ambiguous_offset",
            f"all offsets from {found[0].first_s:.2f} to {found[0].last_s:.2f} s fit alike: uniform"
            " motion along a line, circle or helix does not tell the offset",
        )
    return None


def other_offsets(alternatives_s: list[float]) -> str:
    """Say which other offsets fit as well."""
    named = ", ".join(f"{offset_s:.3f}" for offset_s in alternatives_s[:5])
    more = f" and {len(alternatives_s) - 5} more" if len(alternatives_s) > 5 else ""
    return (
        f"other offsets fit about as well: {named} s{more}; the motion repeats itself, or is"
        " uniform along a circle or helix"
    )
