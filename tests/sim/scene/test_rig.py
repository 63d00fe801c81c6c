from dataclasses import replace

import cv2
import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from sim.scene.rig import Camera, Rig, kalibr_yaml, look_at_rig, two_view_rig

RADTAN = (-0.12, 0.03, 0.002, -0.001)
EQUIDISTANT = (0.02, -0.01, 0.005, -0.002)
LENSES = [("none", ()), ("radtan", RADTAN), ("equidistant", EQUIDISTANT)]
POINTS_W = np.random.default_rng(0).uniform(-2.5, 2.5, (500, 3))  # [m], before every camera
lenses = pytest.mark.parametrize(("model", "coeffs"), LENSES, ids=[model for model, _ in LENSES])


def one_camera(model: str, coeffs: tuple[float, ...] = (), focal_px: float = 200.0) -> Camera:
    rig = look_at_rig((0.0,), focal_px=focal_px, distortion_model=model, distortion_coeffs=coeffs)
    return rig.cameras[0]


# --- Geometry of the rig ----------------------------------------------------------------------


@lenses
def test_origin_projects_to_the_principal_point_of_every_camera(
    model: str, coeffs: tuple[float, ...]
) -> None:
    rig = look_at_rig((0, 30, 90, 150, 260), distortion_model=model, distortion_coeffs=coeffs)
    for camera in rig.cameras:
        # cos(90 deg) is 6e-17, times 5 m and 200 px.
        np.testing.assert_allclose(camera.project(np.zeros(3)), (173, 130), atol=1e-12)


def test_camera_1_stands_in_front_with_the_image_down_below() -> None:
    camera = look_at_rig((0.0,)).cameras[0]
    # By hand: f = 200 px at 5 m, so 1 m is 40 px; x right, z up, y away.
    np.testing.assert_allclose(camera.project(np.array([1.0, 0.0, 0.0])), (213, 130))
    np.testing.assert_allclose(camera.project(np.array([0.0, 0.0, 1.0])), (173, 90))
    np.testing.assert_allclose(camera.project(np.array([1.0, 5.0, 0.0])), (193, 130))


def test_camera_2_stands_counter_clockwise() -> None:
    camera = two_view_rig(90.0).cameras[1]  # at (5, 0, 0), looking along -x, with y to its right
    pixels = camera.project(np.array([[0.0, 1.0, 0.0], [2.5, 0.0, 1.0]]))
    np.testing.assert_allclose(pixels, [(213, 130), (173, 50)])


@pytest.mark.parametrize("angle_deg", [30.0, 60.0, 90.0, 120.0, 150.0])
def test_extrinsics_follow_from_the_angle(angle_deg: float) -> None:
    R, t, baseline_m = two_view_rig(angle_deg).extrinsics()
    assert np.rad2deg(Rotation.from_matrix(R).magnitude()) == pytest.approx(angle_deg)
    assert np.linalg.norm(t) == pytest.approx(1.0)
    assert baseline_m == pytest.approx(10.0 * np.sin(np.deg2rad(angle_deg) / 2))  # a chord


def test_extrinsics_relate_the_two_views() -> None:
    rig = two_view_rig(70.0)
    R, t, baseline_m = rig.extrinsics()
    points_W = np.c_[POINTS_W, np.ones(500)]
    x1 = points_W @ rig.cameras[0].T_C_W.T
    x2 = points_W @ rig.cameras[1].T_C_W.T
    np.testing.assert_allclose(x1[:, :3] @ R.T + baseline_m * t, x2[:, :3], atol=1e-13)  # round-off


def test_relative_poses_chain_and_invert() -> None:
    rig = look_at_rig((0, 40, 110))
    chained = rig.relative_pose(1, 2) @ rig.relative_pose(0, 1)
    np.testing.assert_allclose(chained, rig.relative_pose(0, 2), atol=1e-14)
    round_trip = rig.relative_pose(2, 0) @ rig.relative_pose(0, 2)
    np.testing.assert_allclose(round_trip, np.eye(4), atol=1e-14)


@lenses
def test_a_rigid_move_of_the_world_changes_nothing(model: str, coeffs: tuple[float, ...]) -> None:
    rig = look_at_rig((0, 75), distortion_model=model, distortion_coeffs=coeffs)
    T_V_W = np.eye(4)  # a world V instead of W
    T_V_W[:3, :3] = Rotation.from_rotvec([0.3, -1.0, 2.0]).as_matrix()
    T_V_W[:3, 3] = (4.0, -7.0, 1.0)
    points_V = POINTS_W @ T_V_W[:3, :3].T + T_V_W[:3, 3]
    T_W_V = np.linalg.inv(T_V_W)
    moved = Rig(tuple(replace(camera, T_C_W=camera.T_C_W @ T_W_V) for camera in rig.cameras))
    for before, after in zip(rig.cameras, moved.cameras, strict=True):
        # Round-off of 10 m in 200 px per unit of depth.
        np.testing.assert_allclose(after.project(points_V), before.project(POINTS_W), atol=1e-10)
    for a, b in zip(rig.extrinsics(), moved.extrinsics(), strict=True):
        np.testing.assert_allclose(a, b, atol=1e-13)


