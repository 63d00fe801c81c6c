"""Decomposition of F: the one of four poses with the points in front of both cameras."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ssac.geometry.epipolar import fundamental_from_pose
from ssac.geometry.fundamental import reweighted_fundamental
from ssac.geometry.pose import (
    depths,
    homography_poses,
    nearest_pose,
    pose_from_fundamental,
    possible_poses,
    tangent_basis,
)
from ssac.rules import SearchRules
from tests.ssac.synthetic import K, angle_deg, make_scene, project, track_pair

ROUNDING = 1e-7  # of an SVD of E through K, whose condition number is about 200 squared


def assert_pose(pose, scene):
    assert np.allclose(pose.R, scene.R, atol=ROUNDING)
    assert np.allclose(pose.t, scene.t / np.linalg.norm(scene.t), atol=ROUNDING)


@pytest.mark.parametrize("angle", [30.0, 90.0, 150.0])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_pose_of_an_exact_f_is_recovered_with_either_sign(angle, sign):
    scene = make_scene(seed=2, angle_deg=angle)
    p1, p2 = track_pair(scene, np.linspace(0.0, 20.0, 50))
    F = sign * fundamental_from_pose(K, K, scene.R, scene.t)
    pose = pose_from_fundamental(F, K, K, p1, p2)
    assert_pose(pose, scene)
    assert np.linalg.det(pose.R) == pytest.approx(1.0)
    assert pose.in_front == 1.0
    turn = Rotation.from_rotvec([0.02, -0.01, 0.03]).as_matrix()
    for R in (pose.R, turn @ pose.R):
        assert_pose(nearest_pose(replace(pose, R=R), F, K, K, p1, p2), scene)


def test_the_nearest_pose_improves_on_the_decomposition():
    errors_deg = []
    for seed in range(10):
        scene = make_scene(seed, angle_deg=30.0)
        p1, p2 = track_pair(scene, np.linspace(0.0, 20.0, 400))
        p1, p2 = (p + np.random.default_rng(seed).normal(0.0, 0.3, p.shape) for p in (p1, p2))
        F = reweighted_fundamental(p1, p2)
        pose = pose_from_fundamental(F, K, K, p1, p2)
        nearest = nearest_pose(pose, F, K, K, p1, p2)
        assert np.allclose(nearest.R @ nearest.R.T, np.eye(3))
        turned = nearest_pose(pose, -F, K, K, p1, p2)  # F's sign is free
        assert np.allclose([*turned.R, turned.t], [*nearest.R, nearest.t], atol=ROUNDING)
        errors_deg.append([angle_deg(p.t, scene.t) for p in (pose, nearest)])
    decomposed, moved = np.mean(errors_deg, axis=0)
    assert moved < 0.8 * decomposed  # half of it, over 100 seeds


def test_pairs_that_disagree_about_the_pose_show():
    scene = make_scene(seed=4)
    points = np.array([scene.path(time_s) for time_s in np.linspace(0.0, 20.0, 50)])
    points[::2] = -points[::2]  # behind camera 1: the same F, another of the four poses
    p1, p2 = project(points), project(points @ scene.R.T + scene.t)
    F = fundamental_from_pose(K, K, scene.R, scene.t)
    assert pose_from_fundamental(F, K, K, p1, p2).in_front == pytest.approx(0.5, abs=0.1)


def test_an_object_at_rest_has_no_pose():
    points = np.full((40, 2), 100.0)
    assert possible_poses(points, points, make_scene(seed=4).rig, SearchRules()) == []


def test_depths_place_points_back_where_they_were():
    rng = np.random.default_rng(0)
    x1 = rng.uniform([-1.0, -1.0, 3.0], [1.0, 1.0, 6.0], (20, 3))
    R = Rotation.from_rotvec([0.1, 0.9, -0.2]).as_matrix()
    t = np.array([-3.0, 0.2, 2.0])
    x2 = x1 @ R.T + t
    depths1, depths2 = depths(R, t, x1 / x1[:, 2:], x2 / x2[:, 2:])
    assert np.allclose(depths1, x1[:, 2])
    assert np.allclose(depths2, x2[:, 2])


def test_tangent_basis_is_orthonormal():
    rng = np.random.default_rng(0)
    for t in [*np.eye(3), *rng.normal(size=(10, 3))]:
        t = t / np.linalg.norm(t)
        frame = np.vstack([t, tangent_basis(t)])
        assert np.allclose(frame @ frame.T, np.eye(3), atol=1e-12)


def test_a_plane_between_the_cameras_gives_their_pose():
    rng = np.random.default_rng(3)
    R = Rotation.from_euler("y", 120.0, degrees=True).as_matrix()
    middle = np.array([0.0, 0.0, 5.0])
    t = middle - R @ middle  # both look at the middle
    # The plane of points, x + 0.2 z = 1, has camera 1 on one side and camera 2 on the other.
    points = rng.uniform(-1.0, 1.0, (50, 3)) + middle
    points[:, 0] = 1.0 - 0.2 * points[:, 2]
    seen = [p / p[:, 2:] for p in (points, points @ R.T + t)]
    sides = np.array([-1.0, -R.T[0] @ t - 0.2 * R.T[2] @ t - 1.0])
    assert sides[0] * sides[1] < 0.0
    distance, poses = homography_poses(*seen)
    assert distance < ROUNDING  # as OpenCV solves for a homography
    t = t / np.linalg.norm(t)
    errors = [np.abs(at_R - R).max() + np.abs(at_t - t).max() for at_R, at_t in poses]
    assert min(errors) < ROUNDING
