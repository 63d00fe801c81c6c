"""An estimate that its cost curve or F may leave open in, what its refinement makes of it out.

F has seven parameters and a pose only five, so that a path on which F is open, one in a plane say,
may still tell the pose; and where the cost curve of F has several valleys, refined poses may tell
which is the true one. So there are three steps: the `hypotheses`, every offset and pose that is in
question; their refinement; and the choice of the best (`ssac.methods.rivals.choose`), or of none
where another fits about as well.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ssac.camera import known_pose
from ssac.estimate import POSE_IS_OPEN, SETTLED_BY, Estimate, Status
from ssac.geometry.candidate_poses import Pose, homography_poses, possible_poses
from ssac.geometry.epipolar import sampson_distance
from ssac.geometry.fundamental import MIN_PAIRS
from ssac.geometry.pose import MIN_IN_FRONT, share_in_front
from ssac.methods.rivals import Solution, choose, distinct_offsets, rivals_of
from ssac.search.observability import Valley, valleys
from ssac.search.shutters import shutters_of
from ssac.search.two_views import TwoViews

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
