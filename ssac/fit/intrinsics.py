"""A rig's uncertain intrinsics as parameters of a fit, and the evidence against them.

Each of a camera's fu, fv, pu and pv whose deviation is not 0 is one more `Column` with a `Prior`.
Two views of one path tell two combinations of the eight at most, as F has seven parameters and the
pose takes five: only the priors determine the rest.

Values are shares of the focal length along their axis: a value s changes fu to (1 + s) fu, or moves
pu by s fu.
"""

from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from ssac.arrays import Array
from ssac.camera import Camera, Rig, distort_points, with_deviations
from ssac.fit.covariance import repeats
from ssac.fit.least_squares import (
    FIRST_COLUMN,
    T_D,
    Column,
    Parameters,
    Prior,
    Problem,
    Residuals,
    linearise,
    solve,
)
from ssac.geometry.epipolar import robust_deviation


@dataclass(frozen=True)
class Uncertain:
    """An intrinsic of a camera that is not exactly known."""

    camera: int  # 0 or 1
    place: int  # among fu, fv, pu, pv
    deviation: float  # as a share of the focal length along its axis


def uncertain_ones(rig: Rig) -> tuple[Uncertain, ...]:
    """Intrinsics of both cameras that are not exact."""
    return tuple(
        Uncertain(n, place, std_px / float(camera.K[place % 2, place % 2]))
        for n, camera in enumerate((rig.cam1, rig.cam2))
        for place, std_px in enumerate(camera.intrinsics_std_px)
        if std_px > 0.0
    )


class Allowance:
    """A refinement's uncertain intrinsics and scales of priors, added once a fit tells the scales.

    Until then a clock's priors count as independent residuals, and intrinsics are exact.
    """

    def __init__(self, rig: Rig, has_priors: bool = False) -> None:
        self._scales_px: Array | None = None  # (m,) `Prior.scale_px` of a clock's priors
        self._intrinsics_px = 0.0  # the same of the intrinsics
        self.is_made = not (has_priors or uncertain_ones(rig))  # nothing is left to learn

    def learn(self, problem: Problem, parameters: Parameters) -> None:
        """Take the priors' scales from a fit whose loss has the scale of the last fit's.

        A skew's prior is weighted by what the residuals tell of the skew. They tell next to nothing
        of other parameters, whose priors are weighted by `covariance.repeats`.
        """
        if self.is_made:
            return
        residuals = linearise(problem, parameters)
        slopes_px = residuals.weights[0] * residuals.distances_px
        n = repeats(problem.pairs.times_s, residuals.free, slopes_px, problem.rules)
        scale_px = np.sqrt(n) * robust_deviation(residuals.distances_px)
        self._intrinsics_px, self.is_made = scale_px, True
        self._scales_px = np.full(len(problem.priors), scale_px)
        if len(problem.of_clock) > 1:
            skew = replace(problem, columns=problem.columns[:1], priors=problem.priors[:1])
            jacobian = residuals.jacobian[:, : skew.size]
            alone = replace(residuals, problem=skew, jacobian=jacobian)
            self._scales_px[0] = alone.fair_scales()[-1]

    def added(self, problem: Problem) -> Problem:
        """Add the priors' scales and the uncertain intrinsics to a problem, once they are known."""
        if self._scales_px is None:
            return problem
        of_clock = [
            replace(prior, scale_px=float(scale_px))
            for prior, scale_px in zip(problem.priors, self._scales_px, strict=True)
        ]
        return with_intrinsics(replace(problem, priors=tuple(of_clock)), self._intrinsics_px)


def with_intrinsics(problem: Problem, scale_px: float = np.nan) -> Problem:
    """Add a rig's uncertain intrinsics, the scale of whose priors is `Prior.scale_px`."""
    moves, columns, priors = _moves(problem), [*problem.columns], [*problem.priors]
    for place, one in enumerate(uncertain_ones(problem.rig), problem.size):
        both = [np.zeros_like(problem.pairs.p1_px) for _ in moves]
        both[one.camera] = moves[one.camera][one.place]
        shrinks = np.zeros(4)
        shrinks[2 * one.camera + one.place % 2] = float(one.place < 2)
        columns.append(Column(both[0], both[1], is_of_camera=True, shrinks=shrinks))
        priors.append(Prior(place, 0.0, one.deviation, scale_px))
    return replace(problem, columns=tuple(columns), priors=tuple(priors))


