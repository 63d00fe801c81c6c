"""The joint refinement's result in, offset and pose from the outline's epipolar tangents out.

Beyond the paper. Whatever is taken for the object's position, a mean of its events or a sharper
one, is the image of no fixed point of it: it strays with attitude and viewpoint, and this bias, not
noise, limits what such positions give, the more the larger the object. Its tangent epipolar planes
are the same in both views for any shape (`outline`), so the points where they touch are pairs
without that bias. They take the place of the positions in the same least squares, and are
found anew after each, as they depend on the pose a little.

Errors of the outline are one-sided and long-tailed: a thin or pale tip is missed in one view and
seen in the other. So the loss turns early, and a pair counts by how sharp its outlines are.
"""

from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from ssac.errors import SsacError
from ssac.estimate import POSE_IS_OPEN, SETTLED_BY, Estimate, Status
from ssac.fit.intrinsics import Allowance
from ssac.fit.least_squares import (
    Parameters,
    Problem,
    WeighedPairs,
    covariance_of,
    hidden_covariance,
    linearise,
    solve,
    still_moves,
)
from ssac.geometry.fundamental import MIN_PAIRS
from ssac.geometry.pose import pencils
from ssac.methods.clocks import checked_clock, clock_model
from ssac.methods.hypotheses import Solution, settled, sharp_solution
from ssac.methods.joint import (
    LAST_STRAY_S,
    astray,
    has_left,
    refine,
    refined_estimate,
    unsettled,
)
from ssac.methods.method import method
from ssac.methods.verdict import certain
from ssac.search.two_views import TwoViews
from ssac.track.motion import ObjectMotion
from ssac.track.outline import OutlineConfig, OutlineEvents, Tangents, near_outline, tangents

Array = NDArray[np.float64]


@dataclass(frozen=True)
class TangencyConfig:
    """How tangents are used; `docs/tangency.md` has what other values give."""

    outline: OutlineConfig = field(default_factory=OutlineConfig)
    step_s: float = 0.020  # between samples, each with two tangents, whatever `n_samples` is
    cauchy: float = 0.5  # where the loss turns, in robust standard deviations
    wider_cauchy: float = 1.2  # the same, as long as a round still moves the estimate far
    sharp_px: float = 0.05  # error of a tangent that is not blurred at all
    apart: bool = True  # each tangent is a pair; else the point midway between the two is


def for_blind(config: TangencyConfig, views: TwoViews) -> TangencyConfig:
    """Look for the outline in a way that bears a camera that is blind now and then, if one is.

    The mean of a window's events then has another time than the window's middle, and the course
    about which tangents are found would go to and fro. A rough window would be blind on one side.
    """
    if not any(len(blind.spans_us) for blind in views.blind):
        return config
    longest_s = max(config.outline.rough_half_window_s, config.outline.half_window_s)
    outline = replace(config.outline, centred=True, rough_half_window_s=longest_s)
    return replace(config, outline=outline)


def tangent_times(views: TwoViews, t_d_s: float, config: TangencyConfig) -> Array:
    """Even times [s] of camera 1's clock that both recordings cover."""
    (start,), (end,) = views.overlap_s(np.array([t_d_s]))
    n = max(int((end - start) / config.step_s), 2)
    return np.asarray(start + config.step_s * np.arange(n))


