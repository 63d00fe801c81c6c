"""Pairs of both views, parameters and priors in; what the parameters leave of the pairs out.

What every refinement minimises. Its parameters are, in the order of Jacobians and covariances:

    t_d [s]; the five small changes [rad] of the pose that `ssac.geometry.pose` defines;
    then one for each `Column` of the problem, such as a clock's rate or a focal length.

The residuals are signed Sampson distances [px] of pairs, times the pairs' weights. Pairs are
sampled at one offset and moved on by the velocity of p2 where the parameters change it.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ssac.camera import Rig
from ssac.geometry.epipolar import fundamental_from_pose, sampson_derivative, sampson_distance
from ssac.geometry.pose import moved_pose, pose_jacobian
from ssac.geometry.robust import CAUCHY

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

T_D = 0
"""Place of the offset among the parameters."""

FIRST_COLUMN = 6
"""Place of the first column's value; the pose's five changes stand between."""

_NO_CHANGE = np.zeros((3, 3))


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
    weights: Array  # (n,) of the distances, with a median of 1
    t_d_s: float  # at which p2 was sampled


@dataclass(frozen=True)
class Column:
    """One more parameter, which moves the points in proportion to its value.

    A clock that runs fast by the share r moves p2 by r (t - t_ref) v2; a focal length that is
    longer by the share f moves the points by f times their distance from the principal point.
    """

    dp1_px: Array  # (n, 2) for a value of one
    dp2_px: Array  # (n, 2)
    at: float = 0.0  # value with which the points were sampled
    is_of_clock: bool = False  # a change of what camera 2's clock shows, as the offset is
    is_of_camera: bool = False  # an uncertain number of a camera


@dataclass(frozen=True)
class Prior:
    """What is known of a parameter beforehand, its errors being normal."""

    place: int  # T_D, or from FIRST_COLUMN on
    value: float
    deviation: float  # in the parameter's unit
    scale_px: float = np.nan  # what one deviation counts as; NaN: as an independent residual


@dataclass(frozen=True)
class Problem:
    """What is to be minimised, over what."""

    pairs: WeighedPairs
    rig: Rig
    pose_is_known: bool = False  # it stays as it is
    columns: tuple[Column, ...] = ()
    priors: tuple[Prior, ...] = ()
    turn: float = CAUCHY  # where the loss turns, in robust standard deviations

    def __post_init__(self) -> None:
        for prior in self.priors:
            if prior.place != T_D and not FIRST_COLUMN <= prior.place < self.size:
                raise ValueError(
                    f"a prior is of the offset (place {T_D}) or of a column (from {FIRST_COLUMN}"
                    f" up to {self.size - 1}), got place {prior.place}"
                )

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
        """Places of the parameters that say what camera 2's clock shows."""
        more = [k for k, column in enumerate(self.columns, FIRST_COLUMN) if column.is_of_clock]
        return [T_D, *more]


@dataclass(frozen=True)
class Residuals:
    """What is left of n pairs, and its derivatives by all parameters."""

    times_s: Array  # (n,) camera 1's clock
    p1_px: Array  # (n, 2)
    p2_px: Array  # (n, 2)
    distances_px: Array  # (n,) signed, times the pair's weight, whose median is 1
    jacobian: Array  # (n, p) [px per unit of the parameter]


def linearise(problem: Problem, parameters: Parameters) -> Residuals:
    """Residuals at some parameters, and their exact derivatives."""
    pairs, K1, K2 = problem.pairs, problem.rig.cam1.K, problem.rig.cam2.K
    R, t = parameters.R, parameters.t
    p1, p2 = pairs.p1_px, pairs.p2_px + (parameters.t_d_s - pairs.t_d_s) * pairs.v2_px_s
    for column, value in zip(problem.columns, parameters.columns, strict=True):
        value -= column.at
        p1, p2 = p1 + value * column.dp1_px, p2 + value * column.dp2_px
    F = fundamental_from_pose(K1, K2, R, t)
    jacobian = np.column_stack(
        [
            sampson_derivative(F, _NO_CHANGE, p1, p2, pairs.v2_px_s),
            pose_jacobian(R, t, K1, K2, p1, p2, F),
            *(
                sampson_derivative(F.T, _NO_CHANGE, p2, p1, column.dp1_px)
                + sampson_derivative(F, _NO_CHANGE, p1, p2, column.dp2_px)
                for column in problem.columns
            ),
        ]
    )
    return Residuals(
        pairs.times_s,
        p1,
        p2,
        pairs.weights * sampson_distance(F, p1, p2),
        pairs.weights[:, None] * jacobian,
    )


def moved(parameters: Parameters, step: Array) -> Parameters:
    """Apply a step (p,) to the parameters."""
    R, t = moved_pose(parameters.R, parameters.t, step[T_D + 1 : FIRST_COLUMN])
    return Parameters(
        parameters.t_d_s + float(step[T_D]), R, t, parameters.columns + step[FIRST_COLUMN:]
    )
