"""The joint refinement's result in, offset and pose from the outline's epipolar tangents out.

Beyond the paper. Whatever is taken for the object's position, a mean of its events or a sharper
one, is the image of no fixed point of it: it strays with attitude and viewpoint, and this bias, not
noise, limits what such positions give, the more the larger the object. Its tangent epipolar planes
are the same in both views for any shape (`outline`), so the points where they touch are pairs
without that bias. They take the place of the positions in the refinement of `refinement`, and are
found anew after each, as they depend on the pose a little.

Errors of the outline are one-sided and long-tailed: a thin or pale tip is missed in one view and
seen in the other. So the loss turns early, and a pair counts by how sharp its outlines are.
"""

from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from ssac.camera import Rig
from ssac.config import Config, checked
from ssac.estimate import POSE_IS_OPEN, Estimate
from ssac.geometry.epipolar import fundamental_from_pose
from ssac.geometry.fundamental import MIN_PAIRS
from ssac.geometry.pencil import pencils
from ssac.geometry.robust import cauchy_weights
from ssac.methods.algorithms import ssac
from ssac.methods.ambiguity import certain, settled
from ssac.methods.covariance import mapped_covariance
from ssac.methods.joint import (
    Parameters,
    SharpPairs,
    covariance_of,
    joint,
    joint_known,
    linearise,
    moved,
    refine,
    refined_estimate,
)
from ssac.search.observability import lasting_share, returns_s, view_of
from ssac.track.motion import ObjectMotion
from ssac.track.observation import Observation, object_motions, prepare
from ssac.track.outline import OutlineConfig, OutlineEvents, Tangents, near_outline, tangents

Array = NDArray[np.float64]


HIDDEN_PX = 0.2
"""Deviation of what the outlines are off by all along, where the pose is given and the motion slow
or short: no residual shows it."""


@dataclass(frozen=True)
class TangencyConfig:
    """How tangents are used; `docs/tangency.md` has what other values give."""

    outline: OutlineConfig = field(default_factory=OutlineConfig)
    step_s: float = 0.020  # between samples, each with two tangents, whatever `n_samples` is
    cauchy: float = 0.5  # where the loss turns, in robust standard deviations
    wider_cauchy: float = 1.2  # the same, as long as a round still moves the estimate far
    sharp_px: float = 0.05  # error of a tangent that is not blurred at all
    apart: bool = True  # each tangent is a pair; else the point midway between the two is


_UNCERTAIN = ("ambiguous_offset", "degenerate_pose")
_MAX_SIGMAS = 3.0  # of the start's offset, from where the tangents find another
_ROUNDS = 8  # of finding the tangents and refining; four are the rule
_STEPS = 3  # of Gauss-Newton in a round
_LAST_SHIFT_S = 1e-5  # between rounds
_LAST_TURN = 1e-4  # [rad] of the pose, between rounds
_FAR = 300.0  # times those last changes: then the outline is looked for among all events again
_N_OF_SHARE = 400  # samples that tell how much the object moves
_MAX_SHIFT_S = 0.1  # from the start; beyond it the refinement has left the minimum


def tangency(
    cam1: Observation, cam2: Observation, rig: Rig, config: Config | None = None
) -> Estimate:
    """Time offset and relative pose from epipolar tangents, starting from `refinement.joint`.

    Parameters and errors as for `ssac.methods.algorithms.ssac`.

    Returns
    -------
    Estimate
        With `t_d_std_s` and `covariance`. `n_samples` and `d_avg_px` are of the pairs of tangents.
        The status may be one of Algorithm 2's, or "no_convergence".
    """
    cam1, cam2 = prepare(cam1, cam2, rig, config)
    return tangency_from(joint(cam1, cam2, rig, config), cam1, cam2, rig, config)


def tangency_known(
    cam1: Observation, cam2: Observation, rig: Rig, config: Config | None = None
) -> Estimate:
    """Time offset alone, with the extrinsics of the rig, starting from `joint_known`."""
    cam1, cam2 = prepare(cam1, cam2, rig, config)
    return tangency_known_from(joint_known(cam1, cam2, rig, config), cam1, cam2, rig, config)