def test_clocks() -> None:
    assert [c.time_offset_s for c in two_view_rig(90.0, t_d_s=0.05).cameras] == [0.0, 0.05]
    rig = look_at_rig((0, 10, 20), time_offsets_s=(0.0, -0.1, 0.2))
    assert [(c.name, c.time_offset_s) for c in rig.cameras] == [
        ("cam1", 0.0),
        ("cam2", -0.1),
        ("cam3", 0.2),
    ]


# --- Projection and distortion ----------------------------------------------------------------


def test_projection_agrees_with_opencv() -> None:
    for model, coeffs in LENSES:
        camera = one_camera(model, coeffs)
        rotation_vector, translation = cv2.Rodrigues(camera.T_C_W[:3, :3])[0], camera.T_C_W[:3, 3]
        distortion = np.array(coeffs or (0.0,) * 4)
        if model == "equidistant":
            expected, _ = cv2.fisheye.projectPoints(
                POINTS_W[:, None], rotation_vector, translation, camera.K, distortion
            )
        else:
            expected, _ = cv2.projectPoints(
                POINTS_W, rotation_vector, translation, camera.K, distortion
            )
        # Round-off, of OpenCV's rotation vector above all.
        np.testing.assert_allclose(camera.project(POINTS_W), expected[:, 0], atol=1e-9)


def test_equidistant_is_smooth_on_the_axis() -> None:
    camera = one_camera("equidistant", EQUIDISTANT)
    np.testing.assert_array_equal(camera.project(np.zeros(3)), (173, 130))
    nearly = camera.project(np.array([1e-9, 0.0, 0.0]))
    np.testing.assert_allclose(nearly, (173, 130), atol=1e-7)  # 1e-9 m are 4e-8 px


@lenses
def test_points_behind_the_camera_have_no_image(model: str, coeffs: tuple[float, ...]) -> None:
    camera = one_camera(model, coeffs)
    points_W = np.array([[[0.0, -5.0, 0.0], [0.1, -6.0, 0.0]], [[0.1, 0.0, 0.2], [9e9, -4.9, 0.0]]])
    pixels = camera.project(points_W)
    assert pixels.shape == (2, 2, 2)
    np.testing.assert_array_equal(np.isnan(pixels[..., 0]), [[True, True], [False, True]])


def test_points_past_the_lens_model_are_not_folded_into_the_image() -> None:
    # r (1 - 0.1 r^2) turns at r = 1.83 and is 0 again at r = 3.16, the middle of the image.
    camera = one_camera("radtan", (-0.1, 0.0, 0.0, 0.0))
    assert np.tan(camera.field_angle_rad) == pytest.approx(1.826, rel=0.02)  # its grid's step
    assert np.isfinite(camera.project(np.array([5 * 1.7, 0.0, 0.0]))).all()
    assert np.isnan(camera.project(np.array([5 * 3.16, 0.0, 0.0]))).all()


# --- Kalibr's YAML ----------------------------------------------------------------------------


def test_kalibr_camchain() -> None:
    rig = look_at_rig((0, 40, 110), distortion_model="radtan", distortion_coeffs=RADTAN)
    chain = yaml.safe_load(kalibr_yaml(rig, with_extrinsics=True))
    assert list(chain) == ["cam0", "cam1", "cam2"]
    assert chain["cam0"] == {
        "camera_model": "pinhole",
        "intrinsics": [200.0, 200.0, 173.0, 130.0],
        "intrinsics_std": [0.0, 0.0, 0.0, 0.0],
        "distortion_model": "radtan",
        "distortion_coeffs": list(RADTAN),
        "resolution": [346, 260],
    }
    for n in (1, 2):
        np.testing.assert_array_equal(chain[f"cam{n}"]["T_cn_cnm1"], rig.relative_pose(n - 1, n))


def test_kalibr_camchain_keeps_the_truth_to_itself() -> None:
    text = kalibr_yaml(two_view_rig(90.0, t_d_s=0.123), with_extrinsics=False)
    assert "T_cn_cnm1" not in text
    assert "0.123" not in text
    assert yaml.safe_load(text)["cam1"]["distortion_coeffs"] == []


# --- Bad input --------------------------------------------------------------------------------
