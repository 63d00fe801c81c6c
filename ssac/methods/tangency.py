"""Offset and pose refined by the outline's epipolar tangents, from the joint refinement's result.

Beyond the paper. Whatever is taken for the object's position, a mean of its events or a sharper
one, is the image of no fixed point of it: it strays with attitude and viewpoint, and this bias, not
noise, limits what such positions give, the more the larger the object. Its two tangent epipolar
planes are the same in both views for any shape (`ssac.track.outline`), so the points where they
touch, those of one side in both views, are pairs without that bias. They take the place of the
positions in the same least squares, and are found anew after each, as they depend on the pose.

Errors of the outline are one-sided and long-tailed: a thin or pale tip is missed in one view and
seen in the other. So the loss turns early, and a pair counts by how sharp its outlines are.
"""

from dataclasses import replace
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
from ssac.geometry.pose import pencils
from ssac.methods.clocks import checked_clock, clock_model
from ssac.methods.hypotheses import Solution, settled, sharp_solution
from ssac.methods.joint import astray, refine, refined_estimate, unsettled
from ssac.methods.method import method
from ssac.methods.verdict import certain
from ssac.rules import Rules, TangencyRules
from ssac.search.two_views import TwoViews
from ssac.track.motion import ObjectMotion
from ssac.track.outline import OutlineEvents, Tangents, near_outline, tangents

Array = NDArray[np.float64]
TangencyConfig = TangencyRules  # as studies of its variants call it


def for_blind(config: TangencyRules, views: TwoViews) -> TangencyRules:
    """Look for the outline in a way that bears a camera that is blind now and then, if one is.

    The mean of a window's events then has another time than the window's middle, and the course
    about which tangents are found would go to and fro. A rough window would be blind on one side.
    """
    if not any(len(blind.spans_us) for blind in views.blind):
        return config
    longest_s = max(config.outline.rough_half_window_s, config.outline.half_window_s)
    outline = replace(config.outline, centred=True, rough_half_window_s=longest_s)
    return replace(config, outline=outline)


def tangent_times(views: TwoViews, t_d_s: float, config: TangencyRules) -> Array:
    """Even times [s] of camera 1's clock that both recordings cover."""
    (start,), (end,) = views.overlap_s(np.array([t_d_s]))
    n = max(int((end - start) / config.step_s), 2)
    return np.asarray(start + config.step_s * np.arange(n))


