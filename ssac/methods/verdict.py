"""Checks whether an offset, a fit or a covariance is reliable, and the reasons where not."""

from dataclasses import replace

import numpy as np

from ssac.arrays import Array
from ssac.config import N_MIN
from ssac.estimate import ClockJump, Estimate, Refusal, Status
from ssac.events import US_PER_S, time_quantum_s
from ssac.geometry.epipolar import robust_deviation
from ssac.geometry.pose import tangent_basis
from ssac.rules import VerdictRules
from ssac.search.offset_search import FINE_STEP_S, OffsetSearch, Valley
from ssac.search.two_views import TwoViews
from ssac.track.motion import PointMotion
from ssac.track.observation import Observation


def offset_estimate(method: str, search: OffsetSearch, views: TwoViews) -> Estimate:
    """Report the offset that a search found, or why there is no reliable one."""
    low, high = views.config.offsets_s
    where = f"offset between {low:g} and {high:g} s"
    status, reason = Status.OK, ""
    if len(search.candidates_s) == 0:
        status = Status.NO_COMMON_TIME
        reason = f"the usable events have no common time at any {where}"
    elif np.isnan(search.t_d_s):
        status = Status.TOO_FEW_SAMPLES
        reason = (
            f"at no {where} are {views.rules.search.min_pairs} of {views.config.n_samples}"
            f" sample times valid in both views: {_needed(views)}; record longer, or closer to the"
            " object"
        )
    elif search.at_bound:
        status = Status.SEARCH_BOUND
        is_of_search = min(search.t_d_s - low, high - search.t_d_s) < FINE_STEP_S
        what = "the search: widen the interval"
        if not is_of_search:
            what = "those at which the recordings have enough in common: record longer"
        reason = f"the best offset, {search.t_d_s:.3f} s, bounds {what}"
    t_d_s = search.t_d_s if status == Status.OK else np.nan
    found = Estimate(method, status, reason, t_d_s)
    return replace(found, candidates_s=search.candidates_s, costs=search.d_avg_px)


def _needed(views: TwoViews) -> str:
    """Say when a sample time is valid, by what the cameras gave."""
    config = views.config
    of_points = [isinstance(motion, PointMotion) for motion in views.motions]
    of_events = (
        f"a window of {2e3 * config.half_window_s:g} ms must hold"
        f" {config.n_min or N_MIN} events or more (fewer of a thin object), and at most"
        f" {100 * config.max_border_fraction:g} % of them on the border"
    )
    of_tracks = "a track must have points just before and just after it"
    return "; ".join([of_events] * (not all(of_points)) + [of_tracks] * any(of_points))


_STAYS = ("F", "unobservable", "jump", "doubt", "start")
_OF_SEARCH = ("n_samples", "d_avg_px", "candidates_s", "costs")


def refused(estimate: Estimate, refusal: Refusal, found: list[Valley] | None = None) -> Estimate:
    """Return the estimate as refused, without the offset, pose and clock that were found.

    F and the cost curve stay, for plots of what was compared. An ambiguous offset stays too if
    other valleys were `found` beside the first, whose offsets go to `alternatives_s`.
    """
    others_s = np.array(sorted(valley.least_s for valley in (found or [])[1:]))
    keeps = refusal.status == Status.AMBIGUOUS_OFFSET and len(others_s) > 0
    t_d_s, alternatives_s = (estimate.t_d_s, others_s) if keeps else (np.nan, np.empty(0))
    stays = {name: getattr(estimate, name) for name in _STAYS + _OF_SEARCH}
    stays["alternatives_s"] = alternatives_s
    return Estimate(estimate.method, refusal.status, refusal.reason, t_d_s, **stays)


