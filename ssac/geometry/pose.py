"""Fundamental matrix and point pairs in, relative pose (R, t) out, with t up to its length.

Small changes of a pose are given by five numbers [rad]: a rotation vector w (3) that turns R into
exp([w]x) R, and two coordinates of t's change along the rows of `tangent_basis(t)`.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ssac.geometry.epipolar import (
    cross_matrix,
    essential_from_fundamental,
    fundamental_from_essential,
    fundamental_from_pose,
    sampson_distance,
    sampson_gradient,
)

Array = NDArray[np.float64]

MIN_IN_FRONT = 0.75
"""A pose that puts a smaller share of the pairs in front of both cameras is refused."""

_MAX_ITERATIONS = 10
_LAST_STEP = 1e-7  # [rad]


@dataclass(frozen=True)
class RelativePose:
    """One of the four poses that share an essential matrix: x2 = R x1 + t."""

    R: Array  # (3, 3) rotation from camera 1's frame to camera 2's
    t: Array  # (3,) position of camera 1 in camera 2's frame, length 1
    in_front: float  # share of the pairs that lie in front of both cameras, 0 to 1


def pose_from_fundamental(
    F: Array, K1: Array, K2: Array, p1_px: Array, p2_px: Array
) -> RelativePose:
    """Decompose F, and choose the pose for which most points lie in front of both cameras.

    A pair that satisfies the epipolar constraint lies in front of both cameras for exactly one of
    the four poses, so a share `in_front` far from 1 says that the pairs disagree about the pose.

    Parameters
    ----------
    F
        Shape (3, 3), p2' F p1 = 0.
    K1, K2
        Intrinsics, shape (3, 3) [px].
    p1_px, p2_px
        Pairs, shape (N, 2) [px], N >= 1, undistorted.

    Returns
    -------
    RelativePose
        Of the closest true essential matrix: E's two singular values are made equal.
    """
    U, _, Vt = np.linalg.svd(essential_from_fundamental(F, K1, K2))
    W = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    rays1, rays2 = rays_of(K1, p1_px), rays_of(K2, p2_px)
    poses = []
    for turn in (W, W.T):
        R = U @ turn @ Vt
        R = R * np.sign(np.linalg.det(R))  # E's sign is free, so U's and Vt's determinants are too
        poses += [
            RelativePose(R, t, share_in_front(R, t, rays1, rays2)) for t in (U[:, 2], -U[:, 2])
        ]
    return max(poses, key=lambda pose: pose.in_front)


def nearest_pose(
    pose: RelativePose, F: Array, K1: Array, K2: Array, p1_px: Array, p2_px: Array
) -> RelativePose:
    """Move a pose to where its epipolar geometry is nearest to F's, in pixels at the pairs.

    F has two degrees of freedom more than a pose, so the two are never equal. Noise in F is far
    from even over its entries, and `pose_from_fundamental` weighs them all alike; here the mean
    squared difference between the Sampson distances under the pose and under F is made least.

    Parameters
    ----------
    pose
        From `pose_from_fundamental`.
    F, K1, K2, p1_px, p2_px
        As for `pose_from_fundamental`.
    """
    target = sampson_distance(F, p1_px, p2_px)
    start = sampson_distance(fundamental_from_pose(K1, K2, pose.R, pose.t), p1_px, p2_px)
    target = target * np.sign(target @ start)  # F's sign is free
    R, t = pose.R, pose.t
    for _ in range(_MAX_ITERATIONS):
        distances = sampson_distance(fundamental_from_pose(K1, K2, R, t), p1_px, p2_px)
        jacobian = pose_jacobian(R, t, K1, K2, p1_px, p2_px)
        step = np.linalg.lstsq(jacobian, target - distances)[0]
        R, t = moved_pose(R, t, step)
        if np.linalg.norm(step) < _LAST_STEP:
            break
    return replace(pose, R=R, t=t)


def pose_jacobian(
    R: Array, t: Array, K1: Array, K2: Array, p1_px: Array, p2_px: Array, F: Array | None = None
) -> Array:
    """Differentiate the Sampson distances by a small change of the pose: (N, 5) [px/rad].

    F is that of the pose, where it is known already.
    """
    F = fundamental_from_pose(K1, K2, R, t) if F is None else F
    dE = [cross_matrix(t) @ cross_matrix(axis) @ R for axis in np.eye(3)]
    dE += [cross_matrix(direction) @ R for direction in tangent_basis(t)]
    dF = fundamental_from_essential(np.stack(dE), K1, K2)
    gradient = sampson_gradient(F, p1_px, p2_px)
    return np.asarray(gradient.reshape(-1, 9) @ dF.reshape(5, 9).T)


def moved_pose(R: Array, t: Array, step: Array) -> tuple[Array, Array]:
    """Apply a small change (5,) [rad] to a pose."""
    moved_t = t + step[3:] @ tangent_basis(t)
    return Rotation.from_rotvec(step[:3]).as_matrix() @ R, moved_t / np.linalg.norm(moved_t)


def tangent_basis(t: Array) -> Array:
    """Two unit vectors (2, 3), orthogonal to each other and to the unit vector t (3,)."""
    axis = np.zeros(3)
    axis[np.argmin(np.abs(t))] = 1.0
    first = _cross(t, axis)
    first /= np.linalg.norm(first)
    return np.stack([first, _cross(t, first)])


def _cross(a: Array, b: Array) -> Array:
    """Give the cross product of two vectors (3,), for which `np.cross` takes ten times as long."""
    (x, y, z), (u, v, w) = a.tolist(), b.tolist()
    return np.array([y * w - z * v, z * u - x * w, x * v - y * u])


def depths(R: Array, t: Array, rays1: Array, rays2: Array) -> tuple[Array, Array]:
    """Depths along rays of the points where they pass closest to each other.

    Parameters
    ----------
    R, t
        Shapes (3, 3) and (3,): x2 = R x1 + t.
    rays1, rays2
        Directions in each camera's own frame, shape (N, 3), with z = 1.

    Returns
    -------
    tuple of NDArray[np.float64]
        Depths (N,) in camera 1 and camera 2, in units of t; negative behind the camera, infinite or
        NaN for parallel rays.
    """
    turned = rays1 @ R.T
    normals = np.cross(turned, rays2)
    with np.errstate(divide="ignore", invalid="ignore"):
        squares = np.sum(normals**2, axis=1)
        depths1 = np.sum(np.cross(rays2, t) * normals, axis=1) / squares
        depths2 = np.sum(np.cross(turned, t) * normals, axis=1) / squares
    return depths1, depths2


def share_in_front(R: Array, t: Array, rays1: Array, rays2: Array) -> float:
    """Share of the pairs of rays, as for `depths`, that meet in front of both cameras."""
    depths1, depths2 = depths(R, t, rays1, rays2)
    return float(np.mean((depths1 > 0.0) & (depths2 > 0.0)))


def rays_of(K: Array, p_px: Array) -> Array:
    """Directions (N, 3) with z = 1 of pixels (N, 2) [px]."""
    return np.column_stack([p_px, np.ones(len(p_px))]) @ np.linalg.inv(K).T
