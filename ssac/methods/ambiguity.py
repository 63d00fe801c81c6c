"""An estimate that its cost curve or F leaves open in, what the refinement makes of it out.

F has seven parameters and a pose only five, so that a path on which F is open, one in a plane say,
may still tell the pose; and where the cost curve of F has several valleys, refined poses may tell
which is the true one. So the refinement starts from every pose and offset that is in question. When
the best of what it finds is not clearly better than another, that is said instead.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ssac.camera import Rig, known_pose
from ssac.config import Config
from ssac.estimate import POSE_IS_OPEN, Estimate
from ssac.geometry.candidate_poses import homography_poses, possible_poses
from ssac.geometry.epipolar import sampson_distance
from ssac.geometry.fundamental import MIN_PAIRS, second_best
from ssac.geometry.pose import MIN_IN_FRONT, rays_of, share_in_front, tangent_basis
from ssac.methods.algorithms import MIN_SECOND_BEST
from ssac.methods.verdict import refused
from ssac.search.observability import (
    MAX_VALLEY_S,
    Refusal,
    Valley,
    no_match,
    other_offsets,
    size_px,
    valleys,
)
from ssac.search.offset_search import sample_pairs
from ssac.track.motion import ObjectMotion

Array = NDArray[np.float64]
Refine = Callable[[Estimate], Estimate]  # an offset and a pose in, both refined out

MAX_T_D_STD_S = 0.025
"""An offset that is less certain than this is none: the search's own steps are 20 ms."""

MAX_POSE_STD = np.deg2rad(5.0)
"""Directions of the pose less certain than this [rad] are unobservable."""

CLEARLY = 2.0
"""Times as far from the epipolar lines as the best that another solution must be, to be refused."""

FLAT = 0.2
"""Median distance from a homography, over the rms size, of a path that may lie in a plane."""

_SAME_S = 0.010  # offsets nearer than this are one
_SAME_RAD = np.deg2rad(3.0)  # and poses
_START_STEP_S = 0.1  # between starts within a long valley
_MAX_STARTS = 12  # offsets
_ENOUGH = 8  # solutions as good as the best at offsets of their own: no further one is looked for
_POSES = 2  # per offset, when several offsets are in question
_PROBES_S = (-0.2, -0.06, 0.06, 0.2)  # where F is open: a circle has a pose for each offset
_TRIMMED = 0.9  # share of the distances, the least, that count
_HOMOGRAPHY_PAIRS = 80  # enough to tell whether the path lies in a plane


@dataclass(frozen=True)
class _Solution:
    estimate: Estimate
    distance_px: float  # trimmed mean Sampson distance
    object_px: float  # rms size of its images


def settled(
    start: Estimate,
    refine: Refine,
    motion1: ObjectMotion,
    motion2: ObjectMotion,
    rig: Rig,
    config: Config,
    pose_is_known: bool = False,
    judge: Callable[[Estimate], Estimate] | None = None,
    measure: Callable[[Estimate], float] | None = None,
) -> Estimate:
    """Refine an estimate, from all starts that are in question, and refuse what stays open.

    Parameters
    ----------
    start
        Of `ssac` or `ssac_known`, whatever its status.
    refine
        `refinement.refine` with all but the estimate given; called once for an ordinary `start`.
    motion1, motion2, rig, config
        As for `ssac.methods.algorithms.algorithm_2`.
    pose_is_known
        Only offsets are in question.
    judge
        What becomes of the one that is left; `certain` when None.
    measure
        How far off an estimate is [px], where that is not told by the object's positions; then it
        also settles what the search of `start` left ambiguous.
    """
    judge = judge or certain
    if start.status == "ok":
        refined = refine(start)
        if refined.status != "ok":
            return refined
        starts = [] if pose_is_known else _other_side(refined, motion1, motion2, rig, config)
        if not starts:
            return judge(refined)
        solutions = [_solution(refined, motion1, motion2, config, measure)]
    elif start.status == "ambiguous_offset" or _is_open(start):
        starts = _starts(start, motion1, motion2, rig, config, pose_is_known)
        solutions = []
    else:
        return start
    for one in starts:
        refined = refine(one)
        if refined.status == "ok" and _in_front(refined, motion1, motion2, rig, config):
            solutions.append(_solution(refined, motion1, motion2, config, measure))
        if len(_offsets(_rivals(_given_ones(solutions)))) >= _ENOUGH:
            break
    settled_on = _chosen(start, _given_ones(solutions), judge)
    is_searched = start.status == "ambiguous_offset" and measure is None
    if is_searched and settled_on.has_offset and not pose_is_known:
        return _confirmed(settled_on, start, motion1, motion2, config)
    return settled_on


