"""Offset and pose refined together by robust least squares, from a search's result.

Beyond the paper. The residuals are Sampson distances between the positions p1(t_i) and
p2(t_i + t_d), as `ssac.fit.least_squares` has them.

What limits the accuracy is not noise: the mean of the events is not the image of any fixed point of
the object, and strays from it by an amount that changes slowly with attitude and grows with the
object's image. So the positions are those of `ObjectMotion.sharp_at`, and each residual is weighed
by the inverse of its images' size.
"""

from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from ssac.camera import Rig
from ssac.estimate import Estimate, Status
from ssac.fit.intrinsics import Allowance, evidence, fundamental_of
from ssac.fit.least_squares import (
    Parameters,
    Problem,
    Residuals,
    WeighedPairs,
    covariance_of,
    hidden_covariance,
    linearise,
    still_moves,
)
from ssac.geometry.epipolar import fundamental_from_pose, sampson_derivative
from ssac.geometry.pose import rays_of
from ssac.methods.algorithms import with_fit
from ssac.methods.clocks import checked_clock, clock_model, with_coarse_skew
from ssac.methods.hypotheses import confirmed, settled, sharp_solution
from ssac.methods.method import method
from ssac.methods.verdict import certain, doubt, is_spread
from ssac.rules import JointRules, VerdictRules
from ssac.search.two_views import TwoViews
from ssac.track.motion import SharpTrack

Array = NDArray[np.float64]


@method(
    "joint",
    "ssac, then offset and pose refined together",
    place=3,
    known_variant="joint-known",
    starts_from="ssac",
    finds_readout=True,
    follows_clock=True,
    of_one_object=True,
)
@method(
    "joint-known",
    "ssac-known, then the offset refined",
    place=4,
    needs_extrinsics=True,
    starts_from="ssac-known",
    finds_readout=True,
    follows_clock=True,
    of_one_object=True,
)
def joint_from(start: Estimate, views: TwoViews) -> Estimate:
    """Refine offset and pose together, or the offset alone where the pose is known.

    The start is what Algorithm 2, or Algorithm 1 with a known pose, found of the same views. The
    result has `t_d_std_s` and `covariance`; its status may be that of the start, or
    "no_convergence", "clock_jump", "poor_fit".
    """
    name = "joint-known" if views.pose_is_known else "joint"
    start = with_coarse_skew(start, views)
    start = replace(start, method=name, start=start)
    best = settled(start, views, partial(refine, views=views), partial(sharp_solution, views=views))
    return confirmed(certain(best, views.config.rules.verdict), start, views)


def refine(start: Estimate, views: TwoViews) -> Estimate:
    """Minimise Cauchy's loss of the Sampson distances, from an offset and a pose.

    A start that is not "ok" is returned as it is. With a known pose only t_d is refined, and there
    is a `t_d_std_s` but no `covariance`.
    """
    if start.status != Status.OK or start.R is None or start.t is None:
        return start
    model, rules = clock_model(views, start), views.config.rules
    parameters = Parameters(start.t_d_s, start.R, start.t, model.start(start))
    times_s = views.sample_times(np.array([start.t_d_s]))[0]
    allowance, settles = Allowance(views.rig, model.has_priors), False
    motion1, track1 = views.motion1, views.motion1.sharp_at(times_s)
    for round_ in range(rules.joint.max_rounds):
        before = parameters
        seen = model.views(views, before)
        if seen.motion1 is not motion1:  # as the readout of a shutter changes it
            motion1, track1 = seen.motion1, seen.motion1.sharp_at(times_s)
        track2 = seen.motion2.sharp_at(seen.on_clock_2(times_s, before.t_d_s))
        pairs, size_px = sharp_pairs(track1, track2, before.t_d_s)
        if len(pairs.times_s) < rules.search.min_pairs:
            return _unseen(start, before, len(pairs.times_s), rules.search.min_pairs)
        problem = Problem(pairs, views.rig, rules.fit, views.pose_is_known)
        problem = allowance.added(model.problem(pairs, before, problem, seen))
        found = model.solve(problem, before)
        parameters = found.parameters
        left = astray(start, parameters, rules.joint)
        if left is not None:
            return left
        shift_s, stray_s = abs(parameters.t_d_s - before.t_d_s), model.moved_s(before, parameters)
        settles = allowance.is_made and shift_s < rules.joint.last_shift_s
        settles = settles and stray_s < rules.joint.last_stray_s
        if settles:
            break
        if round_ == rules.joint.last_hope:
            distances_px = linearise(problem, parameters).distances_px
            if is_spread(distances_px, size_px, rules.verdict):
                found_by = checked_clock(start, model, problem, parameters)
                if found_by.status == Status.CLOCK_JUMP:
                    return found_by
                reason = doubt(distances_px, size_px, rules.verdict)
                return replace(start, status=Status.POOR_FIT, reason=reason, R=None, t=None)
        allowance.learn(problem, parameters)

    residuals = linearise(problem, parameters)
    offset = rules.joint.bias_offset
    if views.pose_is_known:
        seen = model.views(views, parameters)
        offset = max(offset, rules.joint.known_bias_offset * seen.lasting_share(parameters.t_d_s))
    F = _fundamental(parameters, views.rig)
    bias = np.array([rules.joint.bias_slope, rules.joint.bias_slope, offset])
    hidden_px = _hidden_errors(F, residuals, size_px, bias, views.rig)
    covariance = covariance_of(problem, residuals)
    covariance = covariance + hidden_covariance(problem, residuals, hidden_px)
    unfinished = [] if settles else [found.change]
    unfinished += [] if found.converged else [found.last_step]
    if any(still_moves(change, problem, covariance) for change in unfinished):
        return unsettled(start, rules.joint.max_rounds)
    found_by = model.told(start, parameters, problem, covariance)
    told = refined_estimate(
        found_by, problem, parameters, residuals, covariance, size_px, rules.verdict, hidden_px
    )
    return checked_clock(told, model, problem, parameters)


