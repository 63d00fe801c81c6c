"""Offset and pose refined by the outline's epipolar tangents, from the joint refinement's result.

Beyond the paper. The object's position, be it a mean of its events or a sharper one, is the image
of no fixed point of the object: it changes with attitude and viewpoint. This bias, not noise,
limits the accuracy, the more the larger the object. The two epipolar planes that touch the object
are the same in both views for any shape (`ssac.track.outline`), so the points where one of them
touches both outlines are pairs without that bias. Such pairs replace the positions in the same
least squares, and are found anew after each solution, as they depend on the pose.

Errors of the outline are one-sided and long-tailed: a thin or pale tip is missed in one view and
seen in the other. So the loss has a small scale, and weights grow with the outlines' sharpness.
"""

from dataclasses import replace

import numpy as np

from ssac.arrays import Array
from ssac.estimate import POSE_IS_OPEN, SETTLED_BY, Estimate, Status
from ssac.fit.least_squares import Parameters, Problem, Residuals, WeighedPairs, linearise, solve
from ssac.geometry.epipolar import epipolar_lines_1, robust_deviation, sampson_derivative
from ssac.geometry.pose import pencils, pose_step
from ssac.methods.algorithms import algorithm_2
from ssac.methods.hypotheses import Choice, is_in_front
from ssac.methods.joint import joint_from, refine
from ssac.methods.method import method
from ssac.methods.refinement import Refinement, Round, smooth_errors
from ssac.methods.rigid_body import body_points, by_areas, is_large
from ssac.methods.verdict import certain, scaled, widened
from ssac.rules import TangencyRules
from ssac.search.two_views import TwoViews
from ssac.track.motion import ObjectMotion, PointMotion
from ssac.track.outline import OutlineEvents, Tangents, near_outline, tangents


def for_blind(views: TwoViews) -> TwoViews:
    """Return the views with rules of the outline for blind spans, if a camera has any.

    The mean time of a window's events then differs from the window's middle, so that the course
    about which tangents are found would oscillate. A short rough window would be blind on one side.
    """
    if not any(map(len, views.alone.blind_us)):
        return views
    config = views.rules.tangency
    longest_s = max(config.outline.rough_half_window_s, config.outline.half_window_s)
    outline = replace(config.outline, centred=True, rough_half_window_s=longest_s)
    return views.by(tangency=replace(config, outline=outline))


def tangent_times(views: TwoViews, t_d_s: float) -> Array:
    """Even times [s] of camera 1's clock that both recordings cover."""
    (start, end), step_s = views.common_s(t_d_s), views.rules.tangency.step_s
    n = max(int((end - start) / step_s), 2)
    return np.asarray(start + step_s * np.arange(n))


def tangents_under(
    parameters: Parameters,
    views: TwoViews,
    times_s: Array,
    near: list[list[OutlineEvents]] | None = None,
) -> tuple[WeighedPairs, list[list[OutlineEvents]]]:
    """Find and pair the tangents of both views at even times (n,) [s] of camera 1's clock.

    The events near each view's outline are returned too; `near` may be those of an earlier call
    with similar parameters.
    """
    rig, rules = views.rig, views.rules.tangency
    clocks_s = times_s, views.on_clock_2(times_s, parameters.t_d_s)
    pair = pencils(parameters.R, parameters.t, rig.cam1.K, rig.cam2.K)
    sides = list(zip(_of_events(views), pair, clocks_s, strict=True))
    if near is None:
        near = [near_outline(*side, rules.outline) for side in sides]
    found = [
        tangents(motion, events, pencil, clock_s, rules.outline)
        for (motion, pencil, clock_s), events in zip(sides, near, strict=True)
    ]
    return tangent_pairs(times_s, found[0], found[1], parameters.t_d_s, rules), near


def _of_events(views: TwoViews) -> tuple[ObjectMotion, ObjectMotion]:
    """Return both motions without lines that hold the object."""
    one, other = views.motions
    assert isinstance(one, ObjectMotion)  # a method that needs events gets no track of points
    assert isinstance(other, ObjectMotion)
    return one.bare or one, other.bare or other