def _confirmed(
    estimate: Estimate,
    start: Estimate,
    motion1: ObjectMotion,
    motion2: ObjectMotion,
    config: Config,
) -> Estimate:
    """Keep to the refusal of the search where that the other starts failed says little.

    On a circle F is open at any offset, so that other poses may fit that no start led to; and so
    they may all along a valley without an end.
    """
    pairs = sample_pairs(motion1, motion2, np.array([estimate.t_d_s]), config.n_samples)
    found = valleys(start.candidates_s, start.costs, estimate.t_d_s)
    F_is_open = second_best(*pairs.valid_positions(0)) < MIN_SECOND_BEST
    if not F_is_open and found[0].length_s <= MAX_VALLEY_S:
        return estimate
    kept = refused(estimate, Refusal(start.status, start.reason))
    return replace(kept, t_d_s=estimate.t_d_s, alternatives_s=start.alternatives_s)


def certain(estimate: Estimate) -> Estimate:
    """Refuse what the covariance of a refined estimate says is open; otherwise it stays as it is.

    Parameters
    ----------
    estimate
        With `t_d_std_s`, and with `covariance` when the pose was estimated.
    """
    if estimate.status != "ok":
        return estimate
    if not estimate.t_d_std_s <= MAX_T_D_STD_S:
        reason = (
            f"the offset has a standard deviation of {1e3 * estimate.t_d_std_s:.3g} ms, more than"
            f" {1e3 * MAX_T_D_STD_S:.0f} ms: the motion hardly tells it"
        )
        return refused(estimate, Refusal("ambiguous_offset", reason))
    if estimate.covariance is None or estimate.t is None:
        return estimate
    pose = estimate.covariance[1:, 1:]
    variances, directions = (
        np.linalg.eigh(pose) if np.isfinite(pose).all() else (np.full(5, np.inf), np.eye(5))
    )
    is_open = ~(variances <= MAX_POSE_STD**2)
    if not is_open.any():
        return estimate
    unobservable = np.zeros((int(is_open.sum()), 6))
    unobservable[:, 1:] = directions[:, is_open].T
    worst_deg = np.degrees(np.sqrt(np.max(variances)))
    named = "; ".join(_in_words(direction, estimate.t) for direction in unobservable)
    reason = f"the motion leaves the pose open by {worst_deg:.0f} deg (1 sigma): {named}"
    return replace(
        estimate,
        status="degenerate_pose",
        reason=reason,
        R=None,
        t=None,
        unobservable=unobservable,
    )


def _in_words(direction: Array, t: Array) -> str:
    """Name a direction (6,) of the parameters: the turn of R, and the shift of t."""
    turn, shift = direction[1:4], direction[4:] @ tangent_basis(t)
    parts = []
    for words, vector in (("R about", turn), ("t along", shift)):
        length = np.linalg.norm(vector)
        if length > 0.1:
            parts.append(f"{words} ({', '.join(f'{x:.2f}' for x in vector / length + 0.0)})")
    return " with ".join(parts)


def _is_open(start: Estimate) -> bool:
    """Whether F left the pose open, so that a calibrated pose may still be found."""
    return (
        start.status in POSE_IS_OPEN
        and bool(np.isfinite(start.t_d_s))
        and not np.isfinite(start.t_d_std_s)  # a straight path's offset has one
    )


def _starts(
    start: Estimate,
    motion1: ObjectMotion,
    motion2: ObjectMotion,
    rig: Rig,
    config: Config,
    pose_is_known: bool,
) -> list[Estimate]:
    """Offsets in question, each with the poses that may belong to it."""
    if start.status == "ambiguous_offset":
        known = np.isfinite(start.costs)
        best_s = start.candidates_s[known][np.argmin(start.costs[known])]
        found = valleys(start.candidates_s, start.costs, best_s)
        offsets_s = [offset_s for valley in found for offset_s in _within(valley)]
        order = np.argsort(np.interp(offsets_s, start.candidates_s[known], start.costs[known]))
        offsets_s = [offsets_s[k] for k in order[:_MAX_STARTS]]
    else:
        offsets_s = [start.t_d_s, *(start.t_d_s + shift_s for shift_s in _PROBES_S)]
    plain = replace(start, status="ok", reason="", alternatives_s=np.empty(0))
    starts = []
    for t_d_s in offsets_s:
        pairs = sample_pairs(motion1, motion2, np.array([t_d_s]), config.n_samples)
        poses = (
            [known_pose(rig)] if pose_is_known else possible_poses(*pairs.valid_positions(0), rig)
        )
        if start.status == "ambiguous_offset" or t_d_s != start.t_d_s:
            poses = poses[:_POSES]
        starts += [replace(plain, t_d_s=float(t_d_s), R=R, t=t) for R, t in poses]
    return starts


def _within(valley: Valley) -> list[float]:
    """Offsets to start from: the least one, and more where the valley is long."""
    return [valley.least_s, *np.arange(valley.first_s, valley.last_s, _START_STEP_S)[1:].tolist()]


