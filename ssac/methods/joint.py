"""A search's result in, offset and pose refined together by robust least squares out.

Beyond the paper. The residuals are Sampson distances between the positions p1(t_i) and
p2(t_i + t_d), as `ssac.fit.least_squares` has them.

What limits the accuracy is not noise: the mean of the events is not the image of any fixed point of
the object, and strays from it by an amount that changes slowly with attitude and grows with the
object's image. So the positions are those of `ObjectMotion.sharp_at`, and each residual is weighed
by the inverse of its images' size (`docs/uncertainty.md` compares these choices).
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
from ssac.geometry.fundamental import MIN_PAIRS
from ssac.geometry.pose import rays_of
from ssac.methods.algorithms import with_fit
from ssac.methods.clocks import checked_clock, clock_model, with_coarse_skew
from ssac.methods.hypotheses import confirmed, settled, sharp_solution
from ssac.methods.method import method
from ssac.methods.verdict import certain, doubt, is_spread
from ssac.rules import VerdictRules
from ssac.search.two_views import TwoViews
from ssac.track.motion import SharpTrack

Array = NDArray[np.float64]

BIAS_OFFSET, BIAS_SLOPE = 0.01, 0.04
"""Deviations of a view's hidden bias, in sizes of the object's image: anywhere, and per unit of
x / z and of y / z.

