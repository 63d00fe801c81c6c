"""The robust least-squares problem that every refinement minimises, and its solver.

The parameters are, in the order of Jacobians and covariances: t_d [s]; the five small changes [rad]
of the pose that `ssac.geometry.pose` defines; then one for each `Column` of the problem, such as a
clock's rate or a focal length.

The residuals are signed Sampson distances [px] of pairs, times the pairs' weights, under Cauchy's
loss, and one more for each prior. Pairs are sampled at one offset and moved on by the velocity of
p2 as the parameters change the offset: the caller samples anew until nothing changes.
"""

from dataclasses import dataclass, field, replace

import numba
import numpy as np

from ssac.arrays import Array, Indices
from ssac.camera import Rig
from ssac.fit import covariance
from ssac.geometry import epipolar
from ssac.geometry.pose import moved_pose, pose_jacobian
from ssac.rules import FitRules

T_D, FIRST_COLUMN = 0, 6
"""Places of the offset and of the first column's value; the pose's five changes stand between."""


@dataclass(frozen=True)
class Parameters:
    """Offset, pose and what else is estimated: x2 = R x1 + t and t_cam2 = t_cam1 + t_d."""

    t_d_s: float
    R: Array  # (3, 3)
    t: Array  # (3,) length 1
    columns: Array = field(default_factory=lambda: np.empty(0))  # (k,) values, in their units


@dataclass(frozen=True)
class WeighedPairs:
    """The object in both views at n instants, one offset apart."""

    times_s: Array  # (n,) camera 1's clock
    p1_px: Array  # (n, 2)
    p2_px: Array  # (n, 2)
    v2_px_s: Array  # (n, 2) velocity of p2
    weights: Array  # (n,) factors of the distances, with a median of 1
    t_d_s: float  # offset at which p2 was sampled
    kinds: Indices | None = None  # (n,) from 0 on, kinds of errors; None: all are of one kind


@dataclass(frozen=True)
class Column:
    """One more parameter, which moves the points in proportion to its value.

    A clock that runs fast by the share r moves p2 by r (t - t_ref) v2.
    """

    dp1_px: Array  # (n, 2) for a value of one
    dp2_px: Array  # (n, 2)
    at: float = 0.0  # value with which the points were sampled
    is_of_clock: bool = False  # a change of what camera 2's clock shows, as the offset is
    is_of_camera: bool = False  # an uncertain intrinsic of a camera
    # (4,) shares by which a value of one shrinks axes u and v of images 1 and 2. Distances are in
    # pixels as measured: in shrunk ones, any longer focal length would fit better.
    shrinks: Array = field(default_factory=lambda: np.zeros(4))


@dataclass(frozen=True)
class Prior:
    """A Gaussian prior of one parameter."""

    place: int  # from FIRST_COLUMN on
    value: float
    deviation: float  # in the parameter's unit
    scale_px: float = np.nan  # residual that a deviation counts as; NaN: an independent one


@dataclass(frozen=True)
class Problem:
    """A least-squares problem: its pairs, parameters, priors and loss."""

    pairs: WeighedPairs
    rig: Rig
    rules: FitRules
    pose_is_known: bool = False  # it is held fixed
    columns: tuple[Column, ...] = ()
    priors: tuple[Prior, ...] = ()
    turn: float = epipolar.CAUCHY  # scale of the loss, in robust standard deviations

    @property
    def size(self) -> int:
        """Number of all parameters, those of a known pose included."""
        return FIRST_COLUMN + len(self.columns)

    @property
    def free(self) -> Indices:
        """Places of the parameters that are estimated."""
        places = np.arange(self.size)
        return np.delete(places, slice(T_D + 1, FIRST_COLUMN)) if self.pose_is_known else places

    @property
    def of_clock(self) -> list[int]:
        """Places of the parameters of camera 2's clock."""
        more = [k for k, column in enumerate(self.columns, FIRST_COLUMN) if column.is_of_clock]
        return [T_D, *more]

    @property
    def n_of_cameras(self) -> int:
        """Number of columns of intrinsics, which are the last ones."""
        return sum(column.is_of_camera for column in self.columns)


