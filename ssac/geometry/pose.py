"""Relative poses (R, t) of two cameras, t up to its length, and the pencil of epipolar planes.

Small changes of a pose are given by five numbers [rad]: a rotation vector w (3) that turns R into
exp([w]x) R, and two coordinates of t's change along the rows of `tangent_basis(t)`.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from ssac.arrays import Array
from ssac.camera import Rig
from ssac.geometry import epipolar
from ssac.geometry.fundamental import magsac_essential, reweighted_fundamental
from ssac.rules import SearchRules

Pose = tuple[Array, Array]  # R (3, 3) and t (3,) of length 1


def pose_from_fundamental(
    F: Array, K1: Array, K2: Array, p1_px: Array, p2_px: Array
) -> tuple[Pose, float]:
    """Decompose F into the pose, of four, that puts most pairs in front of both cameras.

    It is the pose of the nearest essential matrix, whose two non-zero singular values are equal.
    The second result, the share of pairs in front, is far from 1 where pairs contradict the pose.
    """
    U, _, Vt = np.linalg.svd(K2.T @ F @ K1)  # of E
    W = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    rays1, rays2 = rays_of(K1, p1_px), rays_of(K2, p2_px)
    poses: list[Pose] = []
    for turn in (W, W.T):
        R = U @ turn @ Vt
        R = R * np.sign(np.linalg.det(R))  # E's sign is free, so U's and Vt's determinants are too
        poses += [(R, U[:, 2]), (R, -U[:, 2])]
    shares = [share_in_front(*pose, rays1, rays2) for pose in poses]
    best = int(np.argmax(shares))
    return poses[best], shares[best]


def nearest_pose(pose: Pose, F: Array, K1: Array, K2: Array, p1_px: Array, p2_px: Array) -> Pose:
    """Move a pose to where its epipolar geometry is nearest to F's, in pixels at the pairs.

    F has two degrees of freedom more than a pose, so the two are never equal. Noise in F is far
    from even over its entries, which `pose_from_fundamental` weights equally; here the mean
    squared difference of Sampson distances under the pose and under F is minimised.
    """
    R, t = pose
    target = epipolar.sampson_distance(F, p1_px, p2_px)
    for k in range(10):
        at = epipolar.fundamental_from_pose(K1, K2, R, t)
        distances = epipolar.sampson_distance(at, p1_px, p2_px)
        if k == 0:
            target = target * np.sign(target @ distances)  # F's sign is free
        jacobian = pose_jacobian(R, t, K1, K2, p1_px, p2_px, at)
        step = np.asarray(np.linalg.lstsq(jacobian, target - distances)[0])
        R, t = moved_pose(R, t, step)
        if np.linalg.norm(step) < 1e-7:  # [rad]
            break
    return R, t


def pose_jacobian(
    R: Array, t: Array, K1: Array, K2: Array, p1_px: Array, p2_px: Array, F: Array
) -> Array:
    """Jacobian (N, 5) [px/rad] of the Sampson distances from F by a small change of its pose."""
    dE = [epipolar.cross_matrix(t) @ epipolar.cross_matrix(axis) @ R for axis in np.eye(3)]
    dE += [epipolar.cross_matrix(direction) @ R for direction in tangent_basis(t)]
    dF = epipolar.fundamental_from_essential(np.stack(dE), K1, K2)
    gradient = epipolar.sampson_gradient(F, p1_px, p2_px)
    return np.asarray(gradient.reshape(-1, 9) @ dF.reshape(5, 9).T)


def moved_pose(R: Array, t: Array, step: Array) -> tuple[Array, Array]:
    """Apply a small change (5,) [rad] to a pose."""
    moved_t = t + step[3:] @ tangent_basis(t)
    return Rotation.from_rotvec(step[:3]).as_matrix() @ R, moved_t / np.linalg.norm(moved_t)


def pose_step(R: Array, t: Array, R_to: Array, t_to: Array) -> Array:
    """Give the small change (5,) [rad] by which `moved_pose` takes a pose to another one."""
    along = tangent_basis(t) @ t_to
    length = float(np.linalg.norm(along))
    direction = along / length if length > 0.0 else np.array([1.0, 0.0])
    turn = Rotation.from_matrix(R_to @ R.T).as_rotvec()
    angle = np.arctan2(np.linalg.norm(np.cross(t, t_to)), t @ t_to)
    return np.append(turn, angle * direction)


def centre_covariance(R: Array, t: Array, covariance: Array) -> Array:
    """Return the covariance (3, 3) of the centre -R' t, from that of a small change of the pose.

    The latter is (5, 5), or (6, 6) with a change of all three coordinates of t.
    """
    along = tangent_basis(t).T if len(covariance) == 5 else np.eye(3)
    by_pose = -R.T @ np.hstack([epipolar.cross_matrix(t), along])
    return np.asarray(by_pose @ covariance @ by_pose.T)


def vector_by_turn(R: Array) -> Array:
    """Jacobian (3, 3) of the rotation vector of exp([w]x) R by w, at w = 0."""
    vector = Rotation.from_matrix(R).as_rotvec()
    angle, across = float(np.linalg.norm(vector)), epipolar.cross_matrix(vector)
    small = angle < 1e-4  # where rounding spoils the ratio, whose limit is 1/12
    ratio = 1.0 / 12.0 if small else (1.0 - 0.5 * angle / np.tan(0.5 * angle)) / angle**2
    return np.asarray(np.eye(3) - 0.5 * across + ratio * across @ across)


def tangent_basis(t: Array) -> Array:
    """Two unit vectors (2, 3), orthogonal to each other and to the unit vector t (3,)."""

    def cross(a: Array, b: Array) -> Array:  # `np.cross` takes ten times as long
        (x, y, z), (u, v, w) = a.tolist(), b.tolist()
        return np.array([y * w - z * v, z * u - x * w, x * v - y * u])

    axis = np.zeros(3)
    axis[np.argmin(np.abs(t))] = 1.0
    first = cross(t, axis)
    first /= np.linalg.norm(first)
    return np.stack([first, cross(t, first)])


def depths(R: Array, t: Array, rays1: Array, rays2: Array) -> tuple[Array, Array]:
    """Depths (N,) in both cameras of the points where rays (N, 3), z = 1 in each, pass closest.

    They are in units of t's length, negative behind the camera, infinite or NaN for parallel rays.
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