def doubt(
    distances_px: Array,
    object_px: float,
    rules: VerdictRules,
    against_intrinsics: float = 0.0,
    misfit: str = "",
    is_exact: bool = False,
) -> str:
    """Say what is unusual in the last step of a fit; empty where nothing is.

    With one object, most pairs lie within a small part of its size from their epipolar lines, and
    the few others not far beyond. A second moving thing pulls the positions away for a while: then
    those others lie far out, or all pairs do. Distances (n,) are weighted; the evidence against the
    intrinsics, and the `misfit`, are those of `ssac.fit.intrinsics`, for a rig that `is_exact` too.
    """
    mean_px, spread_px = float(np.mean(np.abs(distances_px))), robust_deviation(distances_px)
    has_tail = mean_px > rules.max_tail * spread_px
    has_tail = has_tail and mean_px > rules.small_px + rules.small_share * object_px
    if has_tail or is_spread(distances_px, object_px, rules):
        far_px, share = 3.0 * spread_px, np.mean(np.abs(distances_px) > 3.0 * spread_px)
        return (
            f"half of the pairs lie over {np.median(np.abs(distances_px)):.2f} px from their"
            f" epipolar lines, and {100 * share:.0f} % over {far_px:.2f} px, far for an object of"
            f" {object_px:.1f} px rms: something else moves in view, the cameras see different"
            " objects or times, a clock jumps, or the calibration is of other cameras; record one"
            " object by itself, record one flight with both cameras, or calibrate again"
        )
    if against_intrinsics > rules.max_against:
        whose = "a good calibration's" if is_exact else "their stated"
        which = f": {misfit}" if misfit else ""
        return (
            f"other intrinsics fit better, {against_intrinsics:.1f} of {whose} deviations from"
            f" the rig's{which}; calibrate again, or state larger ones (intrinsics_std,"
            " --focal-std, --centre-std)"
        )
    return ""


def jumped(estimate: Estimate, jump: ClockJump) -> Estimate:
    """Refuse an estimate because camera 2's clock jumps."""
    is_sure = np.isfinite(jump.size_std_s)
    sigma = f" (1 sigma {1e3 * jump.size_std_s:.1f} ms)" if is_sure else ""
    reason = (
        f"camera 2's clock jumps by {1e3 * jump.size_s:+.1f} ms{sigma} at"
        f" {jump.at_s:.2f} s of camera 1's clock: t_d is {1e3 * jump.before_s:.1f} ms before and"
        f" {1e3 * jump.after_s:.1f} ms after; cut the recordings there,"
        " or give --clock pieces if it rather wanders"
    )
    return replace(refused(estimate, Refusal(Status.CLOCK_JUMP, reason)), jump=jump)


def is_spread(distances_px: Array, object_px: float, rules: VerdictRules) -> bool:
    """Whether most pairs lie far from their epipolar lines, for an object of that size."""
    return robust_deviation(distances_px) > rules.max_spread * object_px


def certain(estimate: Estimate, rules: VerdictRules) -> Estimate:
    """Refuse a refined estimate that fits poorly, or whose offset or pose is too uncertain."""
    if estimate.status != Status.OK:
        return estimate
    if estimate.doubt:
        return replace(estimate, status=Status.POOR_FIT, reason=estimate.doubt, R=None, t=None)
    if not estimate.t_d_std_s <= rules.max_t_d_std_s:
        return _unsure(estimate, rules)
    if estimate.covariance is None or estimate.t is None:
        return estimate
    pose = estimate.covariance[1:, 1:]
    is_known = np.isfinite(pose).all()
    variances, directions = np.linalg.eigh(pose) if is_known else (np.full(5, np.inf), np.eye(5))
    is_open = ~(variances <= np.deg2rad(rules.max_pose_std_deg) ** 2)
    if not is_open.any():
        return estimate
    unobservable = np.zeros((int(is_open.sum()), 6))
    unobservable[:, 1:] = directions[:, is_open].T
    worst_deg = np.degrees(np.sqrt(np.max(variances)))
    named = "; ".join(_in_words(direction, estimate.t) for direction in unobservable)
    reason = (
        f"the motion leaves the pose open by {worst_deg:.0f} deg (1 sigma): {named}; fly in all"
        " directions, and closer to the cameras"
    )
    status = Status.DEGENERATE_POSE
    return replace(
        estimate, status=status, reason=reason, R=None, t=None, unobservable=unobservable
    )