def tangency_from(
    start: Estimate,
    cam1: Observation,
    cam2: Observation,
    rig: Rig,
    config: Config | None = None,
) -> Estimate:
    """As `tangency`, given what `joint` found with the same arguments."""
    config = checked(config)
    motion1, motion2 = object_motions(cam1, cam2, rig, config)
    if start.status not in _UNCERTAIN:
        start = replace(start, method="tangency")
        return certain(refine_tangents(start, motion1, motion2, rig))

    # The mean of a large or odd object's events may be too uncertain for a pose, and still be a
    # start.
    search = replace(ssac(cam1, cam2, rig, config), method="tangency")
    fit = partial(refine, motion1=motion1, motion2=motion2, rig=rig, config=config)
    if search.status not in ("ok", *POSE_IS_OPEN):
        repeats = len(returns_s(motion1, view_of(motion1), np.inf)) > 0
        if repeats or len(search.alternatives_s) == 0:  # the motion leaves the offset open
            return replace(start, method="tangency")

        def fit_outline(estimate: Estimate) -> Estimate:
            return refine_tangents(fit(estimate), motion1, motion2, rig)

        told = settled(
            search, fit_outline, motion1, motion2, rig, config, measure=lambda found: found.d_avg_px
        )
        return told if told.status == "ok" else replace(start, method="tangency")

    mean = settled(search, fit, motion1, motion2, rig, config, judge=lambda found: found)
    outline = certain(refine_tangents(mean, motion1, motion2, rig))
    strays_s = abs(outline.t_d_s - start.t_d_s)
    if outline.status != "ok" or strays_s > _MAX_SIGMAS * start.t_d_std_s:
        return replace(start, method="tangency")
    return outline


def tangency_known_from(
    start: Estimate,
    cam1: Observation,
    cam2: Observation,
    rig: Rig,
    config: Config | None = None,
) -> Estimate:
    """As `tangency_known`, given what `joint_known` found with the same arguments."""
    motion1, motion2 = object_motions(cam1, cam2, rig, checked(config))
    start = replace(start, method="tangency-known")
    return certain(refine_tangents(start, motion1, motion2, rig, pose_is_known=True))


def refine_tangents(
    start: Estimate,
    motion1: ObjectMotion,
    motion2: ObjectMotion,
    rig: Rig,
    pose_is_known: bool = False,
    config: TangencyConfig | None = None,
) -> Estimate:
    """Find tangents and refine offset and pose by turns, from an estimate.

    Parameters
    ----------
    start
        Offset and pose; returned as it is when its status is not "ok".
    motion1, motion2, rig
        As for `ssac.methods.algorithms.algorithm_2`.
    pose_is_known
        Only t_d is refined, and there is a `t_d_std_s` but no `covariance`.
    config
        Parameters; the defaults when None.
    """
    config = config or TangencyConfig()
    if start.status != "ok" or start.R is None or start.t is None:
        return start
    free = slice(0, 1) if pose_is_known else slice(0, 6)
    parameters = Parameters(start.t_d_s, start.R, start.t)
    near: list[list[OutlineEvents]] | None = None
    is_far = True  # as the start may be
    times_s = _sample_times(motion1, motion2, start.t_d_s, config.step_s)
    for _ in range(_ROUNDS):
        before = parameters
        pairs, near = tangents_under(
            before, motion1, motion2, times_s, rig, config, None if is_far else near
        )
        if len(pairs.times_s) < MIN_PAIRS:
            reason = (
                f"only {len(pairs.times_s)} tangents are seen in both views, and {MIN_PAIRS} are"
                " needed: the object is too small for an outline, take `joint`"
            )
            return replace(start, status="too_few_samples", reason=reason)
        cauchy = config.wider_cauchy if is_far else config.cauchy
        for _ in range(_STEPS):
            parameters = _stepped(parameters, pairs, before.t_d_s, rig, free, cauchy)
        if abs(parameters.t_d_s - start.t_d_s) > _MAX_SHIFT_S:
            reason = f"tangency moved t_d from {start.t_d_s:.4f} to {parameters.t_d_s:.4f} s"
            return replace(start, status="no_convergence", reason=reason)
        if not is_far and _are_near(before, parameters):
            break
        is_far = not _are_near(before, parameters, _FAR)

    residuals = linearise(parameters, pairs, parameters.t_d_s - before.t_d_s, rig)
    covariance = covariance_of(residuals, free, config.cauchy)
    if pose_is_known:  # a free pose takes it away
        covariance = covariance + mapped_covariance(
            residuals.jacobian[:, free],
            lasting_share(motion1, motion2, parameters.t_d_s, _N_OF_SHARE) * _hidden_errors(pairs),
        )
    F = fundamental_from_pose(rig.cam1.K, rig.cam2.K, parameters.R, parameters.t)
    return refined_estimate(start, parameters, residuals, covariance, F)