def tangent_pairs(
    times_s: Array,
    view1: list[Tangents],
    view2: list[Tangents],
    t_d_s: float,
    config: TangencyRules,
) -> WeighedPairs:
    """Pair the tangents of each side, sampled `t_d_s` apart at n instants, where both are valid."""
    # Weights are the inverse of the error that is expected from the blur of both outlines.
    if not config.apart:
        view1, view2 = [_midway(*view1)], [_midway(*view2)]
    parts = []
    for one, two in zip(view1, view2, strict=True):
        k = one.valid & two.valid
        spread_px = np.sqrt(config.sharp_px**2 + one.spreads_px[k] ** 2 + two.spreads_px[k] ** 2)
        points = one.points_px[k], two.points_px[k], two.velocities_px_s[k]
        parts.append((times_s[k], *points, spread_px))
    times_s, p1, p2, v2, errors_px = (np.concatenate(of) for of in zip(*parts, strict=True))
    weights = np.median(errors_px) / errors_px if len(errors_px) else errors_px
    return WeighedPairs(times_s, p1, p2, v2, weights, t_d_s)


def _midway(upper: Tangents, lower: Tangents) -> Tangents:
    return Tangents(
        0.5 * (upper.points_px + lower.points_px),
        0.5 * (upper.velocities_px_s + lower.velocities_px_s),
        np.hypot(upper.spreads_px, lower.spreads_px),
        upper.valid & lower.valid,
    )


def is_tiny(views: TwoViews) -> bool:
    """Whether the object is too small for an outline, so that the start is the answer."""
    return views.object_px < views.rules.tangency.least_size_px


@method(
    "tangency",
    "joint, then refined by the outline's tangents",
    place=5,
    known="joint-known, then the offset refined by tangents",
    starts_from="joint",
    keeps_start="is_tiny",
    counts="pairs of tangents to the outline, and of a body's point",
    needs_events=True,
    follows_clock=True,
    of_one_object=True,
)
def tangency_from(start: Estimate, views: TwoViews) -> Estimate:
    """Time offset and relative pose from epipolar tangents, or the offset alone of a known pose.

    The mean of a large or odd object's events may be too uncertain for a pose, and still be a start
    for the tangents: where `joint` refuses, they are tried from the search that it started from.
    If the object is large, search and `joint` are first repeated with its silhouettes' centres.
    The mean of a tiny object's events is better than its outline: there the start is the answer.

    Last, pairs of one point of a rigid body join the tangents', where both silhouettes show one.
    The start is of `joint_from`; `n_samples` and `d_avg_px` are of all these pairs.
    """
    name = "tangency-known" if views.pose_is_known else "tangency"
    start = replace(start, method=name, start=start)
    if is_tiny(views):
        return widened(start, (views.rules.tangency.tiny_times**2 - 1.0) * start.t_d_std_s**2)
    is_vague = not views.pose_is_known and start.status in SETTLED_BY["tangency"]
    if is_vague and is_large(views):
        areas = by_areas(views, start.t_d_s)
        if areas is not None:
            of_areas = joint_from(algorithm_2(areas), areas)
            found = _refined(replace(of_areas, method=name, start=of_areas), areas, views)
            if found.status == Status.OK:
                return found
    return _refined(start, views, views)