def _other_side(
    refined: Estimate, motion1: ObjectMotion, motion2: ObjectMotion, rig: Rig, config: Config
) -> list[Estimate]:
    """Start from a plane's other poses, where the path may lie in one; elsewhere nothing."""
    pairs = sample_pairs(motion1, motion2, np.array([refined.t_d_s]), config.n_samples)
    p1_px, p2_px = pairs.valid_positions(0)
    x1, x2 = rays_of(rig.cam1.K, p1_px), rays_of(rig.cam2.K, p2_px)
    some = slice(None, None, max(1, len(x1) // _HOMOGRAPHY_PAIRS))
    distance, poses = homography_poses(x1[some], x2[some])
    times_s = pairs.times_s[0, pairs.valid[0]]
    object_px = np.hypot(size_px(motion1, times_s), size_px(motion2, times_s + refined.t_d_s))
    if distance * rig.cam2.K[0, 0] > FLAT * object_px:
        return []
    return [
        replace(refined, R=R, t=t) for R, t in poses if share_in_front(R, t, x1, x2) >= MIN_IN_FRONT
    ]


def _in_front(
    estimate: Estimate, motion1: ObjectMotion, motion2: ObjectMotion, rig: Rig, config: Config
) -> bool:
    """Whether an estimate puts the object in front of both cameras."""
    if estimate.R is None or estimate.t is None:
        return False
    pairs = sample_pairs(motion1, motion2, np.array([estimate.t_d_s]), config.n_samples)
    p1_px, p2_px = pairs.valid_positions(0)
    share = share_in_front(
        estimate.R, estimate.t, rays_of(rig.cam1.K, p1_px), rays_of(rig.cam2.K, p2_px)
    )
    return share >= MIN_IN_FRONT


def _solution(
    estimate: Estimate,
    motion1: ObjectMotion,
    motion2: ObjectMotion,
    config: Config,
    measure: Callable[[Estimate], float] | None = None,
) -> _Solution | None:
    """Measure how well an estimate fits."""
    pairs = sample_pairs(motion1, motion2, np.array([estimate.t_d_s]), config.n_samples)
    times_s = pairs.times_s[0, pairs.valid[0]]
    track1, track2 = motion1.sharp_at(times_s), motion2.sharp_at(times_s + estimate.t_d_s)
    good = track1.valid & track2.valid
    if estimate.F is None or np.count_nonzero(good) < MIN_PAIRS:
        return None
    distances = np.abs(
        sampson_distance(estimate.F, track1.positions_px[good], track2.positions_px[good])
    )
    trimmed = np.sort(distances)[: max(1, int(_TRIMMED * len(distances)))]
    object_px = float(np.median(np.hypot(track1.sizes_px[good], track2.sizes_px[good])))
    distance_px = float(np.mean(trimmed)) if measure is None else measure(estimate)
    return _Solution(estimate, distance_px, object_px)


def _given_ones(solutions: list[_Solution | None]) -> list[_Solution]:
    return [found for found in solutions if found is not None]


def _rivals(solutions: list[_Solution]) -> list[_Solution]:
    """Solutions that fit about as well as the best, which comes first."""
    ordered = sorted(solutions, key=lambda found: found.distance_px)
    return [one for one in ordered if one.distance_px <= CLEARLY * ordered[0].distance_px]


def _offsets(rivals: list[_Solution]) -> list[float]:
    """Offsets of solutions, those that are one left out but for the first."""
    offsets_s: list[float] = []
    for found in rivals:
        if all(abs(found.estimate.t_d_s - other_s) > _SAME_S for other_s in offsets_s):
            offsets_s.append(found.estimate.t_d_s)
    return offsets_s


def _chosen(
    start: Estimate, solutions: list[_Solution], judge: Callable[[Estimate], Estimate]
) -> Estimate:
    """Take the best solution, or say which others are as good."""
    if not solutions:
        return start
    rivals = _rivals(solutions)
    best = rivals[0]
    refusal = no_match(best.distance_px, best.object_px)
    if refusal is not None:
        return refused(best.estimate, refusal)
    offsets_s = sorted(_offsets(rivals)[1:])
    if offsets_s:
        estimate = refused(best.estimate, Refusal("ambiguous_offset", other_offsets(offsets_s)))
        return replace(estimate, t_d_s=best.estimate.t_d_s, alternatives_s=np.array(offsets_s))
    others = [found for found in rivals if _apart(found.estimate, best.estimate) > _SAME_RAD]
    if others:
        worst_deg = np.degrees(max(_apart(found.estimate, best.estimate) for found in others))
        reason = (
            f"{len(others) + 1} poses fit about as well, {worst_deg:.0f} deg apart, as for a path"
            " in a plane; the offset is the same with each"
        )
        estimate = certain(best.estimate)
        if not estimate.has_offset:
            return estimate
        return replace(estimate, status="ambiguous_pose", reason=reason, R=None, t=None)
    return judge(best.estimate)


def _apart(one: Estimate, other: Estimate) -> float:
    """Angle [rad] between two poses: the larger of R's and t's."""
    if one.R is None or other.R is None or one.t is None or other.t is None:
        return 0.0
    cosine_R = (np.trace(one.R.T @ other.R) - 1.0) / 2.0
    return float(np.max(np.arccos(np.clip([cosine_R, one.t @ other.t], -1.0, 1.0))))