@dataclass(frozen=True)
class Residuals:
    """Residuals of a problem's n pairs at p parameters, f of them free, with q priors."""

    problem: Problem
    parameters: Parameters
    F: Array  # (3, 3) of the parameters' pose
    p1_px: Array  # (n, 2) as the parameters move them
    p2_px: Array  # (n, 2) likewise
    distances_px: Array  # (n,) signed, times the pair's weight, whose median is 1
    jacobian: Array  # (n, p) [px per unit of the parameter]

    @property
    def weights(self) -> tuple[Array, Array]:
        """The loss's first derivative divided by the residual, and second derivative: (n,) each."""
        return epipolar.cauchy_weights(self.distances_px, self.problem.turn)

    @property
    def free(self) -> Array:
        """Derivatives (n, f) by the free parameters."""
        return self.jacobian[:, self.problem.free]

    def system(self) -> tuple[Array, Array]:
        """Return the next step's rows (n + q, f), pairs before priors, and its target (n + q,)."""
        root_weights, columns = np.sqrt(self.weights[0]), self.parameters.columns
        system = root_weights[:, None] * self.free
        target = -root_weights * self.distances_px
        priors = self.problem.priors
        off = np.array([prior.value - columns[prior.place - FIRST_COLUMN] for prior in priors])
        rows, counts = self._priors()
        return np.vstack([system, rows]), np.append(target, counts * off)

    def covariance(self, lessens: bool = True, cautious: bool = False) -> Array:
        """Covariance (f, f) of the free parameters, by `correlated_covariance`."""
        problem, (weights, curvatures) = self.problem, self.weights
        deviations = np.full(problem.size, covariance.PRIOR)
        scales_px = np.full(problem.size, np.nan)
        for prior in problem.priors:
            deviations[prior.place], scales_px[prior.place] = prior.deviation, prior.scale_px
        return covariance.correlated_covariance(
            problem.pairs.times_s,
            self.free,
            weights * self.distances_px,
            curvatures,
            problem.rules,
            deviations[problem.free],
            scales_px[problem.free],
            np.flatnonzero([place in problem.of_clock for place in problem.free]),
            lessens,
            cautious,
            problem.pairs.kinds,
        )

    def hidden_covariance(self, errors_px: Array) -> Array:
        """Covariance (f, f) of the free parameters due to errors that no residual shows.

        One deviation of each error changes the distances by its column of `errors_px` (n, m).
        """
        rows, _ = self._priors()
        errors_px = np.vstack([errors_px, np.zeros((len(rows), errors_px.shape[1]))])
        moved = np.linalg.lstsq(np.vstack([self.free, rows]), errors_px)[0]
        return np.asarray(moved @ moved.T)

    def fair_scales(self) -> Array:
        """Return the residual (f,) [px] as which a prior deviation of each free parameter counts.

        With these scales a prior and the data, whose errors are correlated, are weighted by their
        variances. The problem's own priors are left out.
        """
        plain = replace(self, problem=replace(self.problem, priors=()))
        variances, rules = np.diag(plain.covariance()), self.problem.rules
        curvatures = self.weights[1]
        Q, triangle = np.linalg.qr(self.free)
        curvature = covariance.mean_curvature(curvatures, rules)
        inverse = covariance.bounded_inverse(Q.T @ (curvatures[:, None] * Q), curvature, rules)
        back = np.linalg.pinv(triangle)
        independent = np.einsum("ij,jk,ik->i", back, inverse, back)  # variances, if errors are 1 px
        return np.asarray(np.sqrt(variances / np.maximum(independent, np.finfo(np.float64).tiny)))

    def _priors(self) -> tuple[Array, Array]:
        """Return the priors' rows (q, f) of the system, and the residual per unit of each (q,)."""
        problem, priors = self.problem, self.problem.priors
        places = np.array([prior.place for prior in priors], np.intp)
        deviations = np.array([prior.deviation for prior in priors])
        scales_px = np.array([prior.scale_px for prior in priors])
        independent = epipolar.robust_deviation(self.distances_px)
        counts = np.where(np.isfinite(scales_px), scales_px, independent) / deviations
        return np.eye(problem.size)[places][:, problem.free] * counts[:, None], counts