def _refined(start: Estimate, positions: TwoViews, views: TwoViews) -> Estimate:
    """Refine by tangents the estimate of `joint_from` or, where that is refused, the search's."""
    assert start.start is not None
    search, rules = start.start.start, views.rules.verdict
    if views.pose_is_known or start.status not in SETTLED_BY["tangency"] or search is None:
        return _as_seen(start, certain(refine_tangents(start, views), rules), views)
    search = replace(search, method=start.method, start=start)
    if search.status in (Status.OK, *POSE_IS_OPEN):
        # The refinement of this search was refused for its covariance.
        settled = Choice(positions, refine).settled(search)
        found = certain(refine_tangents(settled, views), rules)
        if found.status != Status.OK:  # a poor fit is not reliable even in part
            return found if found.status == Status.POOR_FIT else start
        if start.status == Status.AMBIGUOUS_OFFSET and leaves_offset_open(found, views):
            return start
        strays_s = abs(found.t_d_s - start.t_d_s)
        if strays_s > views.rules.tangency.max_sigmas * start.t_d_std_s:  # either may err
            return widened(start, strays_s**2)
        return _as_seen(start, found, views)
    if positions.alone.repeats or len(search.alternatives_s) == 0:  # motion leaves the offset open
        return start

    def refined(search: Estimate, positions: TwoViews) -> Estimate:
        return refine_tangents(refine(search, positions), views)  # positions first

    found = certain(Choice(positions, refined, by_own_pairs=True).settled(search), rules)
    if found.status != Status.OK or leaves_offset_open(found, views):
        return start
    return _as_seen(start, found, views)


def leaves_offset_open(found: Estimate, views: TwoViews) -> bool:
    """Whether the tangents fit other offsets about as well, each with a pose of its own.

    An object that circles and turns with its course looks the same at any offset. The deviation
    does not tell: noise in the tangents' velocities passes for knowledge of the offset, 6 ms for an
    error of 60.
    """
    if found.R is None or found.t is None:
        return False
    views, pose = for_blind(views).under(found.clock), (found.R, found.t)
    probe_s = views.rules.tangency.probe_s
    here_px, *there_px = (
        _misfit_px(Parameters(found.t_d_s + shift_s, *pose), views)
        for shift_s in (0.0, -probe_s, probe_s)
    )
    return min(there_px) <= views.rules.hypotheses.clearly * here_px


def _misfit_px(parameters: Parameters, views: TwoViews) -> float:
    """Median distance of the tangents at a fixed offset, with the pose that fits them best."""
    rules, times_s = views.rules, tangent_times(views, parameters.t_d_s)
    for _ in range(rules.tangency.max_rounds):
        pairs, _ = tangents_under(parameters, views, times_s)
        if len(pairs.times_s) < rules.search.min_pairs:
            return np.inf
        # Without velocities no change of the offset would help.
        pairs = replace(pairs, v2_px_s=np.zeros_like(pairs.v2_px_s))
        problem = Problem(pairs, views.rig, rules.fit)
        parameters = solve(problem, parameters, rules.tangency.steps, 0.0).parameters
    return float(np.median(np.abs(linearise(problem, parameters).distances_px)))


def _as_seen(start: Estimate, found: Estimate, views: TwoViews) -> Estimate:
    """Join the body, and adapt the deviations to the share of the tangents that are seen."""
    # Where few are, the views may show different parts of the object, whose offset no residual
    # tells from the true one, unless a body confirms it. Then half of the difference from the
    # start, which is the two offsets' deviation from their mean, adds to the offset's. In the dark,
    # as noise tells, pixels lag besides, and the offset is at most as certain as the start's.
    if found.status != Status.OK:
        return found
    rules, n_tangents = views.rules.tangency, 2 * len(tangent_times(views, found.t_d_s))
    joined = with_body(found, views)
    is_dark = views.noise_hz >= rules.dark_hz
    few = n_tangents * (rules.few_seen_in_dark if is_dark else rules.few_seen)
    if joined.t_d_s != found.t_d_s or found.n_samples >= few:
        share = joined.n_samples / n_tangents
        return scaled(joined, float(np.interp(share, rules.seen_shares, rules.seen_times)))
    if start.status == Status.AMBIGUOUS_OFFSET or not np.isfinite(start.t_d_s):
        return joined
    hidden = (0.5 * (found.t_d_s - start.t_d_s)) ** 2
    if is_dark and start.t_d_std_s > joined.t_d_std_s:
        hidden += start.t_d_std_s**2 - joined.t_d_std_s**2
    return widened(joined, hidden)


