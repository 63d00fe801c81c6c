"""Summed-up views, and a search's cost curve, in; what they cannot tell, and why, out.

What an estimate is judged by is in units of the object's own image and motion, so that it holds for
any resolution, speed and size. Each threshold lies in the gap between ordinary simulated flights
and those that leave something open; `docs/refusal.md` has the figures on both sides.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ssac.estimate import Status
from ssac.geometry.fundamental import second_best
from ssac.search.offset_search import COARSEST, RIVAL
from ssac.search.view import View

Array = NDArray[np.float64]

MIN_EXTENT = 0.6
"""Least rms distance of the track from its middle, over the object's rms size: else at rest."""

MAX_RESIDUAL = 0.4
"""Largest mean epipolar distance over the rms size: else both views show different things."""

MIN_SECOND_BEST = 7.0
"""Pairs that another F fits less than so many times worse leave the pose open."""

ORDINARY_SWING_HZ = 2.0
"""Motion that goes to and fro more often is searched in shorter steps."""

_LEAST_STEP = 5  # in fine steps
_ONE_VALLEY_S = 0.05  # offsets nearer than that belong together, whatever lies between


@dataclass(frozen=True)
class Refusal:
    """Why there is no estimate, or not of all."""

    status: Status
    reason: str


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


def at_rest(views: tuple[View | None, View | None]) -> Refusal | None:
    """Refuse an object that hardly leaves its own outline, in either view."""
    for number, view in enumerate(views, start=1):
        if view is not None and view.extent_px <= MIN_EXTENT * view.size_px:
            return Refusal(
                Status.NO_MOTION,
                f"in camera {number} the object moves by {view.extent_px:.1f} px rms only, of its"
                f" own rms size of {view.size_px:.1f} px: it is at rest, or lost in noise",
            )
    return None


def coarsest_step(views: tuple[View | None, View | None]) -> int:
    """First step of the search, in fine steps: shorter for motion that turns back more often."""
    swing_hz = max((view.swing_hz for view in views if view is not None), default=0.0)
    return int(np.clip(COARSEST * ORDINARY_SWING_HZ / max(swing_hz, 1e-12), _LEAST_STEP, COARSEST))


def too_little_motion(n_swings: float, least: float) -> Refusal | None:
    """Refuse a path too short to tell an offset and a pose from chance."""
    if n_swings >= least:
        return None
    return Refusal(
        Status.TOO_LITTLE_MOTION,
        f"the object goes to and fro {n_swings:.1f} times while both cameras see it, and"
        f" {least} are needed to tell offset and pose: record longer, or a livelier flight",
    )


def no_match(distance_px: float, object_px: float) -> Refusal | None:
    """Refuse what fits the two views no better than two unrelated paths."""
    if not distance_px > MAX_RESIDUAL * object_px:
        return None
    return Refusal(
        Status.NO_MATCH,
        f"at the best offset the two paths still disagree by {distance_px:.1f} px, and the object's"
        f" rms size is {object_px:.1f} px: the cameras see different objects, or the offset lies"
        " outside the search",
    )


def open_fundamental(p1_px: Array, p2_px: Array) -> Refusal | None:
    """Refuse the pose of pairs (n, 2) [px] that another F fits nearly as well as the best."""
    if second_best(p1_px, p2_px) >= MIN_SECOND_BEST:
        return None
    return Refusal(
        Status.DEGENERATE_POSE,
        "the path lies near a plane, or near another surface on which many fundamental matrices"
        " fit as well: F leaves the pose open",
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


def ambiguous_offset(found: list[Valley], longest_s: float) -> Refusal | None:
    """Refuse a cost curve with several valleys as deep as each other, or one without an end."""
    alternatives_s = sorted(valley.least_s for valley in found[1:])
    if alternatives_s:
        return Refusal(Status.AMBIGUOUS_OFFSET, other_offsets(alternatives_s))
    if found[0].length_s > longest_s:
        return Refusal(
            Status.AMBIGUOUS_OFFSET,
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
