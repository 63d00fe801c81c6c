"""A refinement's pairs and its solution in; where camera 2's clock jumps, if it does, out.

A step of the offset is tried at every second: one more column of the same least squares, so that
neither the pose nor the skew, which a jump bends as well, hides it. Where the best one is beyond
chance it is solved for, and moved to the instant from which on the later offset fits better.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ssac.clock import PPM
from ssac.estimate import ClockJump, Estimate, Refusal, Status
from ssac.fit.least_squares import covariance_of, solve, weighed_system
from ssac.fit.problem import Column, Parameters, Problem, linearise
from ssac.geometry.robust import CAUCHY, robust_deviation
from ssac.methods.clock_model import ClockModel
from ssac.methods.verdict import refused

Array = NDArray[np.float64]

MIN_SIGMAS = 6.0
"""A step is a jump from so many of its deviations on; in 80 ordinary flights it has 4.7 at most."""

LESS_SIGMAS = 4.5
"""The same where the fit's skew is `FAR` deviations of its prior or more: a jump bends it so."""

FAR = 3.0

MIN_SIZE_S = 0.002
"""Smallest jump that is told: an object's bias makes smaller ones of its own."""

_STEP_S = 1.0  # between instants that are tried
_MARGIN_S = 2.0  # from both ends: a bias does not average out in less
_MAX_TRIED = 200
_NEAR_S = 2.0  # of the best of these, the jump is looked for closely
_ROUNDS = 3


def checked_clock(
    estimate: Estimate, model: ClockModel, problem: Problem, parameters: Parameters
) -> Estimate:
    """Refuse an estimate where camera 2's clock jumps.

    Parameters
    ----------
    estimate
        Refined; returned as it is when no jump shows.
    model
        Of its clock.
    problem, parameters
        Its last one, and the solution.
    """
    problem = replace(problem, turn=CAUCHY)  # a jump is no outlier
    at_s = _likely(problem, parameters)
    if at_s is None:
        return estimate
    with_step = problem
    start = parameters
    for _ in range(_ROUNDS):
        with_step = _stepped(problem, at_s)
        found = solve(with_step, start).parameters
        start = replace(found, columns=np.append(found.columns[:-1], 0.0))
        moved_to_s = _instant(with_step, found, at_s)
        if moved_to_s == at_s:
            break
        at_s = moved_to_s
    size_s = float(found.columns[-1])
    covariance = covariance_of(with_step, linearise(with_step, found))
    std_s = float(np.sqrt(covariance[-1, -1]))
    is_far = abs(estimate.skew_ppm) * PPM >= FAR * np.min(model.deviations[:1], initial=np.inf)
    least = LESS_SIGMAS if is_far else MIN_SIGMAS
    if abs(size_s) < max(MIN_SIZE_S, least * std_s):
        return estimate
    before_s = float(model.clock(found).cam2_from_cam1(at_s)) - at_s
    jump = ClockJump(at_s, size_s, std_s, before_s, before_s + size_s)
    reason = (
        f"camera 2's clock jumps by {1e3 * size_s:+.1f} ms (1 sigma {1e3 * std_s:.1f} ms) at"
        f" {at_s:.2f} s of camera 1's clock: t_d is {1e3 * jump.before_s:.1f} ms before and"
        f" {1e3 * jump.after_s:.1f} ms after; cut the recordings there,"
        " or give --clock pieces if it rather wanders"
    )
    return replace(refused(estimate, Refusal(Status.CLOCK_JUMP, reason)), jump=jump)


def _likely(problem: Problem, parameters: Parameters) -> float | None:
    """Find the instant [s] where a step tells most; None where it would be no jump in any case.

    Errors that are correlated in time make a step's deviation larger than it is taken for here.
    """
    residuals = linearise(problem, parameters)
    times_s = residuals.times_s
    first_s, last_s = float(np.min(times_s)) + _MARGIN_S, float(np.max(times_s)) - _MARGIN_S
    if not last_s > first_s:
        return None
    n = min(int((last_s - first_s) / _STEP_S) + 1, _MAX_TRIED)
    tried_s = np.linspace(first_s, last_s, n)
    system, target = weighed_system(problem, parameters, residuals)
    left = -target
    # A step moves the later pairs as the offset, the first of the parameters, does, and no prior.
    steps: Array = np.zeros((len(system), n))
    steps[: len(times_s)] = system[: len(times_s), :1] * (times_s[:, None] >= tried_s)
    Q = np.linalg.qr(system)[0]
    steps = steps - Q @ (Q.T @ steps)
    norms = np.maximum(np.linalg.norm(steps, axis=0), 1e-9 * np.linalg.norm(left) + 1e-300)
    gains_px = np.abs(left @ steps) / norms
    best = int(np.argmax(gains_px))
    scale_px = robust_deviation(residuals.distances_px)
    is_large = gains_px[best] > LESS_SIGMAS * scale_px
    return float(tried_s[best]) if is_large else None


def _stepped(problem: Problem, at_s: float) -> Problem:
    """Add a step of the offset from an instant on, as the last column."""
    pairs = problem.pairs
    later = (pairs.times_s >= at_s)[:, None]
    step = Column(np.zeros_like(pairs.p1_px), later * pairs.v2_px_s, is_of_clock=True)
    return replace(problem, columns=(*problem.columns, step))


def _instant(problem: Problem, found: Parameters, at_s: float) -> float:
    """Find the time [s] from which on the offset after a step fits the pairs better."""
    others, size_s = found.columns[:-1], found.columns[-1]
    everywhere = replace(problem, columns=(*problem.columns[:-1], _all_along(problem)))
    without, with_it = (
        linearise(everywhere, replace(found, columns=np.append(others, step_s)))
        for step_s in (0.0, size_s)
    )
    first_s, last_s = np.min(without.times_s) + _MARGIN_S, np.max(without.times_s) - _MARGIN_S
    inside = np.abs(without.times_s - at_s) <= _NEAR_S
    inside &= (without.times_s >= first_s) & (without.times_s <= last_s)
    order = np.argsort(without.times_s[inside], kind="stable")
    left_px = [one.distances_px[inside][order] for one in (without, with_it)]
    scale_px = robust_deviation(linearise(problem, found).distances_px)
    losses = [np.log1p((left / max(scale_px, 1e-12)) ** 2) for left in left_px]
    total = np.concatenate([[0.0], np.cumsum(losses[0] - losses[1])])
    times_s = without.times_s[inside][order]
    return float(times_s[min(int(np.argmin(total)), len(times_s) - 1)]) if len(times_s) else at_s


def _all_along(problem: Problem) -> Column:
    pairs = problem.pairs
    return Column(np.zeros_like(pairs.p1_px), pairs.v2_px_s, is_of_clock=True)
