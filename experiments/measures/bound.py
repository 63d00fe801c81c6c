"""A true track in, the least errors that any unbiased estimate from it can have out.

The Cramer-Rao bound for positions with independent Gaussian noise, of one standard deviation in all
four coordinates of a pair. The object's unknown positions are eliminated: a pair tells of offset
and pose only by how far it is from p2' F p1 = 0, in units of the gradient of that product, so the
information is the sum of J_i J_i' / noise_i^2, J_i being the derivative of the Sampson distance.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ssac.camera import Rig
from ssac.geometry.epipolar import fundamental_from_pose, sampson_derivative
from ssac.geometry.pose import pose_jacobian

Array = NDArray[np.float64]

_MAX_CONDITION = 1e14  # of the information; beyond it a parameter is not seen at all


@dataclass(frozen=True)
class Bound:
    """Least root mean square errors; infinite for what the motion does not tell."""

    t_d_s: float
    R_rad: float  # of the angle of R_est' R_true; 0 when the pose is known
    t_rad: float  # of the angle between the translation directions; 0 when the pose is known


def cramer_rao_bound(information: Array) -> Bound:
    """Bound when offset and pose are unknown.

    Parameters
    ----------
    information
        Shape (6, 6), from `fisher_information`.
    """
    if not np.linalg.cond(information) < _MAX_CONDITION:
        return Bound(np.inf, np.inf, np.inf)
    variances = np.diag(np.linalg.inv(information))
    R_rad, t_rad = np.sqrt(np.sum(variances[1:4])), np.sqrt(np.sum(variances[4:]))
    return Bound(float(np.sqrt(variances[0])), float(R_rad), float(t_rad))


def known_pose_bound(information: Array) -> Bound:
    """Bound of the offset when the pose is known."""
    with np.errstate(divide="ignore"):
        return Bound(float(1.0 / np.sqrt(information[0, 0])), 0.0, 0.0)


def fisher_information(
    p1_px: Array,
    p2_px: Array,
    v2_px_s: Array,
    R: Array,
    t: Array,
    rig: Rig,
    noise_px: float | Array,
) -> Array:
    """Sum up what n pairs tell of the offset and the pose, six parameters.

    Parameters
    ----------
    p1_px, p2_px
        True positions, undistorted, at the same instants: shape (n, 2), p2' F p1 = 0.
    v2_px_s
        True image velocity of p2, shape (n, 2).
    R, t
        True pose: x2 = R x1 + t, shapes (3, 3) and (3,), |t| = 1.
    rig
        Intrinsics; the extrinsics are not used.
    noise_px
        Standard deviation of the noise of each coordinate: one for all pairs, or shape (n,).

    Returns
    -------
    NDArray[np.float64]
        Shape (6, 6), of t_d [s] and the five small changes [rad] of the pose.
    """
    K1, K2 = rig.cam1.K, rig.cam2.K
    F = fundamental_from_pose(K1, K2, R, t)
    by_t_d = sampson_derivative(F, np.zeros((3, 3)), p1_px, p2_px, v2_px_s)
    J = np.column_stack([by_t_d, pose_jacobian(R, t, K1, K2, p1_px, p2_px)])
    J = J / np.broadcast_to(noise_px, len(J))[:, None]
    return np.asarray(J.T @ J)