The mean of the events lies elsewhere on the object as this is seen from elsewhere, and a change of
pose can take such a smooth function of the image position away, so that no residual shows it. Both
were fitted, so that the regions of R and t hold, to 126 simulated flights of one drone.
"""

KNOWN_BIAS_OFFSET = 0.1
"""The same as BIAS_OFFSET where the pose is given, and so takes nothing away, and the motion is too
little for the bias to change."""

MAX_SHIFT_S = 0.1
"""A refinement that moves the offset further than this has left the minimum."""

_MAX_RESAMPLINGS = 20
_LAST_HOPE = 2  # round after which one that is far from any ordinary fit is given up
_LAST_SHIFT_S = 1e-5  # events that enter the windows move the minimum about as far
_LEAST_SIZE_PX = 1e-12

LAST_STRAY_S = 3e-5
"""The same of a clock's other parameters, rms over the recording, which are less certain."""


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

    Parameters
    ----------
    start
        What Algorithm 2, or Algorithm 1 with a known pose, found.
    views
        The same views.

    Returns
    -------
    Estimate
        With `t_d_std_s` and `covariance`. The status may be that of the start, or "no_convergence",
        "clock_jump", "poor_fit".
    """
    name = "joint-known" if views.pose_is_known else "joint"
    start = with_coarse_skew(start, views)
    start = replace(start, method=name, start=start)
    best = settled(start, views, partial(refine, views=views), partial(sharp_solution, views=views))
    return confirmed(certain(best, views.config.rules.verdict), start, views)


def refine(start: Estimate, views: TwoViews) -> Estimate:
    """Minimise Cauchy's loss of the Sampson distances, from an estimate.

    Parameters
    ----------
    start
        Offset and pose; returned as it is when its status is not "ok".
    views
        Both views. With a known pose only t_d is refined, and there is a `t_d_std_s` but no
        `covariance`.
    """
    if start.status != Status.OK or start.R is None or start.t is None:
        return start
    model, rules = clock_model(views, start), views.config.rules.verdict
    parameters = Parameters(start.t_d_s, start.R, start.t, model.start(start))
    times_s = views.sample_times(np.array([start.t_d_s]))[0]
    allowance, settles = Allowance(views.rig, model.has_priors), False
    motion1, track1 = views.motion1, views.motion1.sharp_at(times_s)
    for round_ in range(_MAX_RESAMPLINGS):
        before = parameters
        seen = model.views(views, before)
        if seen.motion1 is not motion1:  # as the readout of a shutter changes it
            motion1, track1 = seen.motion1, seen.motion1.sharp_at(times_s)
        track2 = seen.motion2.sharp_at(seen.on_clock_2(times_s, before.t_d_s))
        pairs, size_px = sharp_pairs(track1, track2, before.t_d_s)
        if len(pairs.times_s) < MIN_PAIRS:
            return _unseen(start, before, len(pairs.times_s))
        problem = Problem(pairs, views.rig, views.pose_is_known)
        problem = allowance.added(model.problem(pairs, before, problem, seen))
        found = model.solve(problem, before)
        parameters = found.parameters
        if has_left(start, parameters):
            return astray(start, parameters)
        settles = allowance.is_made and abs(parameters.t_d_s - before.t_d_s) < _LAST_SHIFT_S
        settles = settles and model.moved_s(before, parameters) < LAST_STRAY_S
        if settles:
            break
        if round_ == _LAST_HOPE:
            distances_px = linearise(problem, parameters).distances_px
            if is_spread(distances_px, size_px, rules):
                found_by = checked_clock(start, model, problem, parameters)
                if found_by.status == Status.CLOCK_JUMP:
                    return found_by
                reason = doubt(distances_px, size_px, rules)
                return replace(start, status=Status.POOR_FIT, reason=reason, R=None, t=None)
        allowance.learn(problem, parameters)

    residuals = linearise(problem, parameters)
    offset = BIAS_OFFSET
    if views.pose_is_known:
        seen = model.views(views, parameters)
        offset = max(offset, KNOWN_BIAS_OFFSET * seen.lasting_share(parameters.t_d_s))
    F = _fundamental(parameters, views.rig)
    hidden_px = _hidden_errors(F, residuals, size_px, offset, views.rig)
    covariance = covariance_of(problem, residuals)
    covariance = covariance + hidden_covariance(problem, residuals, hidden_px)
    unfinished = [] if settles else [found.change]
    unfinished += [] if found.converged else [found.last_step]
    if any(still_moves(change, problem, covariance) for change in unfinished):
        return unsettled(start, _MAX_RESAMPLINGS)
    found_by = model.told(start, parameters, problem, covariance)
    told = refined_estimate(
        found_by, problem, parameters, residuals, covariance, size_px, rules, hidden_px
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


def has_left(start: Estimate, parameters: Parameters) -> bool:
    """Whether a refinement has left the minimum that it started in."""
    return abs(parameters.t_d_s - start.t_d_s) > MAX_SHIFT_S


def astray(start: Estimate, parameters: Parameters) -> Estimate:
    """Refuse a refinement that has left the minimum that it started in."""
    reason = (
        f"the refinement moved t_d from {start.t_d_s:.3f} to {parameters.t_d_s:.3f} s, further than"
        f" {1e3 * MAX_SHIFT_S:.0f} ms"
    )
    return replace(start, status=Status.NO_CONVERGENCE, reason=reason)


def _unseen(start: Estimate, parameters: Parameters, n_pairs: int) -> Estimate:
    # Views that are cut in pieces share next to nothing at some offsets.
    reason = (
        f"the refinement moved t_d from {start.t_d_s:.3f} to {parameters.t_d_s:.3f} s, where only"
        f" {n_pairs} sample times are valid in both views, and {MIN_PAIRS} are needed"
    )
    return replace(start, status=Status.NO_CONVERGENCE, reason=reason)


def unsettled(start: Estimate, rounds: int) -> Estimate:
    """Refuse a refinement whose iterations ran out."""
    reason = f"after {rounds} rounds the refinement from {start.t_d_s:.3f} s still moved"
    return replace(start, status=Status.NO_CONVERGENCE, reason=reason)


def sharp_pairs(track1: SharpTrack, track2: SharpTrack, t_d_s: float) -> tuple[WeighedPairs, float]:
    """Pair two tracks, sampled at the same N instants, where both are valid.

    Returns
    -------
    tuple
        The pairs, weighed by the inverse of the images' size, and the median of that size [px].
    """
    valid = track1.valid & track2.valid
    sizes_px = np.hypot(track1.sizes_px[valid], track2.sizes_px[valid]) + _LEAST_SIZE_PX
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


def _hidden_errors(
    F: Array, residuals: Residuals, size_px: float, offset: float, rig: Rig
) -> Array:
    """Give what each part of the hidden bias, one deviation of it, does to the distances: (n, 12).

    Distances are weighed by the inverse of the image's size, and the bias is a part of it: so the
    weights drop out.
    """
    p1, p2 = residuals.p1_px, residuals.p2_px
    parts = []
    for F_there, there, here, K in ((F.T, p2, p1, rig.cam1.K), (F, p1, p2, rig.cam2.K)):
        shifts = size_px * rays_of(K, here) * np.array([BIAS_SLOPE, BIAS_SLOPE, offset])
        for axis in np.eye(2):
            along = np.tile(axis, (len(here), 1))
            by_shift = sampson_derivative(F_there, np.zeros((3, 3)), there, here, along)
            parts.append(by_shift[:, None] * shifts)
    return np.hstack(parts)