def refined_estimate(
    start: Estimate,
    problem: Problem,
    parameters: Parameters,
    residuals: Residuals,
    covariance: Array,
    object_px: float,
    rules: VerdictRules,
    hidden_px: Array | None = None,
) -> Estimate:
    """Put the parameters found, and the covariance of those that were free, into the estimate."""
    F = _fundamental(parameters, problem.rig)  # of the points with all that is allowed for
    fitted = with_fit(start, F, residuals.p1_px, residuals.p2_px)
    F = fundamental_of(problem, parameters)
    return replace(
        fitted,
        F=F / np.linalg.norm(F),
        t_d_s=parameters.t_d_s,
        t_d_std_s=float(np.sqrt(covariance[0, 0])),
        R=parameters.R,
        t=parameters.t,
        covariance=None if problem.pose_is_known else covariance[:6, :6],
        doubt=doubt(
            residuals.distances_px,
            object_px,
            rules,
            evidence(problem, residuals, parameters, hidden_px),
        ),
    )


def astray(start: Estimate, parameters: Parameters, rules: JointRules) -> Estimate | None:
    """Refuse a refinement that has left the minimum that it started in."""
    if not abs(parameters.t_d_s - start.t_d_s) > rules.max_shift_s:
        return None
    reason = (
        f"the refinement moved t_d from {start.t_d_s:.3f} to {parameters.t_d_s:.3f} s, further than"
        f" {1e3 * rules.max_shift_s:.0f} ms"
    )
    return replace(start, status=Status.NO_CONVERGENCE, reason=reason)


def _unseen(start: Estimate, parameters: Parameters, n_pairs: int, needed: int) -> Estimate:
    # Views that are cut in pieces share next to nothing at some offsets.
    reason = (
        f"the refinement moved t_d from {start.t_d_s:.3f} to {parameters.t_d_s:.3f} s, where only"
        f" {n_pairs} sample times are valid in both views, and {needed} are needed"
    )
    return replace(start, status=Status.NO_CONVERGENCE, reason=reason)


def unsettled(start: Estimate, rounds: int) -> Estimate:
    """Refuse a refinement whose iterations ran out."""
    reason = f"after {rounds} rounds the refinement from {start.t_d_s:.3f} s still moved"
    return replace(start, status=Status.NO_CONVERGENCE, reason=reason)


def sharp_pairs(track1: SharpTrack, track2: SharpTrack, t_d_s: float) -> tuple[WeighedPairs, float]:
    """Pair two tracks, sampled at the same N instants, where both are valid.

    Pairs are weighed by the inverse of the images' size, whose median [px] is the second result.
    """
    valid = track1.valid & track2.valid
    sizes_px = np.hypot(track1.sizes_px[valid], track2.sizes_px[valid]) + 1e-12
    size_px = float(np.median(sizes_px)) if len(sizes_px) else 0.0
    pairs = WeighedPairs(
        track1.times_s[valid],
        track1.positions_px[valid],
        track2.positions_px[valid],
        track2.velocities_px_s[valid],
        size_px / sizes_px,
        t_d_s,
    )
    return pairs, size_px


def _fundamental(parameters: Parameters, rig: Rig) -> Array:
    return fundamental_from_pose(rig.cam1.K, rig.cam2.K, parameters.R, parameters.t)


def _hidden_errors(F: Array, residuals: Residuals, size_px: float, bias: Array, rig: Rig) -> Array:
    """Give what each part of the hidden bias, one deviation of it, does to the distances: (n, 12).

    The mean of the events lies elsewhere on the object as this is seen from elsewhere, and a change
    of pose can take such a smooth function of the image position away, so that no residual shows
    it. Distances are weighed by the inverse of the image's size, and the bias (3,) is a part of it:
    so the weights drop out.
    """
    p1, p2 = residuals.p1_px, residuals.p2_px
    parts = []
    for F_there, there, here, K in ((F.T, p2, p1, rig.cam1.K), (F, p1, p2, rig.cam2.K)):
        shifts = size_px * rays_of(K, here) * bias
        for axis in np.eye(2):
            along = np.tile(axis, (len(here), 1))
            by_shift = sampson_derivative(F_there, np.zeros((3, 3)), there, here, along)
            parts.append(by_shift[:, None] * shifts)
    return np.hstack(parts)