def possible_poses(p1_px: Array, p2_px: Array, rig: Rig, rules: SearchRules) -> list[Pose]:
    """Candidate poses of the pairs, from F, E and a homography; the best fit comes first."""
    if len(p1_px) < rules.min_pairs:
        return []
    K1, K2 = rig.cam1.K, rig.cam2.K
    F = reweighted_fundamental(p1_px, p2_px)
    if not np.isfinite(F).all():
        return []
    poses = [pose_from_fundamental(F, K1, K2, p1_px, p2_px)[0]]
    x1, x2 = rays_of(K1, p1_px), rays_of(K2, p2_px)
    cv2.setRNGSeed(1)  # so that equal calls give equal results
    E = magsac_essential(x1[:, :2], x2[:, :2], K1, K2)
    if E is not None:
        _, R, t, _ = cv2.recoverPose(E, x1[:, :2], x2[:, :2], np.eye(3))
        poses.append((np.asarray(R, dtype=np.float64), np.asarray(t, dtype=np.float64)[:, 0]))
    poses += homography_poses(x1, x2)[1]
    poses = [pose for pose in poses if share_in_front(*pose, x1, x2) >= rules.min_in_front]

    def distance_px(pose: Pose) -> float:
        F = epipolar.fundamental_from_pose(K1, K2, *pose)
        return float(np.median(np.abs(epipolar.sampson_distance(F, p1_px, p2_px))))

    return sorted(poses, key=distance_px)


def homography_poses(x1: Array, x2: Array) -> tuple[float, list[Pose]]:
    """Median distance of rays (n, 3) from the homography between them, and its poses.

    The decomposition is that of Ma et al., An Invitation to 3-D Vision, Sec. 5.3.3, since OpenCV's
    assumes both cameras to be on the same side of the plane.
    """
    H, distance = homography(x1[:, :2], x2[:, :2])
    if H is None:
        return np.inf, []
    _, sizes, axes = np.linalg.svd(H)
    H = H * np.sign(np.median(x1 @ H[2])) / sizes[1]  # depths are positive in both views
    squares = (sizes / sizes[1]) ** 2
    poses: list[Pose] = []
    along, across = np.sqrt(1.0 - squares[2]) * axes[0], np.sqrt(squares[0] - 1.0) * axes[2]
    for u in (along + across, along - across):  # u and the second axis span the plane
        length = np.linalg.norm(u)
        if not length > 1e-9:
            continue  # a rotation without a baseline
        first, second = axes[1], u / length
        before = np.column_stack([first, second, np.cross(first, second)])
        turned = H @ first, H @ second
        R = np.column_stack([*turned, np.cross(*turned)]) @ before.T
        t = (H - R) @ before[:, 2]
        t = t / np.linalg.norm(t)
        poses += [(R, t), (R, -t)]
    return distance, poses


def homography(p1: Array, p2: Array) -> tuple[Array | None, float]:
    """Homography (3, 3) of pairs (n, 2) by least median of squares, and their median distance."""
    found, _ = cv2.findHomography(p1, p2, cv2.LMEDS)
    if found is None:
        return None, np.inf
    H = np.asarray(found, dtype=np.float64)
    mapped = np.column_stack([p1, np.ones(len(p1))]) @ H.T
    with np.errstate(divide="ignore", invalid="ignore"):
        distances = np.linalg.norm(mapped[:, :2] / mapped[:, 2:] - p2, axis=1)
    return H, float(np.median(distances))


@dataclass(frozen=True)
class Pencil:
    """Epipolar planes in one camera: atan2(sine . p, cosine . p) is the angle of p = (x, y, 1)."""

    sine: Array  # (3,)
    cosine: Array  # (3,)

    def angles(self, points_px: Array) -> Array:
        """Angles (n,) [rad], in -pi to pi, of the planes through points (n, 2)."""
        return np.arctan2(*self._parts(points_px))

    def gradients(self, points_px: Array) -> Array:
        """Change (n, 2) [rad/px] of the angle with the point."""
        sines, cosines = self._parts(points_px)
        along = np.outer(cosines, self.sine[:2]) - np.outer(sines, self.cosine[:2])
        return np.asarray(along / (sines**2 + cosines**2)[:, None])

    def _parts(self, points_px: Array) -> tuple[Array, Array]:
        sine, cosine = self.sine, self.cosine
        return points_px @ sine[:2] + sine[2], points_px @ cosine[:2] + cosine[2]


def pencils(R: Array, t: Array, K1: Array, K2: Array) -> tuple[Pencil, Pencil]:
    """Pencils of both cameras with x2 = R x1 + t; a plane has the same angle in both."""
    axes = tangent_basis(t)
    first, second = (
        Pencil(*(axis @ turn @ np.linalg.inv(K) for axis in axes))
        for turn, K in ((R, K1), (np.eye(3), K2))
    )
    return first, second