def with_body(found: Estimate, views: TwoViews) -> Estimate:
    """Join tangents with the pairs of one point of a rigid body, where both views show one.

    Where the body contradicts the tangents, their estimate stands, widened by the difference.
    """
    rules = views.rules.tangency
    if not rules.joins_body or found.status != Status.OK or found.R is None or found.t is None:
        return found
    body = body_points(found, views)
    if isinstance(body, str):
        return replace(found, without_body=body)
    joined = _OfTangents(found, for_blind(views), body).estimate(found.R, found.t)
    joined = certain(joined, views.rules.verdict)
    if joined.status != Status.OK or joined.R is None or joined.t is None:
        return replace(found, without_body=f"with the body it were {joined.status}")
    # Change of t_d [s] and the pose [rad]; `apart` is its length in the tangents' deviations.
    change = np.append(joined.t_d_s - found.t_d_s, pose_step(found.R, found.t, joined.R, joined.t))
    covariance, apart = found.covariance, float(abs(change[0]) / found.t_d_std_s)
    if covariance is not None:
        apart = float(np.sqrt(change @ np.linalg.solve(covariance, change)))
        covariance = covariance + np.outer(change, change)
    if apart > rules.max_apart:  # either may be right
        wider = replace(widened(found, change[0] ** 2), covariance=covariance)
        return replace(wider, without_body="the body contradicts the tangents")
    return joined


def refine_tangents(start: Estimate, views: TwoViews) -> Estimate:
    """Find tangents and refine offset and pose in turn; a start that is not "ok" is kept."""
    if start.status != Status.OK or start.R is None or start.t is None:
        return start
    found = _OfTangents(start, for_blind(views)).estimate(start.R, start.t)
    if found.status != Status.OK or found.R is None or found.t is None or views.pose_is_known:
        return found
    if is_in_front(found, views):
        return found
    # -t fits as well: a start far off may lead to the t that puts all behind the cameras.
    opposite = _OfTangents(start, for_blind(views)).estimate(found.R, -found.t)
    return opposite if is_in_front(opposite, views) else found


