import numpy as np
import pytest

from ssac.camera import (
    MAX_ROUND_TRIP_PX,
    Camera,
    check_camera,
    distort_points,
    undistort_points,
    undistortion_map,
)
from ssac.errors import SsacError

K = np.array([[200.0, 0.0, 173.0], [0.0, 210.0, 130.0], [0.0, 0.0, 1.0]])
LENSES = [
    ("none", ()),
    ("radtan", (-0.3, 0.1, 1e-3, -5e-4)),
    ("radtan", (0.2, 0.1, -1e-3, 1e-3)),
    ("radtan", (-0.3, 0.1, 1e-3, -5e-4, -0.01)),
    ("equidistant", (-0.05, 0.02, -0.01, 0.003)),
    ("equidistant", (0.0, 0.0, 0.0, 0.0)),
]
POINTS = np.random.default_rng(0).uniform((0, 0), (345, 259), (500, 2))


def _camera(model="none", coeffs=()):
    return Camera(K, 346, 260, model, coeffs)


@pytest.mark.parametrize(("model", "coeffs"), LENSES)
def test_distorting_undoes_undistorting_and_the_other_way_round(model, coeffs):
    camera, points = _camera(model, coeffs), POINTS.copy()
    there_and_back = distort_points(camera, undistort_points(camera, points))
    # These lenses are invertible over the whole sensor.
    np.testing.assert_allclose(there_and_back, POINTS, rtol=0, atol=MAX_ROUND_TRIP_PX)
    back_and_there = undistort_points(camera, distort_points(camera, points))
    # The inverse magnifies the round trip's error by no more than 10 for these lenses.
    np.testing.assert_allclose(back_and_there, POINTS, rtol=0, atol=10 * MAX_ROUND_TRIP_PX)
    np.testing.assert_array_equal(points, POINTS)  # as they were given
    if model == "none":
        np.testing.assert_array_equal(undistort_points(camera, points), POINTS)
        np.testing.assert_array_equal(distort_points(camera, points), POINTS)
    for change in (undistort_points, distort_points):
        assert change(camera, np.empty((0, 2))).shape == (0, 2)


def _kalibr_radtan(x, y, k1, k2, p1, p2):
    r2 = x**2 + y**2
    radial = 1 + k1 * r2 + k2 * r2**2
    return (
        x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x**2),
        y * radial + p1 * (r2 + 2 * y**2) + 2 * p2 * x * y,
    )


def _kalibr_equidistant(x, y, k1, k2, k3, k4):
    r = np.hypot(x, y)
    theta = np.arctan(r)
    theta_d = theta * (1 + k1 * theta**2 + k2 * theta**4 + k3 * theta**6 + k4 * theta**8)
    return x * theta_d / r, y * theta_d / r


@pytest.mark.parametrize(("lens", "formula"), [(1, _kalibr_radtan), (4, _kalibr_equidistant)])
def test_the_models_are_kalibrs(lens, formula):
    x, y = ((POINTS - K[:2, 2]) / (K[0, 0], K[1, 1])).T
    expected = np.column_stack(formula(x, y, *LENSES[lens][1])) * (K[0, 0], K[1, 1]) + K[:2, 2]
    measured = distort_points(_camera(*LENSES[lens]), POINTS)
    # The same formula in another order of operations.
    np.testing.assert_allclose(measured, expected, rtol=0, atol=1e-9)


@pytest.mark.parametrize(("model", "coeffs"), LENSES)
def test_the_principal_point_and_the_map_agree_with_the_points(model, coeffs):
    camera = _camera(model, coeffs)
    table = undistortion_map(camera)
    assert table.shape == (260, 346, 2)
    pixels = np.array([[0.0, 0.0], [345.0, 259.0], [10.0, 200.0]])
    looked_up = table[pixels[:, 1].astype(int), pixels[:, 0].astype(int)]
    np.testing.assert_array_equal(looked_up, undistort_points(camera, pixels))
    # The optical axis is where it is, whatever the radial distortion (p1, p2 vanish there too).
    np.testing.assert_allclose(table[130, 173], (173, 130), rtol=0, atol=MAX_ROUND_TRIP_PX)


def test_points_that_no_ray_reaches_are_nan():
    # r (1 - 0.4 r^2) is at most 0.609, so nothing reaches the sensor's corners at r = 1.06.
    table = undistortion_map(_camera("radtan", (-0.4, 0.0, 0.0, 0.0)))
    assert np.isnan(table[[0, 0, -1, -1], [0, -1, 0, -1]]).all()
    assert np.isfinite(table[80:180, 123:223]).all()


@pytest.mark.parametrize(
    ("camera", "message"),
    [
        (Camera(np.eye(2), 346, 260), "cam0: K must be a finite 3x3 matrix"),
        (Camera(np.where(K == 173, np.nan, K), 346, 260), "K must be a finite 3x3 matrix"),
        (Camera(np.diag([-200.0, 200.0, 1.0]), 346, 260), "focal lengths must be positive"),
        (Camera(K + np.eye(3, k=1), 346, 260), "without skew"),
        (Camera(K, 0, 260), "at least 1 x 1 px and at most 200000000 pixels, got 0 x 260"),
        (_camera("fov", (0.9,)), "unknown distortion model 'fov': use one of none, radtan"),
        (_camera("radtan", (0.1,)), "'radtan' needs 4 or 5 or 8 finite coefficients"),
        (_camera("equidistant", (0, 0, 0, np.nan)), "'equidistant' needs 4 finite coefficients"),
        (_camera("none", (0.1,)), "'none' needs 0 finite coefficients"),
        (Camera(K, 346, 260, readout_s=-0.01), "must take 0 to 0.2 s, .* got -0.01 s and 0.0 s"),
        (Camera(K, 346, 260, readout_s=np.nan), "got nan s"),
        (Camera(K, 346, 260, readout_std_s=-1.0), "got None s and -1.0 s"),
    ],
)
def test_unusable_cameras_and_points_are_refused(camera, message):
    with pytest.raises(SsacError, match=message):
        check_camera(camera, "cam0")
    with pytest.raises(SsacError, match=r"shape \(N, 2\), got \(2,\)"):
        undistort_points(_camera(), np.zeros(2))
