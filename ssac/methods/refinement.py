"""The refinement of offset and pose by robust least squares, for pairs of any kind.

Pairs are sampled with the parameters of an estimate, the problem is solved, and pairs are sampled
anew with its solution, until that settles. Subclasses in `joint` and `tangency` define what pairs
are and when a solution has settled.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ssac.arrays import Array
from ssac.estimate import Estimate, Status
from ssac.fit.intrinsics import (
    Allowance,
    evidence,
    intrinsics_of,
    questioned,
    turned_by_focals,
    wanted,
)
from ssac.fit.least_squares import Parameters, Problem, Residuals, Solution, WeighedPairs, linearise
from ssac.geometry.epipolar import CAUCHY, fundamental_from_pose, sampson_derivative
from ssac.geometry.pose import homography_poses, rays_of
from ssac.methods.algorithms import with_fit
from ssac.methods.clocks import checked_clock, clock_model
from ssac.methods.verdict import doubt
from ssac.search.two_views import TwoViews


@dataclass(frozen=True)
class Round:
    """Pairs that were sampled with some parameters, and the solution of their problem."""

    number: int
    seen: TwoViews  # under the clock and with the readouts of the parameters
    before: Parameters
    problem: Problem
    found: Solution

    @property
    def shift_s(self) -> float:
        """Absolute change [s] of the offset in this round."""
        return abs(self.found.parameters.t_d_s - self.before.t_d_s)


class Refinement(ABC):
    """Rounds of sampling pairs and solving for offset, pose, clock, readouts and intrinsics."""

    max_rounds: int
    size_px: float  # rms size of the object's images, both together
    turn = last_turn = CAUCHY  # scale of the loss: in a round, and for the result
    lessens = True  # as for `correlated_covariance`

    def __init__(self, start: Estimate, views: TwoViews) -> None:
        self.start, self.views, self.rules = start, views, views.rules
        self.model = clock_model(views, start)
        self.allowance = Allowance(views.rig, self.model.has_priors)
        self.solving: dict[str, Any] = {}  # options of `solve` in a round

    @abstractmethod
    def pairs(self, seen: TwoViews, parameters: Parameters) -> WeighedPairs:
        """Sample pairs with some parameters; `seen` are the views with their clock and readouts."""

    @abstractmethod
    def unseen(self, n_pairs: int, parameters: Parameters) -> Estimate:
        """Return the refusal of parameters with which too few pairs are sampled."""

    @abstractmethod
    def settles(self, last: Round) -> bool:
        """Whether a round changed next to nothing; asked once the allowance is complete."""

    @abstractmethod
    def refused(self, last: Round) -> Estimate | None:
        """Return a refusal after a round; or prepare the next round and return None."""

    @abstractmethod
    def hidden_px(self, last: Round, residuals: Residuals) -> Array:
        """Return the distances' changes (n, m) by 1 sigma of m errors that no residual shows."""

    def estimate(self, R: Array, t: Array) -> Estimate:
        """Refine offset and pose; with a known pose the offset alone, without `covariance`."""
        start, views, model = self.start, self.views, self.model
        parameters = Parameters(start.t_d_s, R, t, model.start(start))
        for number in range(self.max_rounds):
            before, seen = parameters, model.views(views, parameters)
            pairs = self.pairs(seen, before)
            if len(pairs.times_s) < self.rules.search.min_pairs:
                return self.unseen(len(pairs.times_s), before)
            plain = Problem(pairs, views.rig, self.rules.fit, views.pose_is_known, turn=self.turn)
            problem = self.allowance.added(model.problem(plain, before, seen))
            found = model.solve(problem, before, **self.solving)
            last, parameters = Round(number, seen, before, problem, found), found.parameters
            most_s = self.rules.joint.max_shift_s
            if abs(parameters.t_d_s - start.t_d_s) > most_s:
                why = f"{self.moved(parameters)}, further than {1e3 * most_s:.0f} ms"
                return self.no_convergence(why)
            settles = self.allowance.is_made and self.settles(last)
            if settles:
                break
            refused = self.refused(last)
            if refused is not None:
                return refused
        residuals = linearise(replace(problem, turn=self.last_turn), parameters)
        hidden_px = self.hidden_px(last, residuals)
        covariance = residuals.covariance(self.lessens, cautious=True)
        covariance = covariance + residuals.hidden_covariance(hidden_px)
        unfinished = [] if settles else [found.change]
        unfinished += [] if found.converged else [found.last_step]
        # An unfinished iteration serves if its last change is small beside the deviations.
        most, free = self.rules.fit.max_last_change * np.sqrt(np.diag(covariance)), problem.free
        if any(np.any(np.abs(change[free]) > most) for change in unfinished):
            reason = f"after {self.max_rounds} rounds the refinement from {start.t_d_s:.3f} s"
            return self.no_convergence(f"{reason} still moved")
        told = model.told(start, residuals, covariance)
        return checked_clock(self._told(told, residuals, covariance, hidden_px), model, residuals)

    def _is_flat(self, residuals: Residuals) -> bool:
        """Whether the pairs lie in a plane, so that they tell nothing of intrinsics."""
        rig = residuals.problem.rig
        rays = rays_of(rig.cam1.K, residuals.p1_px), rays_of(rig.cam2.K, residuals.p2_px)
        distance_px = homography_poses(*rays)[0] * rig.cam2.K[0, 0]
        return bool(distance_px <= self.rules.hypotheses.flat * self.size_px)

    def no_convergence(self, reason: str) -> Estimate:
        """Refuse the start with the status "no_convergence"."""
        return self.start_refused(Status.NO_CONVERGENCE, reason)

    def start_refused(self, status: Status, reason: str) -> Estimate:
        """Refuse the start, which then has no pose."""
        return replace(self.start, status=status, reason=reason, R=None, t=None, covariance=None)

    def moved(self, parameters: Parameters) -> str:
        """Say by how much the refinement moved the offset."""
        return f"the refinement moved t_d from {self.start.t_d_s:.3f} to {parameters.t_d_s:.3f} s"

    def _told(
        self, start: Estimate, residuals: Residuals, covariance: Array, hidden_px: Array
    ) -> Estimate:
        """Add the parameters found, and the covariance of the free ones, to the start."""
        problem, parameters = residuals.problem, residuals.parameters
        fitted = with_fit(start, residuals.F, residuals.p1_px, residuals.p2_px)
        Ks = intrinsics_of(problem, parameters)
        F = fundamental_from_pose(*Ks, parameters.R, parameters.t)
        rules, asked = self.rules.verdict, questioned(residuals)
        against = evidence(asked, hidden_px)
        if against > rules.in_doubt and self._is_flat(residuals):
            against = 0.0  # any intrinsics fit a path in a plane, each with its pose
        misfit = wanted(asked) if against > rules.in_doubt else ""
        return replace(
            fitted,
            F=F / np.linalg.norm(F),
            t_d_s=parameters.t_d_s,
            t_d_std_s=float(np.sqrt(covariance[0, 0])),
            R=parameters.R,
            t=parameters.t,
            covariance=None if problem.pose_is_known else covariance[:6, :6],
            per_focal_deg=np.degrees(turned_by_focals(residuals)),
            Ks=Ks,
            against=against,
            against_skew=self.model.against(residuals, hidden_px),
            misfit=misfit,
            doubt=doubt(
                residuals.distances_px,
                self.size_px,
                rules,
                against,
                misfit,
                self.views.rig.is_exact,
            ),
        )


def smooth_errors(residuals: Residuals, size_px: float, offset: float, slope: float) -> Array:
    """Return the changes (n, 12) of the distances by a deviation of each part of both views' bias.

    The point of the object that positions show moves smoothly with the image position. A change of
    pose can compensate for this, so that no residual shows it. The deviations, in sizes of the
    object, are `slope` per unit of x / z and of y / z, and `offset`. Distances are not weighted.
    """
    F, p1_px, p2_px, rig = residuals.F, residuals.p1_px, residuals.p2_px, residuals.problem.rig
    parts = []
    for F_there, there, here, K in ((F.T, p2_px, p1_px, rig.cam1.K), (F, p1_px, p2_px, rig.cam2.K)):
        shifts = size_px * rays_of(K, here) * (slope, slope, offset)
        for axis in np.eye(2):
            along = np.tile(axis, (len(here), 1))
            by_shift = sampson_derivative(F_there, there, here, along)
            parts.append(by_shift[:, None] * shifts)
    return np.hstack(parts)