def tangents_under(
    parameters: Parameters,
    views: TwoViews,
    times_s: Array,
    config: TangencyConfig,
    near: list[list[OutlineEvents]] | None = None,
) -> tuple[WeighedPairs, list[list[OutlineEvents]]]:
    """Find and pair the tangents of both views under an offset and a pose.

    Parameters
    ----------
    parameters
        The offset and the pose.
    views, config
        As for `refine_tangents`.
    times_s
        Shape (n,) [s], even, in camera 1's clock.
    near
        The events near each view's outline, from an earlier call with parameters like these; found
        anew when None.

    Returns
    -------
    tuple
        The pairs, and the events near the outlines.
    """
    rig = views.rig
    sides = list(
        zip(
            _of_events(views),
            pencils(parameters.R, parameters.t, rig.cam1.K, rig.cam2.K),
            (times_s, views.on_clock_2(times_s, parameters.t_d_s)),
            strict=True,
        )
    )
    if near is None:
        near = [near_outline(*side, config.outline) for side in sides]
    found = [
        tangents(motion, events, pencil, clock_s, config.outline)
        for (motion, pencil, clock_s), events in zip(sides, near, strict=True)
    ]
    return tangent_pairs(times_s, found[0], found[1], parameters.t_d_s, config), near


def _of_events(views: TwoViews) -> tuple[ObjectMotion, ObjectMotion]:
    """Give both motions, without a line that holds the object; SsacError for a track of points.

    A track has no outline. That of the object is not the line's, whose end has no place.
    """
    one, other = views.motion1, views.motion2
    if not (isinstance(one, ObjectMotion) and isinstance(other, ObjectMotion)):
        raise SsacError(
            "tangents are found among events, and a camera gave a track of points: use joint"
        )
    return one.bare or one, other.bare or other


def tangent_pairs(
    times_s: Array,
    view1: list[Tangents],
    view2: list[Tangents],
    t_d_s: float,
    config: TangencyConfig,
) -> WeighedPairs:
    """Pair the tangents of each side, sampled `t_d_s` apart at n instants, where both are valid.

    Their weights are the inverse of the error that the blur of both outlines lets one expect.
    """
    if not config.apart:
        view1, view2 = [_midway(*view1)], [_midway(*view2)]
    sides = list(zip(view1, view2, strict=True))
    both = [one.valid & two.valid for one, two in sides]
    errors_px = np.concatenate(
        [
            np.sqrt(config.sharp_px**2 + one.spreads_px[k] ** 2 + two.spreads_px[k] ** 2)
            for (one, two), k in zip(sides, both, strict=True)
        ]
    )
    return WeighedPairs(
        np.concatenate([times_s[k] for k in both]),
        np.concatenate([one.points_px[k] for (one, _), k in zip(sides, both, strict=True)]),
        np.concatenate([two.points_px[k] for (_, two), k in zip(sides, both, strict=True)]),
        np.concatenate([two.velocities_px_s[k] for (_, two), k in zip(sides, both, strict=True)]),
        np.median(errors_px) / errors_px if len(errors_px) else errors_px,
        t_d_s,
    )


def _midway(upper: Tangents, lower: Tangents) -> Tangents:
    return Tangents(
        0.5 * (upper.points_px + lower.points_px),
        0.5 * (upper.velocities_px_s + lower.velocities_px_s),
        np.hypot(upper.spreads_px, lower.spreads_px),
        upper.valid & lower.valid,
    )


HIDDEN_PX = 0.2
"""Deviation of what the outlines are off by all along, where the pose is given and the motion slow
or short: no residual shows it."""

LEAST_PX = 3.5
"""Rms size of the object's images, both together, from which they have an outline: below, tangents
rest on single pixels, and err more than the mean of the events."""

_MAX_SIGMAS = 3.0  # from the start's offset to the tangents', in deviations of the start's
_ROUNDS = 8  # of finding the tangents and refining; four are the rule
_STEPS = 3  # of Gauss-Newton in a round: the tangents move more than a fourth would
_LAST_SHIFT_S = 1e-5  # between rounds
_LAST_TURN = 1e-4  # [rad] of the pose, between rounds
_FAR = 300.0  # times those last changes: then the outline is looked for among all events again
_N_OF_SHARE = 400  # samples that tell how much the object moves


def is_tiny(views: TwoViews) -> bool:
    """Whether the object is too small for an outline, so that the start is the answer."""
    return views.object_px < LEAST_PX


