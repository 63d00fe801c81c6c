from dataclasses import replace

import cv2
import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from sim.scene.background import load_background, uniform_background
from sim.scene.rig import kalibr_yaml, look_at_rig, two_view_rig
from tests.sim.scenes import LENSES, make_camera, noise_image, rng
from tests.ssac.tracks import rig_document

POINTS_W = rng().uniform(-2.5, 2.5, (500, 3))  # [m], before every camera
POINTS_W[:2] = (0.0, 0.0, 0.0), (1e-9, 0.0, 0.0)  # on the axis of camera 1, and beside it


# By hand: f = 200 px at 5 m, so 1 m is 40 px. Camera 1 has x to its right, z up and y away;
# camera 2, counter-clockwise at (5, 0, 0), looks along -x, with y to its right.
def test_where_the_cameras_stand():
    one, other = two_view_rig(90.0).cameras
    points_W = np.array([(1.0, 0.0, 0.0), (0.0, 0.0, 1.0), (1.0, 5.0, 0.0)])
    np.testing.assert_allclose(one.project(points_W), [(213, 130), (173, 90), (193, 130)])
    points_W = np.array([(0.0, 1.0, 0.0), (2.5, 0.0, 1.0)])
    np.testing.assert_allclose(other.project(points_W), [(213, 130), (173, 50)])


@pytest.mark.parametrize("angle_deg", [30.0, 60.0, 70.0, 90.0, 120.0, 150.0])
def test_extrinsics_follow_from_the_angle_and_relate_the_two_views(angle_deg):
    rig = two_view_rig(angle_deg)
    for camera in rig.cameras:
        # The error is that of cos(90 deg), 6e-17, times 5 m and 200 px.
        np.testing.assert_allclose(camera.project(np.zeros(3)), (173, 130), atol=1e-12)
    R, t, baseline_m = rig.extrinsics()
    assert np.rad2deg(Rotation.from_matrix(R).magnitude()) == pytest.approx(angle_deg)
    assert np.linalg.norm(t) == pytest.approx(1.0)
    assert baseline_m == pytest.approx(10.0 * np.sin(np.deg2rad(angle_deg) / 2))  # a chord
    x1, x2 = (np.c_[POINTS_W, np.ones(500)] @ camera.T_C_W[:3].T for camera in rig.cameras)
    np.testing.assert_allclose(x1 @ R.T + baseline_m * t, x2, atol=1e-13)  # round-off


@pytest.mark.parametrize("lens", LENSES)
def test_projection_agrees_with_opencv_and_nothing_behind_has_an_image(lens):
    camera = make_camera(lens)
    pose = cv2.Rodrigues(camera.T_C_W[:3, :3])[0], camera.T_C_W[:3, 3]
    project = cv2.fisheye.projectPoints if lens == "equidistant" else cv2.projectPoints
    coeffs = np.array(LENSES[lens] or (0.0,) * 4)
    expected, _ = project(POINTS_W[:, None], *pose, camera.K, coeffs)
    # Round-off, of OpenCV's rotation vector above all.
    np.testing.assert_allclose(camera.project(POINTS_W), expected[:, 0], atol=1e-9)
    points_W = np.array([[[0.0, -5.0, 0.0], [0.1, -6.0, 0.0]], [[0.1, 0.0, 0.2], [9e9, -4.9, 0.0]]])
    pixels = camera.project(points_W)
    assert pixels.shape == (2, 2, 2)
    np.testing.assert_array_equal(np.isnan(pixels[..., 0]), [[True, True], [False, True]])


def test_points_past_the_lens_model_are_not_folded_into_the_image():
    # r (1 - 0.1 r^2) turns at r = 1.83 and is 0 again at r = 3.16, the middle of the image.
    camera = replace(make_camera("radtan"), distortion_coeffs=(-0.1, 0.0, 0.0, 0.0))
    assert np.tan(camera.field_angle_rad) == pytest.approx(1.826, rel=0.02)  # the step of its grid
    assert np.isfinite(camera.project(np.array([5 * 1.7, 0.0, 0.0]))).all()
    assert np.isnan(camera.project(np.array([5 * 3.16, 0.0, 0.0]))).all()


