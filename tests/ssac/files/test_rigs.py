"""Rigs as Kalibr and OpenCV write them: what is read of them, and what is refused."""

import re

import cv2
import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from ssac import SsacError
from ssac.camera import Camera, same_camera
from ssac.files.rigs import Step, load_rig, save_rig
from tests.ssac.tracks import rig_document

K = np.array([[200.0, 0.0, 173.0], [0.0, 201.0, 130.0], [0.0, 0.0, 1.0]])
R = cv2.Rodrigues(np.array([0.1, -1.4, 0.2]))[0]
T = np.array([4.0, 0.5, 3.0])
T_2_1 = np.eye(4)
T_2_1[:3, :3], T_2_1[:3, 3] = R, T
COEFFS = (-0.3, 0.1, 0.001, -0.0005)
FIVE = [*COEFFS, 0.02]


def _kalibr():
    """A camchain file's content, with the keys that Kalibr writes and we do not use."""
    lens = {"distortion_model": "radtan", "distortion_coeffs": [*COEFFS]}
    unused = {"cam_overlaps": [1], "rostopic": "/cam0/events"}
    document = rig_document(**lens, **unused, intrinsics=[200.0, 201.0, 173.0, 130.0])
    document["cam1"] |= {"distortion_model": "equidistant", "T_cn_cnm1": T_2_1.tolist()}
    return document


def _write(path, document):
    path.write_text(yaml.safe_dump(document))
    return path


def test_kalibr_camchain(tmp_path):
    document = _kalibr()
    rig = load_rig(_write(tmp_path / "rig.yaml", document))
    for camera, model in ((rig.cam1, "radtan"), (rig.cam2, "equidistant")):
        assert same_camera(camera, Camera(K, 346, 260, model, COEFFS))
        # The defaults: 0.1 % of the focal lengths, 200 and 201 px, and 0.3 px of the centre.
        np.testing.assert_allclose(camera.intrinsics_std_px, (0.200, 0.201, 0.3, 0.3), rtol=1e-12)
    np.testing.assert_array_equal(rig.T_2_1, T_2_1)
    del document["cam1"]["T_cn_cnm1"]
    for coeffs in (None, [], [0.0, 0.0, 0.0, 0.0]):
        document["cam0"] |= {"distortion_model": "none", "distortion_coeffs": coeffs}
        rig = load_rig(_write(tmp_path / "rig.yml", document))
        assert (rig.cam1.distortion_model, rig.cam1.distortion_coeffs) == ("none", ())
        assert rig.T_2_1 is None


def test_any_two_cameras_of_a_rig_that_was_written_are_read_as_they_were(tmp_path):
    cameras = (
        Camera(K, 346, 260),
        Camera(K, 640, 480, "radtan", COEFFS, (2.0, 2.5, 1e-7, 0.0)),
        Camera(K, 346, 260, "radtan", tuple(FIVE), readout_s=0.02),
        Camera(K, 346, 260, "equidistant", (0.1, 0.0, 1 / 3, 0.0)),
    )
    # A rotation about another axis, so that the order of the two steps makes a difference.
    T_4_2 = np.eye(4)
    T_4_2[:3, :3], T_4_2[:3, 3] = cv2.Rodrigues(np.array([0.7, 0.1, -0.3]))[0], (-1.0, 2.0, 0.5)
    first = Step(1, T_2_1, 1 / 3, in_metres=False)
    second = Step(2, T_4_2, -2.0, in_metres=True)  # past a camera without a pose
    path = tmp_path / "rig.yaml"
    save_rig(path, cameras, (None, first, None, second), "made of nothing")
    T_4_1 = T_4_2 @ T_2_1
    for (i, j), (T, in_metres) in {
        (1, 2): (T_2_1, False), (2, 4): (T_4_2, True), (1, 4): (T_4_1, False),
        (4, 1): (np.linalg.inv(T_4_1), False),
        **dict.fromkeys(((1, 3), (3, 4), (4, 4)), (None, True)),
    }.items():  # fmt: skip
        rig = load_rig(path, (i, j))
        for found, camera in ((rig.cam1, cameras[i - 1]), (rig.cam2, cameras[j - 1])):
            assert same_camera(found, camera)
            assert found.intrinsics_std_px == camera.intrinsics_std_px
        np.testing.assert_array_equal(rig.T_2_1, T)
        assert rig.in_metres == in_metres
    entries = [*yaml.safe_load(path.read_text()).values()]
    assert entries[2]["distortion_model"] == "plumb_bob"  # Kalibr's name of five coefficients
    assert entries[1]["timeshift_cn_cnm1"] == 1 / 3
    assert entries[3]["timeshift_cn_cnm2"] == -2.0
    with pytest.raises(SsacError, match="no cam4 for camera 5, only cam0, cam1, cam2, cam3"):
        load_rig(path, (1, 5))


