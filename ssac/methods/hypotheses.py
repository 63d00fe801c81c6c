"""The choice of offset and pose, where the cost curve or F leaves several open.

F has seven parameters and a pose only five. So a path that leaves F open, such as one in a plane,
may still determine the pose; and where the cost curve of F has several valleys, refined poses may
tell which is the true one. There are three steps: the hypotheses, every offset and pose in
question; their refinement; and the choice of the best, or of none where another fits about as well.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ssac.camera import known_pose
from ssac.estimate import SETTLED_BY, Estimate, Refusal, Status
from ssac.geometry.epipolar import sampson_distance
from ssac.geometry.pose import homography_poses, possible_poses, share_in_front
from ssac.methods.verdict import certain, refused
from ssac.rules import Rules
from ssac.search.offset_search import (
    ambiguous_offset,
    no_match,
    open_fundamental,
    other_offsets,
    uniform,
    valleys,
)
from ssac.search.two_views import TwoViews, as_found
from ssac.search.view import size_px
from ssac.track.motion import ObjectMotion


@dataclass(frozen=True)
class Solution:
    """A refined hypothesis, and how well it fits."""

    estimate: Estimate
    distance_px: float  # mean distance from the epipolar lines
    object_px: float  # rms size of the object's images


def choose(start: Estimate, solutions: list[Solution], rules: Rules) -> Estimate:
    """Return the best solution, refused if others fit as well; without any, return the start."""
    if not solutions:
        return start
    rivals = _rivals(solutions, rules.hypotheses.clearly)
    best = rivals[0]
    refusal = no_match(best.distance_px, best.object_px, rules.search)
    if refusal is not None:
        return refused(best.estimate, refusal)
    offsets_s = sorted(_distinct_offsets(rivals, rules.hypotheses.same_s)[1:])
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
            " for a path in a plane; the offset is the same with each: fly in all directions"
        )
        return replace(estimate, status=Status.AMBIGUOUS_POSE, reason=reason, R=None, t=None)
    return estimate


def _rivals(solutions: list[Solution], clearly: float) -> list[Solution]:
    """Solutions that fit about as well as the best, which comes first."""
    ordered = sorted(solutions, key=lambda found: found.distance_px)
    return [one for one in ordered if one.distance_px <= clearly * ordered[0].distance_px]


def _distinct_offsets(rivals: list[Solution], same_s: float) -> list[float]:
    """Offsets of solutions, without those within `same_s` of an earlier one."""
    offsets_s: list[float] = []
    for found in rivals:
        if all(abs(found.estimate.t_d_s - other_s) > same_s for other_s in offsets_s):
            offsets_s.append(found.estimate.t_d_s)
    return offsets_s


def _apart(one: Estimate, other: Estimate) -> float:
    """Angle [rad] between two poses: the larger of R's and t's."""
    if one.R is None or other.R is None or one.t is None or other.t is None:
        return 0.0
    cosine_R = (np.trace(one.R.T @ other.R) - 1.0) / 2.0
    return float(np.max(np.arccos(np.clip([cosine_R, one.t @ other.t], -1.0, 1.0))))


@dataclass(frozen=True)
class Choice:
    """The choice between all hypotheses on two views, each refined by the same function."""

    views: TwoViews
    refine: Callable[[Estimate, TwoViews], Estimate]
    by_own_pairs: bool = False  # compares distances of the refined pairs, else of positions

    def settled(self, start: Estimate) -> Estimate:
        """Refine an estimate and the other hypotheses, and choose the best.

        Without a solution, a clock jump that was found is returned, or else the start, refined if
        "ok". `ssac.methods.verdict.certain` is yet to judge the result by its covariance.
        """
        if start.status == Status.OK:
            start = self.refine(start, self.views)
        tried, rules = self.hypotheses(start), self.views.rules
        if not tried:
            return start
        found = self._weighed(start) if start.status == Status.OK else []
        jumping = None
        for hypothesis in tried:
            estimate = self.refine(hypothesis, self.views)
            if estimate.status == Status.CLOCK_JUMP:
                jumping = jumping or estimate
            if estimate.status == Status.OK and is_in_front(estimate, self.views):
                found += self._weighed(estimate)
            rivals = _rivals(found, rules.hypotheses.clearly)
            if len(_distinct_offsets(rivals, rules.hypotheses.same_s)) >= rules.hypotheses.enough:
                break  # many offsets fit as well
        if not found and jumping is not None:
            return jumping
        return choose(start, found, rules)

    def confirmed(self, estimate: Estimate, start: Estimate) -> Estimate:
        """Keep the search's refusal where the failure of all other hypotheses says little.

        `start` is the search's estimate. On a circle or helix some pose fits at any offset, though
        no hypothesis may lead to it; likewise all along an endless valley. Where a search of all
        offsets allows a long valley, the bias of the events' means decides between its offsets.
        """
        views, rules = self.views, self.views.rules
        if views.pose_is_known or not estimate.has_offset:
            return estimate
        if views.alone.are_uniform:
            return refused(estimate, uniform())
        of_means = any(isinstance(one, ObjectMotion) for one in views.motions)
        is_clear = start.status == Status.OK and of_means
        if not (is_clear or start.status == Status.AMBIGUOUS_OFFSET):
            return estimate
        found = valleys(start.candidates_s, start.costs, estimate.t_d_s, rules.search)
        if is_clear:
            refusal = ambiguous_offset(found[:1], rules.hypotheses.longest_of_means_s)
            return estimate if refusal is None else refused(estimate, refusal)
        at = views.under(estimate.clock).pairs_at(estimate.t_d_s)
        is_open = open_fundamental(*at.points_px, rules.search) is not None
        if not is_open and found[0].length_s <= views.config.max_valley_s:
            return estimate
        kept = refused(estimate, Refusal(Status.AMBIGUOUS_OFFSET, start.reason))
        return replace(kept, t_d_s=estimate.t_d_s, alternatives_s=start.alternatives_s)

    def hypotheses(self, start: Estimate) -> list[Estimate]:
        """Offsets and poses in question beside an estimate; there may be none.

        Beside a refined "ok" estimate: the homography's poses, where the path may lie in a plane.
        """
        views, rules = self.views, self.views.rules.hypotheses
        if start.status == Status.OK:
            return [] if views.pose_is_known else self._other_poses_of_a_plane(start)
        if start.status not in SETTLED_BY["joint"]:
            return []
        if not views.pose_is_known and views.alone.are_straight:
            return []  # all positions lie on one epipolar line of each view: any pose fits
        if start.status == Status.AMBIGUOUS_OFFSET:
            offsets_s = _offsets_of_valleys(start, views.rules)
            least = min(views.config.min_swings, views.rules.search.min_swings_of_line)
            if not views.pose_is_known and views.swings(views.pairs_at(offsets_s[0])) < least:
                return []  # a solution would be chance; the start is refused already
        # F left the pose open, but known intrinsics may still determine it. A straight path, whose
        # offset has a deviation, has no hypotheses.
        elif np.isfinite(start.t_d_s) and not np.isfinite(start.t_d_std_s):
            offsets_s = [start.t_d_s, *(start.t_d_s + shift_s for shift_s in rules.probes_s)]
        else:
            return []
        plain = replace(start, status=Status.OK, reason="", alternatives_s=np.empty(0))
        found = []
        for t_d_s in offsets_s:
            if views.pose_is_known:
                poses = [known_pose(views.rig)]
            else:
                points_px = views.pairs_at(t_d_s).points_px
                poses = possible_poses(*points_px, views.rig, views.rules.search)
            if start.status == Status.AMBIGUOUS_OFFSET or t_d_s != start.t_d_s:
                poses = poses[: rules.max_poses]
            found += [replace(plain, t_d_s=float(t_d_s), R=R, t=t) for R, t in poses]
        return found

    def _weighed(self, estimate: Estimate) -> list[Solution]:
        """Rate an estimate by sharp positions' trimmed mean distance; empty if they are too few."""
        views, rules = as_found(self.views, estimate), self.views.rules
        pairs = views.pairs_at(estimate.t_d_s)
        one, two = views.sharp_at(pairs.times_s, estimate.t_d_s)
        if estimate.F is None or len(one.times_s) < rules.search.min_pairs:
            return []
        distances = np.abs(sampson_distance(estimate.F, one.positions_px, two.positions_px))
        trimmed = np.sort(distances)[: max(1, int(rules.hypotheses.trimmed * len(distances)))]
        object_px = float(np.median(np.hypot(one.sizes_px, two.sizes_px)))
        distance_px = estimate.d_avg_px if self.by_own_pairs else float(np.mean(trimmed))
        return [Solution(estimate, distance_px, object_px)]

    def _other_poses_of_a_plane(self, start: Estimate) -> list[Estimate]:
        """Return the poses of the homography between views, if the path may lie in a plane."""
        views, rules = self.views.under(start.clock), self.views.rules
        pairs = views.pairs_at(start.t_d_s)
        x1, x2 = pairs.rays(views.rig)
        some = slice(None, None, max(1, len(x1) // rules.hypotheses.homography_pairs))
        distance, poses = homography_poses(x1[some], x2[some])
        on_clock_2 = views.on_clock_2(pairs.times_s, pairs.t_d_s)
        sizes_px = size_px(views.motion1, pairs.times_s), size_px(views.motion2, on_clock_2)
        flat_px = rules.hypotheses.flat * np.hypot(*sizes_px)
        if distance * views.rig.cam2.K[0, 0] > flat_px:
            return []
        least = rules.search.min_in_front
        return [replace(start, R=R, t=t) for R, t in poses if share_in_front(R, t, x1, x2) >= least]


def is_in_front(estimate: Estimate, views: TwoViews) -> bool:
    """Whether an estimate puts the object in front of both cameras."""
    if estimate.R is None or estimate.t is None:
        return False
    views = views.under(estimate.clock)
    rays = views.pairs_at(estimate.t_d_s).rays(views.rig)
    return share_in_front(estimate.R, estimate.t, *rays) >= views.rules.search.min_in_front


def _offsets_of_valleys(start: Estimate, rules: Rules) -> list[float]:
    """Offsets [s] in the valleys of a cost curve, the least costs first."""
    known = np.isfinite(start.costs)
    best_s = start.candidates_s[known][np.argmin(start.costs[known])]
    step_s, offsets_s = rules.hypotheses.start_step_s, list[float]()
    for valley in valleys(start.candidates_s, start.costs, best_s, rules.search):
        within = np.arange(valley.first_s, valley.last_s, step_s)[1:]  # more in a long valley
        offsets_s += [valley.least_s, *within.tolist()]
    order = np.argsort(np.interp(offsets_s, start.candidates_s[known], start.costs[known]))
    return [offsets_s[k] for k in order[: rules.hypotheses.max_offsets]]
