"""An estimate that its cost curve or F may leave open in, what its refinement makes of it out.

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
from ssac.geometry.fundamental import MIN_PAIRS
from ssac.geometry.pose import MIN_IN_FRONT, Pose, homography_poses, possible_poses, share_in_front
from ssac.methods.verdict import certain, refused
from ssac.rules import VerdictRules
from ssac.search.observability import (
    Valley,
    no_match,
    open_fundamental,
    other_offsets,
    valleys,
)
from ssac.search.two_views import TwoViews, shutters_of

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


Array = NDArray[np.float64]
Refine = Callable[[Estimate], Estimate]  # an offset and a pose in, both refined out
Weigh = Callable[[Estimate], Solution | None]  # a refined estimate in, how well it fits out

FLAT = 0.2
"""A path may lie in a plane when its median distance from a homography, over the object's rms size,
is at most this."""

_START_STEP_S = 0.1  # between starts within a long valley
_MAX_OFFSETS = 12  # in question
_ENOUGH = 8  # solutions as good as the best at offsets of their own: no further one is looked for
_POSES = 2  # per offset, when several offsets are in question
_PROBES_S = (-0.2, -0.06, 0.06, 0.2)  # where F is open: a circle has a pose for each offset
_TRIMMED = 0.9  # share of the distances, the least, that count
_HOMOGRAPHY_PAIRS = 80  # enough to tell whether the path lies in a plane


def settled(start: Estimate, views: TwoViews, refine: Refine, weigh: Weigh) -> Estimate:
    """Refine an estimate, and all that is in question beside it, and choose the best.

    Parameters
    ----------
    start
        Of `ssac` or `ssac_known`, whatever its status.
    views
        Both views.
    refine
        Called once for an ordinary start.
    weigh
        How well a refined estimate fits; None for one that cannot be compared.

    Returns
    -------
    Estimate
        Not judged by its own covariance yet, which is for `ssac.methods.verdict.certain`. The start
        itself when nothing can be made of it.
    """
    if start.status == Status.OK:
        start = refine(start)
    tried = hypotheses(start, views)
    if not tried:
        return start
    first = _given_ones([weigh(start)] if start.status == Status.OK else [])
    solutions = refined(tried, views, refine, weigh, first)
    return choose(start, solutions, views.config.rules.verdict)


def hypotheses(start: Estimate, views: TwoViews) -> list[Estimate]:
    """Offsets and poses that are in question beside an estimate; none where none is.

    Of one that is "ok" and refined: the other poses of the plane in which the path may lie.
    """
    if start.status == Status.OK:
        return [] if views.pose_is_known else _other_poses_of_a_plane(start, views)
    if start.status not in SETTLED_BY["joint"]:
        return []
    if start.status == Status.AMBIGUOUS_OFFSET:
        offsets_s = _offsets_of_valleys(start)
    elif _is_open(start):
        offsets_s = [start.t_d_s, *(start.t_d_s + shift_s for shift_s in _PROBES_S)]
    else:
        return []
    plain = replace(start, status=Status.OK, reason="", alternatives_s=np.empty(0))
    found = []
    for t_d_s in offsets_s:
        poses = _poses_at(t_d_s, views)
        if start.status == Status.AMBIGUOUS_OFFSET or t_d_s != start.t_d_s:
            poses = poses[:_POSES]
        found += [replace(plain, t_d_s=float(t_d_s), R=R, t=t) for R, t in poses]
    return found


def refined(
    tried: list[Estimate],
    views: TwoViews,
    refine: Refine,
    weigh: Weigh,
    solutions: list[Solution] | None = None,
) -> list[Solution]:
    """Refine hypotheses to solutions, until many offsets fit as well as the best.

    Parameters
    ----------
    tried, views, refine, weigh
        As in `settled`.
    solutions
        Found before.
    """
    found = list(solutions or [])
    for hypothesis in tried:
        estimate = refine(hypothesis)
        if estimate.status == Status.OK and _in_front(estimate, views):
            found += _given_ones([weigh(estimate)])
        if len(distinct_offsets(rivals_of(found))) >= _ENOUGH:
            break
    return found


def sharp_solution(estimate: Estimate, views: TwoViews) -> Solution | None:
    """Weigh an estimate by the trimmed mean Sampson distance of the sharp positions."""
    views = shutters_of(views).told(views, estimate).under(estimate.clock)
    pairs = views.pairs_at(estimate.t_d_s)
    track1, track2 = views.sharp_at(pairs.times_s, estimate.t_d_s)
    good = track1.valid & track2.valid
    if estimate.F is None or np.count_nonzero(good) < MIN_PAIRS:
        return None
    distances = np.abs(
        sampson_distance(estimate.F, track1.positions_px[good], track2.positions_px[good])
    )
    trimmed = np.sort(distances)[: max(1, int(_TRIMMED * len(distances)))]
    object_px = float(np.median(np.hypot(track1.sizes_px[good], track2.sizes_px[good])))
    return Solution(estimate, float(np.mean(trimmed)), object_px)


def _is_open(start: Estimate) -> bool:
    """Whether F left the pose open, so that a calibrated pose may still be found."""
    return (
        start.status in POSE_IS_OPEN
        and bool(np.isfinite(start.t_d_s))
        and not np.isfinite(start.t_d_std_s)  # a straight path's offset has one
    )


def _offsets_of_valleys(start: Estimate) -> list[float]:
    """Offsets [s] in the valleys of a cost curve, the least costs first."""
    known = np.isfinite(start.costs)
    best_s = start.candidates_s[known][np.argmin(start.costs[known])]
    found = valleys(start.candidates_s, start.costs, best_s)
    offsets_s = [offset_s for valley in found for offset_s in _within(valley)]
    order = np.argsort(np.interp(offsets_s, start.candidates_s[known], start.costs[known]))
    return [offsets_s[k] for k in order[:_MAX_OFFSETS]]


def _within(valley: Valley) -> list[float]:
    """Offsets to start from: the least one, and more where the valley is long."""
    return [valley.least_s, *np.arange(valley.first_s, valley.last_s, _START_STEP_S)[1:].tolist()]


def _poses_at(t_d_s: float, views: TwoViews) -> list[Pose]:
    """Poses that the pairs at an offset may have; the given one where it is known."""
    if views.pose_is_known:
        return [known_pose(views.rig)]
    return possible_poses(*views.pairs_at(t_d_s).points_px, views.rig)


def _other_poses_of_a_plane(start: Estimate, views: TwoViews) -> list[Estimate]:
    """Give the poses of the homography between the views, where the path may lie in a plane."""
    views = views.under(start.clock)
    pairs = views.pairs_at(start.t_d_s)
    x1, x2 = pairs.rays(views.rig)
    some = slice(None, None, max(1, len(x1) // _HOMOGRAPHY_PAIRS))
    distance, poses = homography_poses(x1[some], x2[some])
    if distance * views.rig.cam2.K[0, 0] > FLAT * views.size_px_at(pairs):
        return []
    return [
        replace(start, R=R, t=t) for R, t in poses if share_in_front(R, t, x1, x2) >= MIN_IN_FRONT
    ]


def _in_front(estimate: Estimate, views: TwoViews) -> bool:
    """Whether an estimate puts the object in front of both cameras."""
    if estimate.R is None or estimate.t is None:
        return False
    rays1, rays2 = views.under(estimate.clock).pairs_at(estimate.t_d_s).rays(views.rig)
    return share_in_front(estimate.R, estimate.t, rays1, rays2) >= MIN_IN_FRONT


def _given_ones(solutions: list[Solution | None]) -> list[Solution]:
    return [found for found in solutions if found is not None]
