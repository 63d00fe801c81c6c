"""Two tracks along straight lines in, the time offset out, and the pose refused.

A line in space leaves the epipolar constraint nothing to say: F = l2 a' + b l1' takes every point
of the track's line l1 to the line l2, at any offset. But the two images of the line are related by
a projectivity of one dimension, s2(t + t_d) = (a s1(t) + b) / (c s1(t) + 1) with the distances s
along the lines, and that holds at the true offset only, as long as the speed varies: at a uniform
speed position is itself a projectivity of time, and so is any delayed one.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ssac.estimate import Estimate, Status
from ssac.geometry.fundamental import MIN_PAIRS
from ssac.geometry.robust import cauchy_weights
from ssac.methods.verdict import offset_estimate, refused
from ssac.search.observability import ambiguous_offset, coarsest_step, no_match, valleys
from ssac.search.offset_search import candidate_offsets, coarse_to_fine_search, exhaustive_search
from ssac.search.two_views import TwoViews
from ssac.search.view import View

Array = NDArray[np.float64]

_STRETCH_S = 0.5  # residuals of two such stretches are taken as independent
_ITERATIONS = 8
_LAST_SHIFT_S = 1e-6
_ALL_OF_THE_POSE = np.eye(6)[1:]


@dataclass(frozen=True)
class _Line:
    """Positions along both lines, in one unit, at n instants."""

    times_s: Array  # (n,)
    s1: Array  # (n,)
    s2: Array  # (n,)
    speeds2: Array  # (n,) of s2 [1/s]
    scale_px: float  # of the unit


def straight_path(method: str, views: TwoViews, lines: tuple[View, View]) -> Estimate:
    """Time offset of an object on a straight line; its pose is open.

    Parameters
    ----------
    method
        Name for the estimate.
    views
        Both views.
    lines
        The same summed up, and straight.

    Returns
    -------
    Estimate
        "degenerate_pose" with `t_d_s` and `t_d_std_s`, or why there is no offset either.
    """

    def cost_px(t_d_s: Array) -> Array:
        sampled = (_sampled(lines, views, offset_s) for offset_s in t_d_s)
        return np.array([np.nan if line is None else _misfit_px(line) for line in sampled])

    candidates_s = candidate_offsets(views)
    search = (
        exhaustive_search(cost_px, candidates_s)
        if views.config.exhaustive
        else coarse_to_fine_search(cost_px, cost_px, candidates_s, coarsest_step(lines))
    )
    estimate = offset_estimate(method, search, views)
    if estimate.status != Status.OK:
        return estimate
    found = valleys(estimate.candidates_s, estimate.costs, estimate.t_d_s)
    misfit_px = float(cost_px(np.array([estimate.t_d_s]))[0])
    refusal = no_match(misfit_px, views.object_px) or ambiguous_offset(
        found, views.config.max_valley_s
    )
    if refusal is not None:
        return refused(estimate, refusal, found)
    t_d_s, std_s, n_samples = _refined(lines, views, estimate.t_d_s)
    return replace(
        estimate,
        status=Status.DEGENERATE_POSE,
        reason="the object flies along a straight line, which leaves the pose open; the offset is"
        " from its speed along the line",
        t_d_s=t_d_s,
        t_d_std_s=std_s,
        unobservable=_ALL_OF_THE_POSE,
        n_samples=n_samples,
        d_avg_px=misfit_px,
    )


def _sampled(lines: tuple[View, View], views: TwoViews, t_d_s: float) -> _Line | None:
    """Sample the valid pairs' positions along the lines; None when they are too few."""
    pairs = views.pairs_at(t_d_s)
    if len(pairs) < MIN_PAIRS:
        return None
    scale_px = float(np.hypot(lines[0].length_px, lines[1].length_px))
    velocities = views.motion2.velocities_at(views.on_clock_2(pairs.times_s, t_d_s))
    return _Line(
        pairs.times_s,
        (pairs.p1_px - lines[0].middle_px) @ lines[0].direction / scale_px,
        (pairs.p2_px - lines[1].middle_px) @ lines[1].direction / scale_px,
        np.nan_to_num(velocities @ lines[1].direction) / scale_px,
        scale_px,
    )


def _fit(line: _Line) -> Array:
    """Fit (a, b, c) of the projectivity by reweighted least squares."""
    x, y = line.s1, line.s2
    system = np.column_stack([x, np.ones(len(x)), -x * y])  # y = a x + b - c x y
    weights: Array = np.ones(len(x))
    fitted: Array = np.zeros(3)
    for _ in range(_ITERATIONS):
        fitted = np.asarray(np.linalg.lstsq(system * weights[:, None], y * weights)[0], np.float64)
        residuals, norms = _residuals(fitted, x, y)
        weights = np.sqrt(cauchy_weights(residuals)[0]) / norms
    return np.asarray(fitted)


def _residuals(fitted: Array, x: Array, y: Array) -> tuple[Array, Array]:
    """Distances (n,) from the projectivity to first order, and the norms that they were over."""
    a, b, c = fitted
    norms = np.sqrt((c * x + 1.0) ** 2 + (c * y - a) ** 2) + 1e-12
    return (y * (c * x + 1.0) - a * x - b) / norms, norms


def _misfit_px(line: _Line) -> float:
    """Mean distance from the projectivity that fits best [px]."""
    return float(np.mean(np.abs(_residuals(_fit(line), line.s1, line.s2)[0]))) * line.scale_px


def _refined(lines: tuple[View, View], views: TwoViews, t_d_s: float) -> tuple[float, float, int]:
    """Refine t_d and the projectivity together; t_d and its deviation [s], and the pairs.

    The deviation is from the gradients' sums over stretches of time, as residuals within one are
    not independent.
    """
    std_s, n_pairs = np.nan, 0
    for _ in range(_ITERATIONS):
        line = _sampled(lines, views, t_d_s)
        if line is None:
            break
        n_pairs = len(line.times_s)
        fitted = _fit(line)
        residuals, norms = _residuals(fitted, line.s1, line.s2)
        weights = cauchy_weights(residuals)[0]
        rates = (fitted[2] * line.s1 + 1.0) * line.speeds2
        ones = np.ones(len(rates))
        jacobian = np.column_stack([rates, -line.s1, -ones, line.s1 * line.s2]) / norms[:, None]
        inverse = np.linalg.pinv(jacobian.T @ (weights[:, None] * jacobian))
        gradients = jacobian * (weights * residuals)[:, None]
        shift_s = -float((inverse @ np.sum(gradients, axis=0))[0])
        stretches = np.unique(np.floor(line.times_s / _STRETCH_S), return_inverse=True)[1]
        sums = np.zeros((stretches.max() + 1, 4))
        np.add.at(sums, stretches, gradients)
        freedom = max(len(sums) - 4, 1)
        variance = (inverse @ sums.T @ sums @ inverse)[0, 0] * len(sums) / freedom
        std_s = float(np.sqrt(variance))
        t_d_s += shift_s
        if abs(shift_s) < _LAST_SHIFT_S:
            break
    return t_d_s, std_s, n_pairs
