"""Which offset and pose are right, where the cost curve or F leaves several open.

F has seven parameters and a pose only five, so that a path on which F is open, one in a plane say,
may still tell the pose; and where the cost curve of F has several valleys, refined poses may tell
which is the true one. So there are three steps: the `hypotheses`, every offset and pose that is in
question; their refinement; and the choice of the best (`choose`), or of none where another fits
about as well.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ssac.camera import known_pose
from ssac.estimate import POSE_IS_OPEN, SETTLED_BY, Estimate, Refusal, Status
from ssac.geometry.epipolar import sampson_distance
from ssac.geometry.pose import Pose, homography_poses, possible_poses, share_in_front
from ssac.methods.verdict import certain, refused
from ssac.rules import Rules
from ssac.search.offset_search import (
    no_match,
    open_fundamental,
    other_offsets,
    valleys,
)
from ssac.search.two_views import TwoViews, shutters_of


@dataclass(frozen=True)
class Solution:
    """A refined hypothesis, and how well it fits."""

    estimate: Estimate
    distance_px: float  # mean distance from the epipolar lines
    object_px: float  # rms size of the object's images


def choose(start: Estimate, solutions: list[Solution], rules: Rules) -> Estimate:
    """Take the solution that fits best, or say which others fit about as well.

    The start is what they were refined from; it is given back as it is when there are none.
    """
    if not solutions:
        return start
    rivals = rivals_of(solutions, rules.hypotheses.clearly)
    best = rivals[0]
    refusal = no_match(best.distance_px, best.object_px, rules.search)
    if refusal is not None:
        return refused(best.estimate, refusal)
    offsets_s = sorted(distinct_offsets(rivals, rules.hypotheses.same_s)[1:])
    if offsets_s:
        refusal = Refusal(Status.AMBIGUOUS_OFFSET, other_offsets(offsets_s))
        estimate = refused(best.estimate, refusal)
        return replace(estimate, t_d_s=best.estimate.t_d_s, alternatives_s=np.array(offsets_s))
    apart = [_apart(found.estimate, best.estimate) for found in rivals]
    n_others = sum(angle > np.deg2rad(rules.hypotheses.same_deg) for angle in apart)
    estimate = certain(best.estimate, rules.verdict) if n_others else best.estimate
    if n_others and estimate.status == Status.OK:
        reason = (
            f"{n_others + 1} poses fit about as well, {np.degrees(max(apart)):.0f} deg apart, as"
            " for a path in a plane; the offset is the same with each"
        )
        return replace(estimate, status=Status.AMBIGUOUS_POSE, reason=reason, R=None, t=None)
    return estimate


def rivals_of(solutions: list[Solution], clearly: float) -> list[Solution]:
    """Solutions that fit about as well as the best, which comes first."""
    ordered = sorted(solutions, key=lambda found: found.distance_px)
    return [one for one in ordered if one.distance_px <= clearly * ordered[0].distance_px]


def distinct_offsets(rivals: list[Solution], same_s: float) -> list[float]:
    """Offsets of solutions, those that are one left out but for the first."""
    offsets_s: list[float] = []
    for found in rivals:
        if all(abs(found.estimate.t_d_s - other_s) > same_s for other_s in offsets_s):
            offsets_s.append(found.estimate.t_d_s)
    return offsets_s


def confirmed(estimate: Estimate, start: Estimate, views: TwoViews) -> Estimate:
    """Keep to the search's refusal where the failure of all other hypotheses says little.

    On a circle F is open at any offset, so that other poses may fit that no hypothesis led to; and
    so they may all along a valley without an end.

    The estimate is the one that is left of those refined from the start, which is of the search.
    """
    rules = views.config.rules.search
    is_searched = start.status == Status.AMBIGUOUS_OFFSET and not views.pose_is_known
    if not (is_searched and estimate.has_offset):
        return estimate
    found = valleys(start.candidates_s, start.costs, estimate.t_d_s, rules)
    at = views.under(estimate.clock).pairs_at(estimate.t_d_s)
    is_open = open_fundamental(*at.points_px, rules) is not None
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


Array = NDArray[np.float64]
Refine = Callable[[Estimate], Estimate]  # an offset and a pose in, both refined out
Weigh = Callable[[Estimate], Solution | None]  # a refined estimate in, how well it fits out


def settled(start: Estimate, views: TwoViews, refine: Refine, weigh: Weigh) -> Estimate:
    """Refine an estimate, and all that is in question beside it, and choose the best.

    The start, of a search, may have any status; it is given back when nothing can be made of it. An
    ordinary one is refined once. A refined estimate that cannot be compared weighs None. The result
    is not judged by its own covariance yet, which is for `ssac.methods.verdict.certain`.
    """
    if start.status == Status.OK:
        start = refine(start)
    tried = hypotheses(start, views)
    if not tried:
        return start
    first = _given_ones([weigh(start)] if start.status == Status.OK else [])
    solutions = refined(tried, views, refine, weigh, first)
    return choose(start, solutions, views.config.rules)


def hypotheses(start: Estimate, views: TwoViews) -> list[Estimate]:
    """Offsets and poses that are in question beside an estimate; none where none is.

    Of one that is "ok" and refined: the other poses of the plane in which the path may lie.
    """
    rules = views.config.rules.hypotheses
    if start.status == Status.OK:
        return [] if views.pose_is_known else _other_poses_of_a_plane(start, views)
    if start.status not in SETTLED_BY["joint"]:
        return []
    if start.status == Status.AMBIGUOUS_OFFSET:
        offsets_s = _offsets_of_valleys(start, views.config.rules)
    elif _is_open(start):
        offsets_s = [start.t_d_s, *(start.t_d_s + shift_s for shift_s in rules.probes_s)]
    else:
        return []
    plain = replace(start, status=Status.OK, reason="", alternatives_s=np.empty(0))
    found = []
    for t_d_s in offsets_s:
        poses = _poses_at(t_d_s, views)
        if start.status == Status.AMBIGUOUS_OFFSET or t_d_s != start.t_d_s:
            poses = poses[: rules.max_poses]
        found += [replace(plain, t_d_s=float(t_d_s), R=R, t=t) for R, t in poses]
    return found


def refined(
    tried: list[Estimate],
    views: TwoViews,
    refine: Refine,
    weigh: Weigh,
    solutions: list[Solution] | None = None,
) -> list[Solution]:
    """Refine hypotheses to solutions, beside those there are, until many offsets fit as well."""
    rules = views.config.rules.hypotheses
    found = list(solutions or [])
    for hypothesis in tried:
        estimate = refine(hypothesis)
        if estimate.status == Status.OK and _in_front(estimate, views):
            found += _given_ones([weigh(estimate)])
        rivals = rivals_of(found, rules.clearly)
        if len(distinct_offsets(rivals, rules.same_s)) >= rules.enough:
            break
    return found


def sharp_solution(estimate: Estimate, views: TwoViews) -> Solution | None:
    """Weigh an estimate by the trimmed mean Sampson distance of the sharp positions."""
    views = shutters_of(views).told(views, estimate).under(estimate.clock)
    pairs = views.pairs_at(estimate.t_d_s)
    track1, track2 = views.sharp_at(pairs.times_s, estimate.t_d_s)
    good = track1.valid & track2.valid
    rules = views.config.rules
    if estimate.F is None or np.count_nonzero(good) < rules.search.min_pairs:
        return None
    distances = np.abs(
        sampson_distance(estimate.F, track1.positions_px[good], track2.positions_px[good])
    )
    trimmed = np.sort(distances)[: max(1, int(rules.hypotheses.trimmed * len(distances)))]
    object_px = float(np.median(np.hypot(track1.sizes_px[good], track2.sizes_px[good])))
    return Solution(estimate, float(np.mean(trimmed)), object_px)


def _is_open(start: Estimate) -> bool:
    """Whether F left the pose open, so that a calibrated pose may still be found."""
    return (
        start.status in POSE_IS_OPEN
        and bool(np.isfinite(start.t_d_s))
        and not np.isfinite(start.t_d_std_s)  # a straight path's offset has one
    )


def _offsets_of_valleys(start: Estimate, rules: Rules) -> list[float]:
    """Offsets [s] in the valleys of a cost curve, the least costs first."""
    known = np.isfinite(start.costs)
    best_s = start.candidates_s[known][np.argmin(start.costs[known])]
    found = valleys(start.candidates_s, start.costs, best_s, rules.search)
    step_s = rules.hypotheses.start_step_s  # within a valley that is long
    offsets_s = [
        offset_s
        for valley in found
        for offset_s in (
            valley.least_s,
            *np.arange(valley.first_s, valley.last_s, step_s)[1:].tolist(),
        )
    ]
    order = np.argsort(np.interp(offsets_s, start.candidates_s[known], start.costs[known]))
    return [offsets_s[k] for k in order[: rules.hypotheses.max_offsets]]


def _poses_at(t_d_s: float, views: TwoViews) -> list[Pose]:
    """Poses that the pairs at an offset may have; the given one where it is known."""
    if views.pose_is_known:
        return [known_pose(views.rig)]
    return possible_poses(*views.pairs_at(t_d_s).points_px, views.rig, views.config.rules.search)


def _other_poses_of_a_plane(start: Estimate, views: TwoViews) -> list[Estimate]:
    """Give the poses of the homography between the views, where the path may lie in a plane."""
    views = views.under(start.clock)
    pairs = views.pairs_at(start.t_d_s)
    x1, x2 = pairs.rays(views.rig)
    rules, least = views.config.rules.hypotheses, views.config.rules.search.min_in_front
    some = slice(None, None, max(1, len(x1) // rules.homography_pairs))
    distance, poses = homography_poses(x1[some], x2[some])
    if distance * views.rig.cam2.K[0, 0] > rules.flat * views.size_px_at(pairs):
        return []
    return [replace(start, R=R, t=t) for R, t in poses if share_in_front(R, t, x1, x2) >= least]


def _in_front(estimate: Estimate, views: TwoViews) -> bool:
    """Whether an estimate puts the object in front of both cameras."""
    if estimate.R is None or estimate.t is None:
        return False
    rays1, rays2 = views.under(estimate.clock).pairs_at(estimate.t_d_s).rays(views.rig)
    in_front = share_in_front(estimate.R, estimate.t, rays1, rays2)
    return in_front >= views.config.rules.search.min_in_front


def _given_ones(solutions: list[Solution | None]) -> list[Solution]:
    return [found for found in solutions if found is not None]