def _moves(problem: Problem) -> tuple[Array, Array]:
    """Return `moves_of` for the points of a problem in both cameras."""
    rig, pairs = problem.rig, problem.pairs
    return moves_of(rig.cam1, pairs.p1_px), moves_of(rig.cam2, pairs.p2_px)


def moves_of(camera: Camera, points_px: Array) -> Array:
    """Displacements (4, n, 2) [px] of ideal points (n, 2) by a unit value of fu, fv, pu and pv.

    A measured pixel m = c + f d(r) stays where it is, so the ray r changes by
    -(f J)^-1 (dc + df d(r)), with the lens's derivative J = dd/dr.
    """
    centre, focal = camera.K[:2, 2], np.diag(camera.K)[:2]
    measured = distort_points(camera, points_px)
    shifts = np.zeros((4, len(points_px), 2))
    for axis in (0, 1):
        shifts[axis, :, axis] = -(measured[:, axis] - centre[axis])
        shifts[2 + axis, :, axis] = -focal[axis]
    if camera.distortion_model == "none" or len(points_px) == 0:
        return shifts
    step_px = 0.5
    derivatives = [
        (distort_points(camera, points_px + step) - distort_points(camera, points_px - step))
        / (2.0 * step_px)
        for step in step_px * np.eye(2)
    ]
    lens = np.stack(derivatives, axis=2)  # (n, 2, 2) of the measured by the ideal points
    return np.asarray(np.einsum("nij,knj->kni", np.linalg.inv(lens), shifts))


def intrinsics_of(problem: Problem, parameters: Parameters) -> tuple[Array, Array]:
    """Return the estimated K (3, 3) of both cameras."""
    Ks, n = [problem.rig.cam1.K.copy(), problem.rig.cam2.K.copy()], problem.n_of_cameras
    values = parameters.columns[len(parameters.columns) - n :]
    for one, value in zip(uncertain_ones(problem.rig)[:n], values, strict=True):
        K, axis = Ks[one.camera], one.place % 2
        if one.place < 2:  # before the centre, which moves by a share of the focal length found
            K[axis, axis] /= 1.0 - value
        else:
            K[axis, 2] += value * K[axis, axis]
    return Ks[0], Ks[1]


def questioned(residuals: Residuals) -> Residuals:
    """Let intrinsics that a rig states as exact be those of a good calibration instead.

    Not where the cameras look at each other across the object: about an epipole, the object's own
    bias has the effect of a wrong principal point.
    """
    problem, rig = residuals.problem, residuals.problem.rig
    if problem.pose_is_known or not rig.is_exact:
        return residuals
    points_px, epipole = residuals.p1_px, np.linalg.svd(residuals.F)[2][-1]
    off_px = np.linalg.norm(epipole[2] * np.mean(points_px, axis=0) - epipole[:2])
    spread_px = abs(epipole[2]) * np.linalg.norm(np.std(points_px, axis=0))
    if off_px < problem.rules.least_from_epipole * spread_px:
        return residuals
    good = replace(rig, cam1=with_deviations(rig.cam1), cam2=with_deviations(rig.cam2))
    asked, columns = with_intrinsics(replace(problem, rig=good)), residuals.parameters.columns
    values = np.append(columns, np.zeros(len(asked.columns) - len(columns)))
    return linearise(asked, replace(residuals.parameters, columns=values))


def evidence(residuals: Residuals, hidden_px: Array) -> float:
    """Return by how many deviations the views contradict a rig's intrinsics.

    For each combination of them that the views determine, the value that fits best without a prior
    is divided by its deviation: the rig's, the fit's and that of hidden errors (see
    `Residuals.hidden_covariance`). The largest ratio counts. It is 0 without what `Allowance` adds,
    and with a known pose, whose bias has effects as large.
    """
    problem, worst = residuals.problem, 0.0
    n = problem.n_of_cameras
    if n == 0 or problem.pose_is_known:
        return worst
    first, told = problem.size - n, problem.rules.told_combinations
    deviations = np.array([prior.deviation for prior in problem.priors[-n:]])
    others = residuals.jacobian[:, [place for place in problem.free if place < first]]
    effects = residuals.jacobian[:, first:] * deviations
    left = effects - others @ np.linalg.lstsq(others, effects)[0]
    _, sizes, axes = np.linalg.svd(left, full_matrices=False)
    for axis in axes[:told][sizes[:told] > 1e-6 * sizes[0]]:  # smaller ones are undetermined
        value = float(axis @ (residuals.parameters.columns[-n:] / deviations))
        alone = _with_only(residuals, axis * deviations, value)
        shift = float(alone.parameters.columns[-1])
        if np.max(np.abs(shift * axis * deviations)) > problem.rules.most_shift:
            continue  # the views tell so little of it that the fit diverges
        covariance = alone.covariance() + alone.hidden_covariance(hidden_px)
        worst = max(worst, abs(shift) / float(np.sqrt(1.0 + covariance[-1, -1])))
    return worst


