"""Laws of two views: epipolar lines, estimators of F, and the pose that F holds."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ssac.geometry import epipolar, fundamental, pose
from ssac.geometry.epipolar import fundamental_from_pose
from ssac.rules import SearchRules
from tests.ssac.synthetic import HEIGHT, WIDTH, K, angle_deg, make_scene, project, track_pair

ROUNDING_PX = 1e-9  # pixel coordinates of order 100 carry about 1e-14


@pytest.fixture(params=[30.0, 90.0, 150.0])
def exact(request):
    """A flight that a tilted camera 2 sees, too, its fundamental matrix and positions."""
    scene, tilt = make_scene(1, request.param), Rotation.from_rotvec([0.1, -0.2, 0.7]).as_matrix()
    scene = replace(scene, R=tilt @ scene.R, t=tilt @ scene.t)
    p1, p2 = track_pair(scene, np.linspace(0.0, 20.0, 100))
    return scene, fundamental_from_pose(K, K, scene.R, scene.t), p1, p2


@pytest.mark.parametrize("shift_px", [0.0, 2.5])
def test_distances_are_from_epipolar_lines_in_image_1(exact, shift_px):
    _, F, p1, p2 = exact
    lines = epipolar.epipolar_lines_1(F, p2)
    shifts = shift_px * lines[:, :2] / np.linalg.norm(lines[:, :2], axis=1, keepdims=True)
    distances = epipolar.epipolar_distance(F, p1 + shifts, p2)
    assert np.allclose(distances, shift_px, atol=ROUNDING_PX)
    assert np.allclose(epipolar.sampson_distance(F, p1, p2), 0.0, atol=ROUNDING_PX)


def test_f_has_rank_two_and_e_equal_singular_values(exact):
    _, F, _, _ = exact
    assert np.linalg.svd(F)[1][2] < 1e-15 * np.linalg.norm(F) * 100  # rounding of a 3x3 product
    singular = np.linalg.svd(K.T @ F @ K)[1]
    assert np.allclose(singular / singular[0], [1.0, 1.0, 0.0], atol=1e-12)
    back = epipolar.fundamental_from_essential(K.T @ F @ K, K, K)
    assert np.allclose(back, F, atol=1e-12 * np.linalg.norm(F))


def test_a_point_without_a_line_has_no_finite_distance():
    """A line at infinity gives no warning of a division by zero."""
    F = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])  # l1 = (1, 0, x2)
    at_infinity = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # (x2, 0, 1)
    p1, p2 = np.array([[3.0, 4.0]]), np.array([[0.0, 5.0]])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert epipolar.epipolar_distance(F, p1, p2) == pytest.approx([3.0])
        assert np.isposinf(epipolar.epipolar_distance(at_infinity, p1, p2)).all()
        assert np.isnan(epipolar.epipolar_distance(np.zeros((3, 3)), p1, p2)).all()


# --- Estimators of F ---

ESTIMATORS = {
    "lmeds": lambda p1, p2: fundamental.lmeds_fundamental(p1, p2, trials=2000),
    "reweighted": fundamental.reweighted_fundamental,
    "magsac": lambda p1, p2: fundamental.magsac_fundamental(p1, p2, K, K),
}


def pairs(seed, noise_px=0.0, outlier_share=0.0, angle_deg=90.0):
    scene = make_scene(seed, angle_deg)
    p1, p2 = track_pair(scene, np.linspace(0.0, 20.0, 400))
    rng = np.random.default_rng(seed)
    p1, p2 = (p + rng.normal(0.0, noise_px, p.shape) for p in (p1, p2))
    bad = rng.random(len(p1)) < outlier_share
    p2[bad] = rng.uniform(0.0, [WIDTH, HEIGHT], (bad.sum(), 2))
    return scene, p1, p2


@pytest.mark.parametrize(
    ("name", "noise_px", "outlier_share", "limit_px"),
    [
        *((name, 0.0, 0.0, 1e-4) for name in ESTIMATORS),  # rounding; MAGSAC++ leaves 1e-5
        # Seven parameters from 400 pairs: sigma sqrt(7 / 400) = 0.04 px; three times that and more.
        *((name, 0.3, 0.0, 0.15) for name in ESTIMATORS),
        ("lmeds", 0.3, 0.3, 0.15),
        ("magsac", 0.3, 0.3, 1.0),  # it keeps the noise of its best minimal sample
    ],
)
def test_f_is_found_to_less_than_the_noise(name, noise_px, outlier_share, limit_px):
    for seed in range(3):
        scene, p1, p2 = pairs(seed, noise_px, outlier_share)
        exact_pairs = track_pair(scene, np.linspace(0.0, 20.0, 100))
        F = ESTIMATORS[name](p1, p2)
        assert np.mean(epipolar.epipolar_distance(F, *exact_pairs)) < limit_px
        assert outlier_share or np.linalg.svd(F)[1][2] < 1e-12 * np.linalg.norm(F)


def test_every_estimator_repeats_bit_for_bit_and_the_seed_chooses_the_subsets():
    _, p1, p2 = pairs(seed=0, noise_px=0.3, outlier_share=0.2)
    for estimator in ESTIMATORS.values():
        assert np.array_equal(estimator(p1, p2), estimator(p1, p2))
    few = [fundamental.lmeds_fundamental(p1, p2, trials=5, seed=seed) for seed in (0, 1)]
    assert not np.array_equal(*few)


# --- The pose in F ---

ROUNDING = 1e-7  # of an SVD of E through K, whose condition number is about 200 squared


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_pose_of_an_exact_f_is_recovered_with_either_sign(exact, sign):
    scene, F, p1, p2 = exact
    F = sign * F
    (R, t), in_front = pose.pose_from_fundamental(F, K, K, p1, p2)
    assert in_front == 1.0
    turn = Rotation.from_rotvec([0.02, -0.01, 0.03]).as_matrix()
    starts = (R, t), (turn @ R, t)
    for found in ((R, t), *(pose.nearest_pose(start, F, K, K, p1, p2) for start in starts)):
        assert np.allclose(found[0], scene.R, atol=ROUNDING)
        assert np.allclose(found[1], scene.t / np.linalg.norm(scene.t), atol=ROUNDING)


def test_the_nearest_pose_improves_on_the_decomposition():
    errors_deg = []
    for seed in range(10):
        scene, p1, p2 = pairs(seed, 0.3, angle_deg=30.0)
        F = fundamental.reweighted_fundamental(p1, p2)
        start, _ = pose.pose_from_fundamental(F, K, K, p1, p2)
        nearest = pose.nearest_pose(start, F, K, K, p1, p2)
        turned = pose.nearest_pose(start, -F, K, K, p1, p2)  # F's sign is free
        assert np.allclose(np.vstack(turned), np.vstack(nearest), atol=ROUNDING)
        errors_deg.append([angle_deg(t, scene.t) for _, t in (start, nearest)])
    decomposed, moved = np.mean(errors_deg, axis=0)
    assert moved < 0.8 * decomposed  # half of it, over 100 seeds


def test_pairs_that_disagree_about_the_pose_show_and_those_at_rest_tell_none():
    scene = make_scene(seed=4)
    points = scene.path(np.linspace(0.0, 20.0, 50))
    points[::2] = -points[::2]  # behind camera 1: the same F, another of the four poses
    p1, p2 = project(points), project(points @ scene.R.T + scene.t)
    F = fundamental_from_pose(K, K, scene.R, scene.t)
    assert pose.pose_from_fundamental(F, K, K, p1, p2)[1] == pytest.approx(0.5, abs=0.1)
    at_rest = np.full((2, 40, 2), 100.0)
    assert pose.possible_poses(*at_rest, scene.rig, SearchRules()) == []


def test_a_plane_between_the_cameras_gives_their_pose():
    rng, scene = np.random.default_rng(3), make_scene(0, 120.0)
    R, t = scene.R, scene.t
    # The plane of points, x + 0.2 z = 1, has camera 1 on one side and camera 2 on the other.
    points = rng.uniform([-1.0, -1.0, 4.0], [1.0, 1.0, 6.0], (50, 3))  # both look at their middle
    points[:, 0] = 1.0 - 0.2 * points[:, 2]
    seen = [p / p[:, 2:] for p in (points, points @ R.T + t)]
    sides = np.array([-1.0, -R.T[0] @ t - 0.2 * R.T[2] @ t - 1.0])
    assert sides[0] * sides[1] < 0.0
    distance, poses = pose.homography_poses(*seen)
    assert distance < ROUNDING  # error of OpenCV's homography
    t = t / np.linalg.norm(t)
    errors = [np.abs(at_R - R).max() + np.abs(at_t - t).max() for at_R, at_t in poses]
    assert min(errors) < ROUNDING


@pytest.mark.parametrize("angle", [1e-6, 1.0, 3.0])
def test_rotation_vector_and_centre_move_with_the_pose_as_central_differences(angle):
    R = Rotation.from_rotvec(angle * np.array([0.6, 0.0, 0.8])).as_matrix()
    t, step = np.array([0.8, 0.36, -0.48]), 1e-5

    def moved(by):
        Q, s = pose.moved_pose(R, t, by)
        return np.stack([Rotation.from_matrix(Q).as_rotvec(), -Q.T @ s])

    slopes = np.array([(moved(by) - moved(-by)) / (2.0 * step) for by in step * np.eye(5)])
    vectors, centres = slopes.transpose(1, 0, 2)
    # The errors are of order step^2.
    np.testing.assert_allclose(pose.vector_by_turn(R).T, vectors[:3], atol=1e-9)
    found = pose.centre_covariance(R, t, np.diag([1.0, 2.0, 3.0, 4.0, 5.0]))
    np.testing.assert_allclose(found, centres.T * np.arange(1, 6) @ centres, atol=1e-8)