def test_kalibr_camchain_keeps_the_truth_to_itself_unless_asked():
    lens = {"distortion_model": "radtan", "distortion_coeffs": [*LENSES["radtan"]]}
    rig = look_at_rig((0, 40, 110, 260), **lens)
    chain = yaml.safe_load(kalibr_yaml(rig, with_extrinsics=True))
    assert list(chain) == ["cam0", "cam1", "cam2", "cam3"]
    assert chain["cam0"] == rig_document(**lens, intrinsics_std=[0.0] * 4)["cam0"]
    for n in (1, 2, 3):
        np.testing.assert_array_equal(chain[f"cam{n}"]["T_cn_cnm1"], rig.relative_pose(n - 1, n))
    blind = kalibr_yaml(two_view_rig(90.0, t_d_s=0.123), with_extrinsics=False)
    assert "T_cn_cnm1" not in blind
    assert "0.123" not in blind
    assert yaml.safe_load(blind)["cam1"]["distortion_coeffs"] == []


CAMERA = make_camera(resolution=(64, 48))


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_images_are_srgb(tmp_path, dtype):
    full = np.iinfo(dtype).max
    srgb = np.linspace(0, full, 48 * 64).astype(dtype).reshape(48, 64)
    cv2.imwrite(str(tmp_path / "wall.png"), srgb)
    light = load_background(tmp_path / "wall.png", CAMERA)
    assert light.dtype == np.float32
    assert (light[0, 0], light[-1, -1]) == (0.0, 1.0)
    middle = np.abs(srgb / full - 0.5).argmin()
    # sRGB 0.5 is linear 0.214; codes are 1/255 apart, and the slope there is 0.9.
    assert light.flat[middle] == pytest.approx(0.2140, abs=2e-3)
    steps = np.diff(light.ravel())
    assert (steps >= 0).all()
    # The line near black and the power law meet; the slope is steepest at white, where it is 2.28.
    assert steps.max() <= 2.3 * np.diff(srgb.ravel().astype(float)).max() / full


@pytest.mark.parametrize("full", [np.uint8(255), np.uint16(65535), np.float32(1.0)])
def test_colours_are_weighted_by_their_light(tmp_path, full):
    path = tmp_path / ("wall.tiff" if full == 1.0 else "wall.png")
    image = (full * rng().random((48, 64))).astype(full.dtype)
    lights = []
    for stored in (image, np.dstack([image] * 3)):  # grey either way
        cv2.imwrite(str(path), stored)
        lights.append(load_background(path, CAMERA))
    np.testing.assert_array_equal(*lights)
    # Rec. 709; OpenCV's order is blue, green, red.
    for rgb, light in (((1, 0, 0), 0.2126), ((0, 1, 0), 0.7152), ((0, 0, 1), 0.0722)):
        cv2.imwrite(str(path), np.full((48, 64, 3), full * np.array(rgb[::-1], full.dtype)))
        np.testing.assert_allclose(load_background(path, CAMERA), light, rtol=1e-6)  # float32


def test_arrays_and_images_of_floating_point_are_linear(tmp_path):
    image = noise_image(CAMERA)
    np.save(tmp_path / "wall.npy", image.astype(np.float64))
    cv2.imwrite(str(tmp_path / "wall.tiff"), image)
    for name in ("wall.npy", "wall.tiff"):
        np.testing.assert_array_equal(load_background(tmp_path / name, CAMERA), image)
    sky = uniform_background(CAMERA, 0.6)
    assert (sky.shape, sky.dtype) == ((48, 64), np.float32)
    assert (sky == np.float32(0.6)).all()