def _with_only(residuals: Residuals, amounts: Array, value: float = 0.0) -> Residuals:
    """Fit one combination (n,) of the intrinsics, without a prior, in place of all of them."""
    n, problem = len(amounts), residuals.problem
    own = list(zip(problem.columns[-n:], amounts, strict=True))
    dp1_px = np.sum([amount * column.dp1_px for column, amount in own], axis=0)
    dp2_px = np.sum([amount * column.dp2_px for column, amount in own], axis=0)
    shrinks = np.sum([amount * column.shrinks for column, amount in own], axis=0)
    combined = Column(dp1_px, dp2_px, is_of_camera=True, shrinks=shrinks)
    columns = (*problem.columns[:-n], combined)
    one = replace(problem, columns=columns, priors=problem.priors[:-n])
    start = residuals.parameters
    start = replace(start, columns=np.append(start.columns[:-n], value))
    return linearise(one, solve(one, start).parameters)


_CHANGES: tuple[tuple[str, tuple[int, ...], str, tuple[str, str]], ...] = (
    ("focal length", (0, 1), "% ", ("longer", "shorter")),
    ("principal point", (2,), "px further to the ", ("right", "left")),
    ("principal point", (3,), "px ", ("lower", "higher")),
)
"""Possible errors of a camera: name, places among fu, fv, pu, pv, unit, words for + and -."""


def wanted(residuals: Residuals) -> str:
    """Say which changes of one camera's intrinsics, or the other's, explain most of the misfit.

    A focal length often explains as much as a principal point: all that do are named.
    """
    problem, parameters = residuals.problem, residuals.parameters
    ones = uncertain_ones(problem.rig)[: problem.n_of_cameras]
    plain = replace(problem, columns=problem.columns[: -len(ones)], priors=())
    at_rig = replace(parameters, columns=parameters.columns[: -len(ones)])
    scale_px = problem.turn * robust_deviation(linearise(plain, at_rig).distances_px)
    found: list[tuple[float, str]] = []
    for camera, (name, places, unit, words) in product((0, 1), _CHANGES):
        amounts = [float(one.camera == camera and one.place in places) for one in ones]
        if not any(amounts):
            continue  # these are exact
        changed = _with_only(residuals, np.array(amounts))
        share = float(changed.parameters.columns[-1])
        if abs(share) > problem.rules.most_shift:
            continue
        loss = float(np.sum(np.log1p((changed.distances_px / scale_px) ** 2)))
        K, axis = (problem.rig.cam1, problem.rig.cam2)[camera].K, places[0] % 2
        # Columns are linear: s scales points by 1 - s, as a focal length s / (1 - s) longer does.
        size = 100.0 * share / (1.0 - share) if places[0] < 2 else share * K[axis, axis]
        rounded = float(f"{abs(size):.2g}")  # then :g, as 100 is not to be 1e+02
        by = f"{rounded:g} {unit}{words[int(size < 0.0)]}"
        found.append((loss, f"camera {camera + 1}'s {name} wants to be {by}"))
    most = problem.rules.as_good * min((loss for loss, _ in found), default=0.0)
    return ", or ".join(said for loss, said in sorted(found) if loss <= most)


def turned_by_focals(residuals: Residuals) -> Array:
    """Angles (2,) [rad] by which R and t turn per relative lengthening of all focal lengths."""
    problem, parameters = residuals.problem, residuals.parameters
    if problem.pose_is_known:
        return np.full(2, np.nan)
    dp1_px, dp2_px = (np.sum(moves[:2], axis=0) for moves in _moves(problem))
    both = Column(dp1_px, dp2_px)
    at = replace(parameters, columns=np.append(parameters.columns, 0.0))
    longer = linearise(replace(problem, columns=(*problem.columns, both)), at)
    own = problem.free[problem.free < problem.size - problem.n_of_cameras]
    system = np.sqrt(longer.weights[0])[:, None] * longer.jacobian
    turned = np.zeros(problem.size)
    turned[own] = np.linalg.lstsq(system[:, own], -system[:, -1])[0]
    R, t = turned[T_D + 1 : T_D + 4], turned[T_D + 4 : FIRST_COLUMN]
    return np.array([np.linalg.norm(R), np.linalg.norm(t)])