def tangents_under(
    parameters: Parameters,
    motion1: ObjectMotion,
    motion2: ObjectMotion,
    times_s: Array,
    rig: Rig,
    config: TangencyConfig,
    near: list[list[OutlineEvents]] | None = None,
) -> tuple[SharpPairs, list[list[OutlineEvents]]]:
    """Find and pair the tangents of both views under an offset and a pose.

    Parameters
    ----------
    parameters, motion1, motion2, rig, config
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
    views = list(
        zip(
            (motion1, motion2),
            pencils(parameters.R, parameters.t, rig.cam1.K, rig.cam2.K),
            (times_s, times_s + parameters.t_d_s),
            strict=True,
        )
    )
    if near is None:
        near = [near_outline(*view, config.outline) for view in views]
    found = [
        tangents(motion, events, pencil, clock_s, config.outline)
        for (motion, pencil, clock_s), events in zip(views, near, strict=True)
    ]
    return tangent_pairs(times_s, found[0], found[1], config), near


def tangent_pairs(
    times_s: Array, view1: list[Tangents], view2: list[Tangents], config: TangencyConfig
) -> SharpPairs:
    """Pair the tangents of each side, sampled at the same n instants, where both are valid.

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
    return SharpPairs(
        np.concatenate([times_s[k] for k in both]),
        np.concatenate([one.points_px[k] for (one, _), k in zip(sides, both, strict=True)]),
        np.concatenate([two.points_px[k] for (_, two), k in zip(sides, both, strict=True)]),
        np.concatenate([two.velocities_px_s[k] for (_, two), k in zip(sides, both, strict=True)]),
        np.median(errors_px) / errors_px if len(errors_px) else errors_px,
    )


def _hidden_errors(pairs: SharpPairs) -> Array:
    """Give the changes (n, 2) of the residuals by such an error of the upper and lower tangents."""
    starts = np.concatenate([[0], np.flatnonzero(np.diff(pairs.times_s) < 0.0) + 1])
    side = np.searchsorted(starts, np.arange(len(pairs.times_s)), side="right") - 1
    of_side = (side[:, None] == np.arange(len(starts))).astype(np.float64)
    return np.asarray(HIDDEN_PX * pairs.weights[:, None] * of_side)


def _midway(upper: Tangents, lower: Tangents) -> Tangents:
    return Tangents(
        0.5 * (upper.points_px + lower.points_px),
        0.5 * (upper.velocities_px_s + lower.velocities_px_s),
        np.hypot(upper.spreads_px, lower.spreads_px),
        upper.valid & lower.valid,
    )


def _sample_times(
    motion1: ObjectMotion, motion2: ObjectMotion, t_d_s: float, step_s: float
) -> Array:
    """Even times [s] of camera 1's clock that both recordings cover."""
    (start1, end1), (start2, end2) = motion1.span_s, motion2.span_s
    start, end = max(start1, start2 - t_d_s), min(end1, end2 - t_d_s)
    return np.asarray(start + step_s * np.arange(max(int((end - start) / step_s), 2)))


def _stepped(
    parameters: Parameters,
    pairs: SharpPairs,
    sampled_t_d_s: float,
    rig: Rig,
    free: slice,
    cauchy: float,
) -> Parameters:
    """Take one Gauss-Newton step of the robust least squares on pairs sampled at one offset."""
    residuals = linearise(parameters, pairs, parameters.t_d_s - sampled_t_d_s, rig)
    J, distances_px = residuals.jacobian[:, free], residuals.distances_px
    weights, _ = cauchy_weights(distances_px, cauchy)
    step = np.zeros(6)
    step[free] = -np.linalg.pinv(J.T @ (weights[:, None] * J)) @ (J.T @ (weights * distances_px))
    return moved(parameters, step)


def _are_near(one: Parameters, other: Parameters, factor: float = 1.0) -> bool:
    """Whether the changes from one to the other are at most `factor` times the last ones."""
    turn = np.linalg.norm(other.R - one.R) + np.linalg.norm(other.t - one.t)
    shift_s = abs(other.t_d_s - one.t_d_s)
    return bool(shift_s <= factor * _LAST_SHIFT_S and turn <= factor * _LAST_TURN)
