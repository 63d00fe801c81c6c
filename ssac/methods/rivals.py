"""Several refined hypotheses in; the one that fits best, or which others fit about as well, out."""

from dataclasses import dataclass, replace

import numpy as np

from ssac.estimate import Estimate, Refusal, Status
from ssac.methods.verdict import certain, refused
from ssac.rules import VerdictRules
from ssac.search.observability import (
    no_match,
    open_fundamental,
    other_offsets,
    valleys,
)
from ssac.search.two_views import TwoViews

CLEARLY = 2.0
"""A solution whose distance is at most this many times the least is as good as the best."""

SAME_S = 0.010
"""Offsets nearer to each other than this are one."""

_SAME_RAD = np.deg2rad(3.0)  # and poses nearer than this


@dataclass(frozen=True)
class Solution:
    """A refined hypothesis, and how well it fits."""

    estimate: Estimate
    distance_px: float  # mean distance from the epipolar lines
    object_px: float  # rms size of the object's images


def choose(start: Estimate, solutions: list[Solution], rules: VerdictRules) -> Estimate:
    """Take the solution that fits best, or say which others fit about as well.

    Parameters
    ----------
    start
        What the solutions were refined from; given back as it is when there are none.
    solutions
        In any order.
    rules
        How certain the best one must be.
    """
    if not solutions:
        return start
    rivals = rivals_of(solutions)
    best = rivals[0]
    refusal = no_match(best.distance_px, best.object_px)
    if refusal is not None:
        return refused(best.estimate, refusal)
    offsets_s = sorted(distinct_offsets(rivals)[1:])
    if offsets_s:
        refusal = Refusal(Status.AMBIGUOUS_OFFSET, other_offsets(offsets_s))
        estimate = refused(best.estimate, refusal)
        return replace(estimate, t_d_s=best.estimate.t_d_s, alternatives_s=np.array(offsets_s))
    apart = [_apart(found.estimate, best.estimate) for found in rivals]
    n_others = sum(angle > _SAME_RAD for angle in apart)
    estimate = certain(best.estimate, rules) if n_others else best.estimate
    if n_others and estimate.status == Status.OK:
        reason = (
            f"{n_others + 1} poses fit about as well, {np.degrees(max(apart)):.0f} deg apart, as"
            " for a path in a plane; the offset is the same with each"
        )
        return replace(estimate, status=Status.AMBIGUOUS_POSE, reason=reason, R=None, t=None)
    return estimate


def rivals_of(solutions: list[Solution]) -> list[Solution]:
    """Solutions that fit about as well as the best, which comes first."""
    ordered = sorted(solutions, key=lambda found: found.distance_px)
    return [one for one in ordered if one.distance_px <= CLEARLY * ordered[0].distance_px]


def distinct_offsets(rivals: list[Solution]) -> list[float]:
    """Offsets of solutions, those that are one left out but for the first."""
    offsets_s: list[float] = []
    for found in rivals:
        if all(abs(found.estimate.t_d_s - other_s) > SAME_S for other_s in offsets_s):
            offsets_s.append(found.estimate.t_d_s)
    return offsets_s


def confirmed(estimate: Estimate, start: Estimate, views: TwoViews) -> Estimate:
    """Keep to the search's refusal where the failure of all other hypotheses says little.

    On a circle F is open at any offset, so that other poses may fit that no hypothesis led to; and
    so they may all along a valley without an end.

    Parameters
    ----------
    estimate
        The one that is left of those refined from `start`.
    start
        Of the search.
    views
        Both views.
    """
    is_searched = start.status == Status.AMBIGUOUS_OFFSET and not views.pose_is_known
    if not (is_searched and estimate.has_offset):
        return estimate
    found = valleys(start.candidates_s, start.costs, estimate.t_d_s)
    at = views.under(estimate.clock).pairs_at(estimate.t_d_s)
    is_open = open_fundamental(*at.points_px) is not None
    if not is_open and found[0].length_s <= views.config.max_valley_s:
        return estimate
    kept = refused(estimate, Refusal(Status.AMBIGUOUS_OFFSET, start.reason))
    return replace(kept, t_d_s=estimate.t_d_s, alternatives_s=start.alternatives_s)


def _apart(one: Estimate, other: Estimate) -> float:
    """Angle [rad] between two poses: the larger of R's and t's."""
    if one.R is None or other.R is None or one.t is None or other.t is None:
        return 0.0
    cosine_R = (np.trace(one.R.T @ other.R) - 1.0) / 2.0
    return float(np.max(np.arccos(np.clip([cosine_R, one.t @ other.t], -1.0, 1.0))))
