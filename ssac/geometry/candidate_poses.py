"""Pairs in, the relative poses that they may have out, also those of a path in a plane."""

import cv2
import numpy as np
from numpy.typing import NDArray

from ssac.camera import Rig
from ssac.geometry.epipolar import fundamental_from_pose, sampson_distance
from ssac.geometry.fundamental import MIN_PAIRS, reweighted_fundamental
from ssac.geometry.pose import MIN_IN_FRONT, pose_from_fundamental, rays_of, share_in_front

Array = NDArray[np.float64]
Pose = tuple[Array, Array]  # R (3, 3) and t (3,) of length 1

_LEAST_SHIFT = 1e-9  # a homography of less is that of a turn without a baseline
_RANSAC_PX = 1.0
_RANSAC_SEED = 1


def possible_poses(p1_px: Array, p2_px: Array, rig: Rig) -> list[Pose]:
    """Poses that the pairs may have, of F, of E and of a homography; the best fit comes first.

    None where the pairs are too few, or those of an object at rest.
    """
    if len(p1_px) < MIN_PAIRS:
        return []
    K1, K2 = rig.cam1.K, rig.cam2.K
    F = reweighted_fundamental(p1_px, p2_px)
    if not np.isfinite(F).all():
        return []
    of_F = pose_from_fundamental(F, K1, K2, p1_px, p2_px)
    poses: list[Pose] = [(of_F.R, of_F.t)]
    x1, x2 = rays_of(K1, p1_px), rays_of(K2, p2_px)
    cv2.setRNGSeed(_RANSAC_SEED)  # or two calls give two results
    threshold = _RANSAC_PX / float(np.sqrt(K1[0, 0] * K2[0, 0]))
    E, _ = cv2.findEssentialMat(x1[:, :2], x2[:, :2], np.eye(3), cv2.USAC_MAGSAC, 0.999, threshold)
    if E is not None and E.shape == (3, 3):
        _, R, t, _ = cv2.recoverPose(E, x1[:, :2], x2[:, :2], np.eye(3))
        poses.append((np.asarray(R, dtype=np.float64), np.asarray(t, dtype=np.float64)[:, 0]))
    poses += homography_poses(x1, x2)[1]
    poses = [(R, t) for R, t in poses if share_in_front(R, t, x1, x2) >= MIN_IN_FRONT]

    def distance_px(pose: Pose) -> float:
        F = fundamental_from_pose(K1, K2, *pose)
        return float(np.median(np.abs(sampson_distance(F, p1_px, p2_px))))

    return sorted(poses, key=distance_px)


def homography_poses(x1: Array, x2: Array) -> tuple[float, list[Pose]]:
    """Median distance of rays (n, 3) from the homography between them, and its poses."""
    found, _ = cv2.findHomography(x1[:, :2], x2[:, :2], cv2.LMEDS)
    if found is None:
        return np.inf, []
    H = np.asarray(found, dtype=np.float64)
    mapped = x1 @ H.T
    with np.errstate(divide="ignore", invalid="ignore"):
        distances = np.linalg.norm(mapped[:, :2] / mapped[:, 2:] - x2[:, :2], axis=1)
    _, turns, shifts, _ = cv2.decomposeHomographyMat(H, np.eye(3))
    poses: list[Pose] = []
    for turn, shift in zip(turns, shifts, strict=True):
        R, t = np.asarray(turn, dtype=np.float64), np.asarray(shift, dtype=np.float64)[:, 0]
        length = np.linalg.norm(t)
        if length > _LEAST_SHIFT:
            poses += [(R, t / length), (R, -t / length)]
    return float(np.median(distances)), poses