@method(
    "tangency",
    "joint, then refined by the outline's tangents",
    place=5,
    known_variant="tangency-known",
    starts_from="joint",
    keeps_start="is_tiny",
    counts="pairs of tangents to the object's outline",
    needs_events=True,
    follows_clock=True,
    of_one_object=True,
)
@method(
    "tangency-known",
    "joint-known, then the offset refined by tangents",
    place=6,
    needs_extrinsics=True,
    starts_from="joint-known",
    keeps_start="is_tiny",
    counts="pairs of tangents to the object's outline",
    needs_events=True,
    follows_clock=True,
    of_one_object=True,
)
def tangency_from(start: Estimate, views: TwoViews) -> Estimate:
    """Time offset and relative pose from epipolar tangents, or the offset alone of a known pose.

    The mean of a large or odd object's events may be too uncertain for a pose, and still be a start
    for the tangents: where `joint` refuses, they are tried from the search that it started from.
    The mean of a tiny object's events is better than its outline: there the start is the answer.

    Parameters
    ----------
    start
        What `joint_from` found.
    views
        The same views.

    Returns
    -------
    Estimate
        With `t_d_std_s` and `covariance`. `n_samples` and `d_avg_px` are of the pairs of tangents.
        The status may be that of the start, or "no_convergence", "clock_jump", "poor_fit".
    """
    name = "tangency-known" if views.pose_is_known else "tangency"
    search, rules = start.start, views.config.rules.verdict
    start = replace(start, method=name, start=start)
    if is_tiny(views):
        return start
    if views.pose_is_known or start.status not in SETTLED_BY["tangency"] or search is None:
        return certain(refine_tangents(start, views), rules)
    search = replace(search, method=name, start=start)
    if search.status in (Status.OK, *POSE_IS_OPEN):
        return _despite_the_mean(start, search, views)
    if views.repeats or len(search.alternatives_s) == 0:  # the motion leaves the offset open
        return start
    fit, weigh = partial(_refine_both, views=views), partial(_tangent_solution, views=views)
    told = certain(settled(search, views, fit, weigh), rules)
    return told if told.status == Status.OK else start


def _despite_the_mean(start: Estimate, search: Estimate, views: TwoViews) -> Estimate:
    """Try the tangents from a search whose refinement was refused for its covariance."""
    fit, weigh = partial(refine, views=views), partial(sharp_solution, views=views)
    refined = refine_tangents(settled(search, views, fit, weigh), views)
    outline = certain(refined, views.config.rules.verdict)
    strays_s = abs(outline.t_d_s - start.t_d_s)
    if outline.status != Status.OK or strays_s > _MAX_SIGMAS * start.t_d_std_s:
        return start
    return outline


def _refine_both(estimate: Estimate, views: TwoViews) -> Estimate:
    """Refine an estimate by positions, then by tangents."""
    return refine_tangents(refine(estimate, views), views)


def _tangent_solution(estimate: Estimate, views: TwoViews) -> Solution | None:
    """Weigh an estimate by the distances of its tangents."""
    found = sharp_solution(estimate, views)
    return None if found is None else replace(found, distance_px=estimate.d_avg_px)