def linearise(problem: Problem, parameters: Parameters) -> Residuals:
    """Residuals at some parameters, and their exact derivatives."""
    pairs, K1, K2 = problem.pairs, problem.rig.cam1.K, problem.rig.cam2.K
    R, t = parameters.R, parameters.t
    p1, p2 = pairs.p1_px, pairs.p2_px + (parameters.t_d_s - pairs.t_d_s) * pairs.v2_px_s
    for column, value in zip(problem.columns, parameters.columns, strict=True):
        value -= column.at
        p1, p2 = p1 + value * column.dp1_px, p2 + value * column.dp2_px
    F = epipolar.fundamental_from_pose(K1, K2, R, t)
    shrinks = np.array([column.shrinks for column in problem.columns]).reshape(-1, 4)
    size1, size2 = np.split(1.0 - parameters.columns @ shrinks, 2)  # of both images' axes
    F_own, own1, own2 = F, p1 / size1, p2 / size2  # in pixels as measured
    if shrinks.any():
        K1, K2 = K1 / np.append(size1, 1.0)[:, None], K2 / np.append(size2, 1.0)[:, None]
        F_own = epipolar.fundamental_from_pose(K1, K2, R, t)
    distances_px = epipolar.sampson_distance(F_own, own1, own2)
    dp2 = np.stack([pairs.v2_px_s, *(column.dp2_px for column in problem.columns)]) / size2
    by_others = epipolar.sampson_derivative(F_own, own1, own2, dp2)
    if problem.columns:
        dp1 = np.stack([column.dp1_px for column in problem.columns]) / size1
        by_others[1:] += epipolar.sampson_derivative(F_own.T, own2, own1, dp1)
    if shrinks.any():  # the lines' lengths, by which products are divided, change too
        lines = [own2 @ F_own[:2, :2] + F_own[2, :2], own1 @ F_own[:2, :2].T + F_own[:2, 2]]
        squares = np.hstack(lines) ** 2
        shares = squares / np.append(size1, size2) / np.sum(squares, axis=1, keepdims=True)
        by_others[1:] += distances_px * (shrinks @ shares.T)
    by_pose = pose_jacobian(R, t, K1, K2, own1, own2, F_own)
    jacobian = np.column_stack([by_others[0], by_pose, by_others[1:].T])
    jacobian = pairs.weights[:, None] * jacobian
    return Residuals(problem, parameters, F, p1, p2, pairs.weights * distances_px, jacobian)


def moved(parameters: Parameters, step: Array) -> Parameters:
    """Apply a step (p,) to the parameters."""
    R, t = moved_pose(parameters.R, parameters.t, step[T_D + 1 : FIRST_COLUMN])
    return Parameters(
        parameters.t_d_s + float(step[T_D]), R, t, parameters.columns + step[FIRST_COLUMN:]
    )


@dataclass(frozen=True)
class Solution:
    """Where the iteration ended."""

    parameters: Parameters
    converged: bool  # the last step was small, or all steps were asked for
    change: Array  # (p,) sum of all steps
    last_step: Array  # (p,)


def solve(
    problem: Problem, start: Parameters, max_steps: int = 20, last_step: float = 1e-6
) -> Solution:
    """Minimise Cauchy's loss by Gauss-Newton steps; columns that the start lacks begin at zero.

    A step whose norm [s, rad, and the columns' units] is below `last_step` ends the iteration; at 0
    all steps are made.
    """
    columns = np.zeros(len(problem.columns))
    columns[: len(start.columns)] = start.columns[: len(columns)]
    parameters, free = replace(start, columns=columns), problem.free
    change: Array = np.zeros(problem.size)
    step = change
    for _ in range(max_steps):
        step = np.zeros(problem.size)
        step[free] = _least_squares(*linearise(problem, parameters).system())
        parameters, change = moved(parameters, step), change + step
        if np.linalg.norm(step) < last_step:
            return Solution(parameters, True, change, step)
    return Solution(parameters, last_step == 0.0, change, step)


def _least_squares(system: Array, target: Array) -> Array:
    """Solve as `np.linalg.lstsq` does, for many rows (n, f) of few columns, without threads."""
    n, f = system.shape
    if n <= f + 1:
        return np.asarray(np.linalg.lstsq(system, target)[0])
    triangle = _triangle(np.ascontiguousarray(np.vstack([system.T, target])))
    rcond = float(np.finfo(np.float64).eps) * n
    return np.asarray(np.linalg.lstsq(triangle[:f, :f], triangle[:f, f], rcond)[0])


@numba.njit(cache=True)
def _triangle(columns: Array) -> Array:
    """R (k, k) of the QR decomposition of `columns` (k, n), k < n, which are overwritten."""
    k = len(columns)
    triangle = np.zeros((k, k))
    for i in range(k):
        vector = columns[i, i:]
        norm = np.sqrt(_product(vector, vector))
        triangle[i, i] = -norm if vector[0] > 0.0 else norm
        vector[0] -= triangle[i, i]
        square = _product(vector, vector)
        for j in range(i + 1, k):
            other = columns[j, i:]
            if square > 0.0:
                ratio = 2.0 * _product(vector, other) / square
                for row in range(len(other)):
                    other[row] -= ratio * vector[row]
            triangle[i, j] = other[0]
    return triangle


@numba.njit(cache=True, fastmath={"reassoc", "contract"})  # sums by vector instructions
def _product(one: Array, other: Array) -> float:
    total = 0.0
    for i in range(len(one)):
        total += one[i] * other[i]
    return total