def tangents_under(
    parameters: Parameters,
    views: TwoViews,
    times_s: Array,
    config: TangencyRules,
    near: list[list[OutlineEvents]] | None = None,
) -> tuple[WeighedPairs, list[list[OutlineEvents]]]:
    """Find and pair the tangents of both views under an offset and a pose.

    Times (n,) [s] are even, of camera 1's clock. The events near each view's outline may be those
    of an earlier call with parameters like these; they are found anew when None, and given back.
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
    config: TangencyRules,
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


def is_tiny(views: TwoViews) -> bool:
    """Whether the object is too small for an outline, so that the start is the answer."""
    return views.object_px < views.config.rules.tangency.least_size_px


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

    The start is what `joint_from` found of the same views. The result has `t_d_std_s` and
    `covariance`; its `n_samples` and `d_avg_px` are of the pairs of tangents. Its status may be
    that of the start, or "no_convergence", "clock_jump", "poor_fit".
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

    def fit(estimate: Estimate) -> Estimate:
        return refine_tangents(refine(estimate, views), views)

    def weigh(estimate: Estimate) -> Solution | None:
        found = sharp_solution(estimate, views)
        return None if found is None else replace(found, distance_px=estimate.d_avg_px)

    told = certain(settled(search, views, fit, weigh), rules)
    return told if told.status == Status.OK else start


def _despite_the_mean(start: Estimate, search: Estimate, views: TwoViews) -> Estimate:
    """Try the tangents from a search whose refinement was refused for its covariance."""
    fit, weigh = partial(refine, views=views), partial(sharp_solution, views=views)
    rules = views.config.rules.verdict
    refined = refine_tangents(settled(search, views, fit, weigh), views)
    outline, max_sigmas = certain(refined, rules), views.config.rules.tangency.max_sigmas
    strays_s = abs(outline.t_d_s - start.t_d_s)
    if outline.status != Status.OK or strays_s > max_sigmas * start.t_d_std_s:
        return start
    return outline


def refine_tangents(
    start: Estimate, views: TwoViews, config: TangencyRules | None = None
) -> Estimate:
    """Find tangents and refine offset and pose by turns, from an offset and a pose.

    A start that is not "ok" is returned as it is. With a known pose only t_d is refined, and there
    is a `t_d_std_s` but no `covariance`. How tangents are used is as the views' config says when
    None.
    """
    rules, min_pairs = views.config.rules, views.config.rules.search.min_pairs
    config = for_blind(config or rules.tangency, views)
    if start.status != Status.OK or start.R is None or start.t is None:
        return start
    model = clock_model(views, start)
    parameters = Parameters(start.t_d_s, start.R, start.t, model.start(start))
    near: list[list[OutlineEvents]] | None = None
    is_far, settles = True, False  # as the start may be
    allowance = Allowance(views.rig, model.has_priors)
    times_s = tangent_times(views, start.t_d_s, config)
    for _ in range(config.max_rounds):
        before = parameters
        seen = views.under(model.clock(before))
        pairs, near = tangents_under(before, seen, times_s, config, None if is_far else near)
        if len(pairs.times_s) < min_pairs:
            reason = (
                f"only {len(pairs.times_s)} tangents are seen in both views, and {min_pairs} are"
                " needed: the object is too small for an outline, take `joint`"
            )
            return replace(start, status=Status.TOO_FEW_SAMPLES, reason=reason)
        turn = config.wider_cauchy if is_far else config.cauchy
        problem = Problem(pairs, views.rig, rules.fit, views.pose_is_known, turn=turn)
        problem = allowance.added(model.problem(pairs, before, problem, seen))
        found = solve(problem, before, config.steps, last_step=0.0)
        parameters = found.parameters
        left = astray(start, parameters, rules.joint)
        if left is not None:
            return left
        stray_s, last_s = model.moved_s(before, parameters), rules.joint.last_stray_s
        settles = not is_far and allowance.is_made and _are_near(before, parameters, rules)
        settles = settles and stray_s <= last_s
        if settles:
            break
        is_far = not _are_near(before, parameters, rules, config.far)
        is_far = is_far or stray_s > config.far * last_s
        if not is_far:
            allowance.learn(replace(problem, turn=config.cauchy), parameters)

    problem = replace(problem, turn=config.cauchy)
    residuals = linearise(problem, parameters)
    covariance = covariance_of(problem, residuals, _errors_cancel(views))
    hidden_px: Array | None = None
    if views.pose_is_known:  # a free pose takes it away
        share = seen.lasting_share(parameters.t_d_s, 400)
        hidden_px = share * _hidden_errors(pairs, config.hidden_px)
        covariance = covariance + hidden_covariance(problem, residuals, hidden_px)
    if not settles and still_moves(found.change, problem, covariance):
        return unsettled(start, config.max_rounds)
    found_by = model.told(start, parameters, problem, covariance)
    told = refined_estimate(
        found_by,
        problem,
        parameters,
        residuals,
        covariance,
        views.object_px,
        rules.verdict,
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


def _hidden_errors(pairs: WeighedPairs, hidden_px: float) -> Array:
    """Give the changes (n, 2) of the residuals by such an error of the upper and lower tangents."""
    starts = np.concatenate([[0], np.flatnonzero(np.diff(pairs.times_s) < 0.0) + 1])
    side = np.searchsorted(starts, np.arange(len(pairs.times_s)), side="right") - 1
    of_side = (side[:, None] == np.arange(len(starts))).astype(np.float64)
    return np.asarray(hidden_px * pairs.weights[:, None] * of_side)


def _are_near(one: Parameters, other: Parameters, rules: Rules, factor: float = 1.0) -> bool:
    """Whether the changes from one to the other are at most `factor` times the last ones."""
    turn = np.linalg.norm(other.R - one.R) + np.linalg.norm(other.t - one.t)
    shift_s = abs(other.t_d_s - one.t_d_s)
    last_s, last_turn = rules.joint.last_shift_s, rules.tangency.last_turn
    return bool(shift_s <= factor * last_s and turn <= factor * last_turn)