def with_sure_offset(estimate: Estimate, rules: VerdictRules) -> Estimate:
    """Refuse an offset that is too uncertain, however it was found; NaN: of unknown deviation."""
    too_wide = estimate.has_offset and estimate.t_d_std_s > rules.max_t_d_std_s
    return _unsure(estimate, rules) if too_wide else estimate


def _unsure(estimate: Estimate, rules: VerdictRules) -> Estimate:
    reason = (
        f"the offset has a standard deviation of {1e3 * estimate.t_d_std_s:.3g} ms, more than"
        f" {1e3 * rules.max_t_d_std_s:.0f} ms: the motion hardly tells it; record longer, or a"
        " livelier flight"
    )
    without_pose = replace(estimate, unobservable=np.empty((0, 6)))
    return refused(without_pose, Refusal(Status.AMBIGUOUS_OFFSET, reason))


def _in_words(direction: Array, t: Array) -> str:
    """Name a direction (6,) of the parameters: the turn of R, and the shift of t."""
    turn, shift = direction[1:4], direction[4:] @ tangent_basis(t)
    parts = []
    for words, vector in (("R about", turn), ("t along", shift)):
        length = np.linalg.norm(vector)
        if length > 0.1:  # of 1; smaller parts are left out
            parts.append(f"{words} ({', '.join(f'{x:.2f}' for x in vector / length + 0.0)})")
    return " with ".join(parts)


def quantum_s(camera: Observation) -> float:
    """Step [s] to which a camera's times were rounded: 10 or 1 ms, or 0."""
    if camera.track is not None:
        return time_quantum_s(camera.track.times_s)
    some_us = camera.events["t"][:1000]  # one that is no whole ms rules out any step
    if len(some_us) == 0 or np.any(some_us % 1000):
        return 0.0
    return time_quantum_s(camera.events["t"] / US_PER_S)


def scaled(estimate: Estimate, factor: float) -> Estimate:
    """Multiply all deviations of an estimate by a factor."""
    of_all, of_clock = estimate.covariance, estimate.clock_covariance
    return replace(
        estimate,
        t_d_std_s=factor * estimate.t_d_std_s,
        skew_std_ppm=factor * estimate.skew_std_ppm,
        strays_std_s=factor * estimate.strays_std_s,
        readouts_std_s=factor * estimate.readouts_std_s,
        covariance=None if of_all is None else factor**2 * of_all,
        clock_covariance=None if of_clock is None else factor**2 * of_clock,
    )


def as_certain_as(other: Estimate, estimate: Estimate) -> Estimate:
    """Return an estimate with the deviations of another one, of the same pairs and kind of clock.

    Both must have a pose and its covariance. The offset does not become more certain.
    """
    t, other_t, covariance = estimate.t, other.t, other.covariance
    assert t is not None
    assert other_t is not None
    assert covariance is not None
    to_basis = np.eye(6)  # t's two angles are about axes that depend on t
    to_basis[4:, 4:] = tangent_basis(t) @ tangent_basis(other_t).T
    as_other = replace(
        estimate,
        t_d_std_s=other.t_d_std_s,
        skew_std_ppm=other.skew_std_ppm,
        strays_std_s=other.strays_std_s,
        readouts_std_s=other.readouts_std_s,
        covariance=to_basis @ covariance @ to_basis.T,
        clock_covariance=other.clock_covariance,
    )
    return widened(as_other, max(0.0, estimate.t_d_std_s**2 - other.t_d_std_s**2))


def widened(estimate: Estimate, hidden: float) -> Estimate:
    """Widen the offset's deviation by an independent error of this variance [s^2]."""
    if hidden == 0.0 or not np.isfinite(estimate.t_d_std_s):
        return estimate
    covariance = estimate.covariance
    if covariance is not None:
        covariance = covariance.copy()
        covariance[0, 0] += hidden
    of_clock = estimate.clock_covariance
    if of_clock is not None:
        of_clock = of_clock + np.diag([hidden, 0.0])
    return replace(
        estimate,
        t_d_std_s=float(np.hypot(estimate.t_d_std_s, hidden**0.5)),
        covariance=covariance,
        clock_covariance=of_clock,
        strays_std_s=np.hypot(estimate.strays_std_s, hidden**0.5),
    )