class _OfTangents(Refinement):
    """Pairs of tangents and of a body's point; outlines are found anew after large changes."""

    def __init__(
        self, start: Estimate, views: TwoViews, body: tuple[PointMotion, PointMotion] | None = None
    ) -> None:
        super().__init__(start, views)
        self.body = body
        rules = self.rules.tangency
        self.max_rounds, self.size_px = rules.max_rounds, views.object_px
        self.turn, self.last_turn = rules.wider_cauchy, rules.cauchy
        self.solving = {"max_steps": rules.steps, "last_step": 0.0}
        # Errors common to both sides push both tangents outward, which has no net effect on the
        # offset in a free flight. An object on a line swings before cameras that see the same side
        # of it all along: there a constant error of the outline changes the pose, and the offset
        # with it. No residual shows this, so that common errors may not reduce a variance
        # (`docs/uncertainty.md`).
        self.lessens = all(getattr(motion, "bare", None) is None for motion in views.motions)
        self.times_s = tangent_times(views, start.t_d_s)
        self.near: list[list[OutlineEvents]] | None = None
        self.is_far = True  # the start may be far off

    def pairs(self, seen: TwoViews, parameters: Parameters) -> WeighedPairs:
        near = None if self.is_far else self.near
        pairs, self.near = tangents_under(parameters, seen, self.times_s, near)
        return pairs if self.body is None else self._joined(pairs, seen, parameters)

    def _joined(self, pairs: WeighedPairs, seen: TwoViews, parameters: Parameters) -> WeighedPairs:
        assert self.body is not None
        of_body = replace(seen, motion1=self.body[0], motion2=self.body[1])
        one, two = of_body.sharp_at(self.times_s, parameters.t_d_s)
        weights = np.full(len(one.times_s), 1.0 / self.rules.tangency.body_error)
        weights = np.concatenate([pairs.weights, weights])
        return WeighedPairs(
            np.concatenate([pairs.times_s, one.times_s]),
            np.concatenate([pairs.p1_px, one.positions_px]),
            np.concatenate([pairs.p2_px, two.positions_px]),
            np.concatenate([pairs.v2_px_s, two.velocities_px_s]),
            weights / np.median(weights),
            pairs.t_d_s,
            np.repeat([0, 1], [len(pairs.times_s), len(one.times_s)]),
        )

    def unseen(self, n_pairs: int, parameters: Parameters) -> Estimate:
        reason = (
            f"only {n_pairs} tangents are seen in both views, and {self.rules.search.min_pairs} are"
            " needed: the object is too small for an outline, take `joint`"
        )
        return self.start_refused(Status.TOO_FEW_SAMPLES, reason)

    def settles(self, last: Round) -> bool:
        return not self.is_far and self._is_near(last, 1.0)

    def refused(self, last: Round) -> None:
        rules = self.rules.tangency
        self.is_far = not self._is_near(last, rules.far)
        self.turn = rules.wider_cauchy if self.is_far else rules.cauchy
        if not self.is_far:
            problem = replace(last.problem, turn=rules.cauchy)
            self.allowance.learn(problem, last.found.parameters)

    def hidden_px(self, last: Round, residuals: Residuals) -> Array:
        """Return the residuals' changes by lasting errors: (n, 2) with a known pose, else (n, 13).

        With a body they are (n, 13) more, and (n, 1) of the outlines with a free pose.

        With a free pose, outlines are off by the same number of pixels in both views, as seen by
        similar sensors. The angles of the planes then differ between a near and a far view, and as
        the nearer view changes, a pose compensates; errors in proportion to the image's size
        cancel. A known pose cannot compensate: all upper, or all lower, tangents are off.
        """
        pairs, rules = residuals.problem.pairs, self.rules.tangency
        of_body = np.zeros(len(pairs.times_s), bool) if pairs.kinds is None else pairs.kinds == 1
        starts = np.append(True, np.diff(pairs.times_s) < 0.0)
        of_side = (np.cumsum(starts)[:, None] == (1, 2)).astype(float)
        if self.views.pose_is_known:
            share = last.seen.lasting_share(residuals.parameters.t_d_s, 400)
            errors = share * rules.hidden_px * of_side
        else:
            lines1 = epipolar_lines_1(residuals.F, residuals.p2_px)
            lines2 = epipolar_lines_1(residuals.F.T, residuals.p1_px)
            slopes1, slopes2 = (np.hypot(lines[:, 0], lines[:, 1]) for lines in (lines1, lines2))
            outward = (slopes1 - slopes2) / np.hypot(slopes1, slopes2)  # change of distance per px
            wide_px = rules.hidden_width * robust_deviation(residuals.distances_px[~of_body])
            errors = wide_px * outward[:, None] * (of_side[:, :1] - of_side[:, 1:])
            if pairs.kinds is None:
                bias = rules.outline_offset, rules.outline_slope
                errors = np.hstack([errors, smooth_errors(residuals, self.size_px, *bias)])
        if pairs.kinds is not None:
            errors = np.hstack([errors, of_body[:, None] * self._of_body(residuals)])
        return np.asarray(pairs.weights[:, None] * errors)

    def _of_body(self, residuals: Residuals) -> Array:
        """Return the changes (n, 13) by errors of the body's shape and of its images' times."""
        rules, v2 = self.rules.tangency, residuals.problem.pairs.v2_px_s
        points = residuals.F, residuals.p1_px, residuals.p2_px
        errors = smooth_errors(residuals, self.size_px, rules.body_offset, rules.body_slope)
        ahead = rules.body_lag_px * v2 / (np.linalg.norm(v2, axis=1)[:, None] + 1e-9)
        return np.column_stack([errors, sampson_derivative(*points, ahead)])

    def _is_near(self, last: Round, factor: float) -> bool:
        """Whether a round's changes are at most `factor` times those of a settled solution."""
        before, after, rules = last.before, last.found.parameters, self.rules.joint
        turn = np.linalg.norm(after.R - before.R) + np.linalg.norm(after.t - before.t)
        return bool(
            last.shift_s <= factor * rules.last_shift_s
            and turn <= factor * self.rules.tangency.last_turn
            and self.model.moved_s(before, after) <= factor * rules.last_stray_s
        )