def test_ros_takes_the_second_camera_to_where_it_stands(tmp_path):
    steps = None, Step(1, T_2_1, 0.0, in_metres=True)
    save_rig(tmp_path / "rig.yaml", (Camera(K, 346, 260),) * 2, steps, "a comment")
    lines = (tmp_path / "rig.yaml").read_text().splitlines()
    (words,) = [line.split() for line in lines if "static_transform_publisher" in line]
    given = dict(zip(words[5::2], words[6::2], strict=True))
    assert (given["--frame-id"], given["--child-frame-id"]) == ("cam0", "cam1")
    place = [float(given[f"--{name}"]) for name in ("x", "y", "z")]
    turn = Rotation.from_quat([float(given[f"--{name}"]) for name in ("qx", "qy", "qz", "qw")])
    # The point T of the first frame, brought back from the second; nine digits are written.
    np.testing.assert_allclose(turn.apply(R @ T + T) + place, T, atol=1e-7)


@pytest.mark.parametrize(
    ("camera", "key", "value", "message"),
    [
        ("cam0", "camera_model", "omni", "cam0: camera_model must be pinhole, got 'omni'"),
        ("cam0", "intrinsics", [np.nan, 201, 173, 130], "cam0, intrinsics: expected 4 finite"),
        ("cam0", "intrinsics", "200", "cam0, intrinsics: expected 4 finite numbers, got 200"),
        ("cam0", "intrinsics_std", [0.1], "cam0, intrinsics_std: expected 4 finite num"),
        ("cam1", "readout_s", "fast", "readout_s: expected a finite number, got fast"),
        ("cam0", "resolution", [346], "cam0, resolution: expected 2 finite numbers"),
        ("cam0", "distortion_model", "plumb_bob", "plumb_bob needs 5 coefficients"),
        ("cam1", "distortion_coeffs", [0, 0, 0, np.nan], "distortion_coeffs: expected a list of"),
        ("cam1", "length_unit", "mm", "length_unit: expected m or first_baseline, got mm"),
        ("cam1", "T_cn_cnm1", [[1, 0], [0, 1]], "cam1, T_cn_cnm1: expected 4 x 4 finite"),
        ("cam1", "T_cn_cnm1", np.diag([1, 1, -1, 1]).tolist(), "expected a rotation"),
        # A hundredth longer than a rotation; rounding to four digits changes a ten thousandth.
        ("cam1", "T_cn_cnm1", np.diag([1.01, 1.01, 1.01, 1]).tolist(), "differs from I by 0.02"),
        *(
            ("cam1", key, None, f"cam1: {key} missing")
            for key in ("camera_model", "intrinsics", "distortion_model", "resolution")
        ),
    ],
)
def test_unusable_kalibr_values_are_refused(tmp_path, camera, key, value, message):
    document = _kalibr()
    document[camera][key] = value
    if value is None:
        del document[camera][key]
    with pytest.raises(SsacError, match=rf"rig\.yaml, .*{message}"):
        load_rig(_write(tmp_path / "rig.yaml", document))


