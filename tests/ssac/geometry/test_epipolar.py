"""Laws of two views: on exact projections they hold to rounding."""

import warnings

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ssac.geometry import epipolar
from tests.ssac.synthetic import K, make_scene, project, track_pair

ROUNDING_PX = 1e-9  # pixel coordinates of order 100 carry about 1e-14


@pytest.fixture(params=[30.0, 90.0, 150.0])
def exact(request):
    scene = make_scene(seed=1, angle_deg=request.param)
    p1, p2 = track_pair(scene, np.linspace(0.0, 20.0, 100))
    return epipolar.fundamental_from_pose(K, K, scene.R, scene.t), p1, p2


def test_corresponding_points_satisfy_the_epipolar_constraint(exact):
    F, p1, p2 = exact
    assert np.allclose(epipolar.sampson_distance(F, p1, p2), 0.0, atol=ROUNDING_PX)
    assert np.allclose(epipolar.epipolar_distance(F, p1, p2), 0.0, atol=ROUNDING_PX)


def test_f_has_rank_two_and_e_equal_singular_values(exact):
    F, _, _ = exact
    assert np.linalg.svd(F)[1][2] < 1e-15 * np.linalg.norm(F) * 100  # rounding of a 3x3 product
    singular = np.linalg.svd(epipolar.essential_from_fundamental(F, K, K))[1]
    assert np.allclose(singular / singular[0], [1.0, 1.0, 0.0], atol=1e-12)
    back = epipolar.fundamental_from_essential(epipolar.essential_from_fundamental(F, K, K), K, K)
    assert np.allclose(back, F, atol=1e-12 * np.linalg.norm(F))


def test_distance_is_measured_in_image_1(exact):
    F, p1, p2 = exact
    lines = epipolar.epipolar_lines_1(F, p2)
    normals = lines[:, :2] / np.linalg.norm(lines[:, :2], axis=1, keepdims=True)
    assert np.allclose(epipolar.epipolar_distance(F, p1 + 2.5 * normals, p2), 2.5, atol=ROUNDING_PX)


def test_a_point_without_a_line_has_no_finite_distance():
    """Bug: a line at infinity warned of a division by zero."""
    F = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])  # l1 = (1, 0, x2)
    at_infinity = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # (x2, 0, 1)
    p1, p2 = np.array([[3.0, 4.0]]), np.array([[0.0, 5.0]])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert epipolar.epipolar_distance(F, p1, p2) == pytest.approx([3.0])
        assert np.isposinf(epipolar.epipolar_distance(at_infinity, p1, p2)).all()
        assert np.isnan(epipolar.epipolar_distance(np.zeros((3, 3)), p1, p2)).all()


def test_a_rigid_move_of_the_world_changes_nothing():
    rng = np.random.default_rng(0)
    points_W = rng.uniform(-1.0, 1.0, (50, 3))
    R1_W, R2_W = Rotation.random(2, rng).as_matrix()
    t1_W, t2_W = np.array([[0.0, 0.0, 5.0], [0.3, -0.2, 6.0]])
    move, shift = Rotation.random(random_state=1).as_matrix(), np.array([3.0, -2.0, 1.0])

    def relative_pose(R1, t1, R2, t2):
        R = R2 @ R1.T
        return epipolar.fundamental_from_pose(K, K, R, t2 - R @ t1)

    # World points X become move X + shift; so R_W becomes R_W move', t_W: t_W - R_W move' shift.
    F = relative_pose(R1_W, t1_W, R2_W, t2_W)
    moved = [(R @ move.T, t - R @ move.T @ shift) for R, t in ((R1_W, t1_W), (R2_W, t2_W))]
    assert np.allclose(relative_pose(*moved[0], *moved[1]), F, atol=1e-12 * np.linalg.norm(F))
    p1, p2 = project(points_W @ R1_W.T + t1_W), project(points_W @ R2_W.T + t2_W)
    assert np.allclose(epipolar.sampson_distance(F, p1, p2), 0.0, atol=ROUNDING_PX)


def test_sampson_distance_of_noise_has_its_deviation(exact):
    F, p1, p2 = exact
    rng = np.random.default_rng(0)
    noisy = [p + rng.normal(0.0, 0.3, (40, *p.shape)) for p in (p1, p2)]
    distances = [epipolar.sampson_distance(F, a, b) for a, b in zip(*noisy, strict=True)]
    # 4000 distances know their deviation to 1.1 %; second-order terms are far below.
    assert np.std(distances) == pytest.approx(0.3, rel=0.05)


def test_sampson_derivatives_equal_central_differences(exact):
    (F, p1, p2), rng, h = exact, np.random.default_rng(0), 1e-6
    p1 = p1 + rng.normal(0.0, 2.0, p1.shape)  # away from zero, where the norm's derivative counts
    dF = epipolar.fundamental_from_essential(rng.normal(0.0, 1.0, (3, 3)), K, K)
    dp2, gradient = rng.normal(0.0, 100.0, p2.shape), epipolar.sampson_gradient(F, p1, p2)
    for by_F, by_p2, analytic in (
        (0.0, 1.0, epipolar.sampson_derivative(F, p1, p2, dp2)),
        (1.0, 0.0, np.sum(gradient * dF, axis=(1, 2))),
    ):
        upper, lower = (
            epipolar.sampson_distance(F + step * by_F * dF, p1, p2 + step * by_p2 * dp2)
            for step in (h, -h)
        )
        numeric = (upper - lower) / (2 * h)
        # The error of central differences grows with h^2 and with rounding over h: 1e-6 of all.
        assert np.allclose(analytic, numeric, atol=1e-5 * np.abs(numeric).max())