def refine_tangents(
    start: Estimate, views: TwoViews, config: TangencyConfig | None = None
) -> Estimate:
    """Find tangents and refine offset and pose by turns, from an estimate.

    Parameters
    ----------
    start
        Offset and pose; returned as it is when its status is not "ok".
    views
        Both views. With a known pose only t_d is refined, and there is a `t_d_std_s` but no
        `covariance`.
    config
        Parameters; the defaults when None.
    """
    config = for_blind(config or TangencyConfig(), views)
    if start.status != Status.OK or start.R is None or start.t is None:
        return start
    model = clock_model(views, start)
    parameters = Parameters(start.t_d_s, start.R, start.t, model.start(start))
    near: list[list[OutlineEvents]] | None = None
    is_far, settles = True, False  # as the start may be
    allowance = Allowance(views.rig, model.has_priors)
    times_s = tangent_times(views, start.t_d_s, config)
    for _ in range(_ROUNDS):
        before = parameters
        seen = views.under(model.clock(before))
        pairs, near = tangents_under(before, seen, times_s, config, None if is_far else near)
        if len(pairs.times_s) < MIN_PAIRS:
            reason = (
                f"only {len(pairs.times_s)} tangents are seen in both views, and {MIN_PAIRS} are"
                " needed: the object is too small for an outline, take `joint`"
            )
            return replace(start, status=Status.TOO_FEW_SAMPLES, reason=reason)
        turn = config.wider_cauchy if is_far else config.cauchy
        problem = Problem(pairs, views.rig, views.pose_is_known, turn=turn)
        problem = allowance.added(model.problem(pairs, before, problem, seen))
        found = solve(problem, before, _STEPS, last_step=0.0)
        parameters = found.parameters
        if has_left(start, parameters):
            return astray(start, parameters)
        stray_s = model.moved_s(before, parameters)
        settles = not is_far and allowance.is_made and _are_near(before, parameters)
        settles = settles and stray_s <= LAST_STRAY_S
        if settles:
            break
        is_far = not _are_near(before, parameters, _FAR) or stray_s > _FAR * LAST_STRAY_S
        if not is_far:
            allowance.learn(replace(problem, turn=config.cauchy), parameters)

    problem = replace(problem, turn=config.cauchy)
    residuals = linearise(problem, parameters)
    covariance = covariance_of(problem, residuals, _errors_cancel(views))
    hidden_px: Array | None = None
    if views.pose_is_known:  # a free pose takes it away
        share = seen.lasting_share(parameters.t_d_s, _N_OF_SHARE)
        hidden_px = share * _hidden_errors(pairs)
        covariance = covariance + hidden_covariance(problem, residuals, hidden_px)
    if not settles and still_moves(found.change, problem, covariance):
        return unsettled(start, _ROUNDS)
    found_by = model.told(start, parameters, problem, covariance)
    told = refined_estimate(
        found_by,
        problem,
        parameters,
        residuals,
        covariance,
        views.object_px,
        views.config.rules.verdict,
        hidden_px,
    )
    return checked_clock(told, model, problem, parameters)


def _errors_cancel(views: TwoViews) -> bool:
    """Whether what both sides' errors have in common leaves t_d alone: not of what a line holds.

    Such errors push both tangents outward, in a free flight with no net effect on the offset. What
    hangs swings before cameras that see the same side of it all along: there an outline that is off
    by a constant is taken for another pose, and for another offset with it. The fit leaves nothing
    of that to be seen, so that no deviation may be the smaller for it (`docs/uncertainty.md`).
    """
    return all(getattr(motion, "bare", None) is None for motion in (views.motion1, views.motion2))


def _hidden_errors(pairs: WeighedPairs) -> Array:
    """Give the changes (n, 2) of the residuals by such an error of the upper and lower tangents."""
    starts = np.concatenate([[0], np.flatnonzero(np.diff(pairs.times_s) < 0.0) + 1])
    side = np.searchsorted(starts, np.arange(len(pairs.times_s)), side="right") - 1
    of_side = (side[:, None] == np.arange(len(starts))).astype(np.float64)
    return np.asarray(HIDDEN_PX * pairs.weights[:, None] * of_side)


def _are_near(one: Parameters, other: Parameters, factor: float = 1.0) -> bool:
    """Whether the changes from one to the other are at most `factor` times the last ones."""
    turn = np.linalg.norm(other.R - one.R) + np.linalg.norm(other.t - one.t)
    shift_s = abs(other.t_d_s - one.t_d_s)
    return bool(shift_s <= factor * _LAST_SHIFT_S and turn <= factor * _LAST_TURN)