def test_what_is_no_rig_is_refused(tmp_path):
    no_camchain = "expected a Kalibr camchain with cam0 and"
    contents = dict.fromkeys((b"", b"hello", b"camera: {}", b"[1, 2]"), no_camchain)
    merged = b"a: &a {k: 1}\nb: {<<: *a}"  # seven such lines of nine each took minutes
    contents |= dict.fromkeys((b"{:", b"\xff\xfe\x00", merged), "not a readable YAML file")
    with pytest.raises(SsacError, match=r"rig\.yaml: there is no such file"):
        load_rig(tmp_path / "rig.yaml")
    for content, message in contents.items():
        (tmp_path / "rig.yaml").write_bytes(content)
        with pytest.raises(SsacError, match=rf"rig\.yaml: {message}"):
            load_rig(tmp_path / "rig.yaml")
    with pytest.raises(SsacError, match=r"unknown extension '\.json' of a rig"):
        load_rig(tmp_path / "rig.json")


def _write_opencv(path, coeffs=FIVE, **more):
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for i in (1, 2):
        storage.write(f"K{i}", K)
        storage.write(f"D{i}", np.array([coeffs]))
    for key, value in more.items():
        storage.write(key, value)
    storage.release()
    path.write_text(path.read_text() + "size: [ 346, 260 ]\n")
    return path


POSE = {"R": R, "T": T[:, None]}


@pytest.mark.parametrize(
    ("letter", "coeffs", "model", "more", "T_2_1"),
    [
        *((letter, tuple(FIVE), "radtan", POSE, T_2_1) for letter in "KM"),
        ("K", COEFFS, "equidistant", {"distortion_model": "equidistant"}, None),
        *(("M", (*FIVE, 0.0, 0.0, 0.1, *n * (0.0,)), "radtan", POSE, T_2_1) for n in (0, 4, 6)),
        ("K", tuple(FIVE), "radtan", POSE | {"length_unit": "m"}, T_2_1),
        ("K", tuple(FIVE), "radtan", POSE | {"length_unit": "first_baseline"}, T_2_1),
    ],
)
def test_opencv_stereo(tmp_path, letter, coeffs, model, more, T_2_1):
    path = _write_opencv(tmp_path / "stereo.yaml", coeffs, **more)
    path.write_text(re.sub(r"^K(?=\d:)", letter, path.read_text(), flags=re.MULTILINE))
    rig = load_rig(path)
    for camera in (rig.cam1, rig.cam2):
        assert same_camera(camera, Camera(K, 346, 260, model, coeffs[:8]))
    np.testing.assert_array_equal(rig.T_2_1, T_2_1)
    np.testing.assert_array_equal(load_rig(path, [1, 2]).T_2_1, T_2_1)
    swapped = load_rig(path, (2, 1))
    assert swapped.in_metres == rig.in_metres == (T_2_1 is None or more.get("length_unit") == "m")
    assert T_2_1 is None or np.linalg.norm(swapped.T_2_1[:3, 3]) == pytest.approx(np.linalg.norm(T))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("size: [ 346, 260 ]", "size: [ 346, 260 ]\nlength_unit: mm", "length_unit: expected m or"),
        ("size: [ 346, 260 ]", "size: [ 346, 260 ]\nreadout_s: 0.02", "readout_s is a key of"),
        ("size: [ 346, 260 ]", "", "the image size is missing: add `size"),
        ("K2", "Q2", "expected a matrix K2"),
        ("200.", ".Nan", "camera 1: K must be a finite 3x3 matrix"),
        ("200.", "nan", "not a readable YAML file"),
        ("cols: 12", "cols: 13", "not a readable YAML file"),
        ("0. ]", "0.01 ]", "camera 1: expected no thin-prism or tilt terms in D1, got"),
        ("dt: d\n   data: [ 4.", "dt: d\n   data: [ .Nan", "T: expected 3 finite numbers"),
    ],
)
def test_unusable_opencv_files_are_refused(tmp_path, old, new, message):
    path = _write_opencv(tmp_path / "stereo.yml", (*FIVE, *7 * (0.0,)), **POSE)
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    with pytest.raises(SsacError, match=rf"stereo\.yml(: |, ){message}"):
        load_rig(path)
    path.write_text(text[:180])
    with pytest.raises(SsacError, match=r"stereo\.yml: not a readable YAML file"):
        load_rig(path)
