"""Rig files: Kalibr camchains, which are read and written, and OpenCV stereo YAML, only read."""

import re
import reprlib
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
import yaml
from scipy.spatial.transform import Rotation

from ssac.arrays import Array
from ssac.camera import Camera, Rig, check_camera, check_transform
from ssac.errors import SsacError
from ssac.files.damage import check_is_file, readable, silenced
from ssac.files.whole_file import write_whole

RIG_SUFFIXES = (".yaml", ".yml")

LENGTH_UNITS = ("m", "first_baseline")
"""Values of a camera's `length_unit`: metre, or distance between the first two cameras placed."""


class Step(NamedTuple):
    """The pose and the time offset of a camera n relative to an earlier camera of the chain."""

    back: int  # the earlier camera is n - back; Kalibr's own files have only 1
    T: Array  # (4, 4) x_n = T x_(n - back)
    shift_s: float  # t_n = t_(n - back) + shift_s
    in_metres: bool  # False: T's unit is the distance between the first two cameras placed


def load_rig(path: Path | str, cameras: tuple[int, int] = (1, 2)) -> Rig:
    """Read two cameras of a rig, and their relative pose if the file has it.

    Parameters
    ----------
    path
        A Kalibr camchain, or the YAML of OpenCV's stereo calibration (docs/sync.md). In a camchain
        a pose may skip cameras that have none, as `T_cn_cnm2` does; an OpenCV file's distortion
        is radtan unless the key `distortion_model` says `equidistant`.
    cameras
        Numbers in the rig, from 1, of the cameras to return as 1 and 2; they may be equal.

    Returns
    -------
    Rig
        Cameras with valid intrinsics, whose deviations are those of a good calibration if the file
        states none; T_2_1 in metres if the key `length_unit` of a camera, or of an OpenCV file,
        says `m`. Without the key, a camchain's is in metres, and an OpenCV file's in a unit that is
        not known: it is that of the board's squares.
    """
    path = Path(path)
    if path.suffix.lower() not in RIG_SUFFIXES:
        raise SsacError(f"{path}: unknown extension {path.suffix!r} of a rig: use .yaml or .yml")
    check_is_file(path)
    most_bytes = 1 << 20  # a rig of a hundred cameras has less
    if path.stat().st_size > most_bytes:
        raise SsacError(
            f"{path}: is no rig, which has less than {most_bytes} bytes: check the path"
        )
    with readable(path, "a readable YAML file of a rig"), silenced():
        text = path.read_text(encoding="utf-8")
        if "<<" in text or "!!merge" in text:
            raise ValueError("merge keys, by which a few lines can stand for millions")
        if "!!opencv-matrix" in text:
            return _rig_from_opencv(path, text, cameras)
        return _rig_from_kalibr(path, yaml.safe_load(text), cameras)


def save_rig(
    path: Path, cameras: Sequence[Camera], steps: Sequence[Step | None], comment: str
) -> None:
    """Write a Kalibr camchain that `load_rig` reads, with a ROS command for each pose as a comment.

    `steps` has for each camera its step from an earlier one; None if unknown, as for the first.
    """
    chain, lines = dict[str, dict[str, Any]](), [f"# {comment}"]
    for k, (camera, step) in enumerate(zip(cameras, steps, strict=True)):
        entry = chain[f"cam{k}"] = camchain_entry(camera)
        if step is not None:
            back, T, shift_s, in_metres = step
            entry[f"T_cn_cnm{back}"] = T.tolist()
            entry["length_unit"] = LENGTH_UNITS[not in_metres]
            entry[f"timeshift_cn_cnm{back}"] = float(shift_s)
            values = *(-T[:3, :3].T @ T[:3, 3]), *Rotation.from_matrix(T[:3, :3].T).as_quat()
            names = ("x", "y", "z", "qx", "qy", "qz", "qw")
            place = " ".join(f"--{name} {v:.9g}" for name, v in zip(names, values, strict=True))
            frames = f"--frame-id cam{k - back} --child-frame-id cam{k}"
            lines.append(f"# ros2 run tf2_ros static_transform_publisher {place} {frames}")
    text = yaml.safe_dump(chain, default_flow_style=None, sort_keys=False)
    write_whole(path, "\n".join([*lines, text]))


def camchain_entry(camera: Camera) -> dict[str, Any]:
    """Return a camera as it stands in a camchain, with what is stated beside its intrinsics."""
    has_k3 = camera.distortion_model == "radtan" and len(camera.distortion_coeffs) == 5
    entry: dict[str, Any] = {
        "camera_model": "pinhole",
        "intrinsics": [*np.diag(camera.K)[:2].tolist(), *camera.K[:2, 2].tolist()],
        "distortion_model": "plumb_bob" if has_k3 else camera.distortion_model,
        "distortion_coeffs": list(camera.distortion_coeffs),
        "resolution": [camera.width, camera.height],
    }
    if camera.states_intrinsics:
        entry["intrinsics_std"] = list(camera.intrinsics_std_px)
    if camera.readout_s is not None:
        entry["readout_s"] = camera.readout_s
    return entry


def _rig_from_kalibr(path: Path, document: Any, cameras: tuple[int, int]) -> Rig:
    keys = document if isinstance(document, Mapping) else ()
    known = [key for key in keys if re.fullmatch(r"cam\d+", str(key))]
    if not known:
        raise SsacError(
            f"{path}: expected a Kalibr camchain with cam0 and cam1, or an OpenCV stereo file: "
            "give the result of a two-camera calibration"
        )
    wanted = [f"cam{number - 1}" for number in cameras]
    for number, key in zip(cameras, wanted, strict=True):
        if key not in known:
            raise SsacError(
                f"{path}: there is no {key} for camera {number}, only {', '.join(sorted(known))}: "
                "add it, or give the number of another camera"
            )
    cam1, cam2 = (_camera_from_kalibr(f"{path}, {key}", document[key]) for key in wanted)
    first, k = sorted(number - 1 for number in cameras)
    steps, units = list[Array](), list[str]()
    while k > first:  # from the later camera back to the earlier
        name, entry = f"{path}, cam{k}", document.get(f"cam{k}", {})
        back = next((n for n in range(1, k - first + 1) if f"T_cn_cnm{n}" in entry), None)
        if back is None:
            return Rig(cam1, cam2)
        steps.append(_numbers(entry[f"T_cn_cnm{back}"], (4, 4), f"{name}, T_cn_cnm{back}"))
        check_transform(steps[-1], f"{name}, T_cn_cnm{back}")
        units.append(_length_unit(entry.get("length_unit", LENGTH_UNITS[0]), name))
        k -= back
    if not steps:
        return Rig(cam1, cam2)
    T = np.eye(4)
    for step in reversed(steps):
        T = step @ T
    T = T if cameras[0] < cameras[1] else np.asarray(np.linalg.inv(T))
    return Rig(cam1, cam2, T, set(units) == {LENGTH_UNITS[0]})


def _length_unit(unit: Any, name: str) -> str:
    if unit not in LENGTH_UNITS:
        expected = f"expected {' or '.join(LENGTH_UNITS)}, got {_shown(unit)}"
        raise SsacError(f"{name}, length_unit: {expected}: correct it")
    return str(unit)


def _camera_from_kalibr(name: str, entry: Any) -> Camera:
    keys = ("camera_model", "intrinsics", "distortion_model", "resolution")
    missing = [key for key in keys if not isinstance(entry, Mapping) or key not in entry]
    if missing:
        raise SsacError(f"{name}: {', '.join(missing)} missing: calibrate with Kalibr, or add it")
    if entry["camera_model"] != "pinhole":
        raise SsacError(
            f"{name}: camera_model must be pinhole, got {_shown(entry['camera_model'])!r}: "
            "calibrate with pinhole-radtan or pinhole-equi"
        )
    fu, fv, pu, pv = _numbers(entry["intrinsics"], (4,), f"{name}, intrinsics")
    size = _numbers(entry["resolution"], (2,), f"{name}, resolution")
    coeffs = _numbers(entry.get("distortion_coeffs") or [], (-1,), f"{name}, distortion_coeffs")
    K = np.array([[fu, 0.0, pu], [0.0, fv, pv], [0.0, 0.0, 1.0]])
    model = entry["distortion_model"]
    model = model if isinstance(model, str) else _shown(model)
    if model == "plumb_bob" and len(coeffs) != 5:
        raise SsacError(
            f"{name}: plumb_bob needs 5 coefficients k1 k2 p1 p2 k3, got {len(coeffs)}: "
            "add those missing, as 0 where they are"
        )
    deviations = None  # those of a good calibration
    if "intrinsics_std" in entry:
        numbers = _numbers(entry["intrinsics_std"], (4,), f"{name}, intrinsics_std")
        deviations = tuple(numbers.tolist())
    readout_s = entry.get("readout_s")  # of a rolling shutter; 0: global shutter
    if readout_s is not None:
        readout_s = float(_numbers(readout_s, (), f"{name}, readout_s"))
    model = "radtan" if model == "plumb_bob" else model
    return _checked_camera(name, K, size, model, coeffs, deviations, readout_s)


def _rig_from_opencv(path: Path, text: str, cameras: tuple[int, int]) -> Rig:
    if not set(cameras) <= {1, 2}:
        raise SsacError(
            f"{path}: an OpenCV stereo file has cameras 1 and 2, but camera {max(cameras)} was "
            "asked for: give a Kalibr camchain of all cameras"
        )
    storage = cv2.FileStorage(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
    for key in ("intrinsics_std", "readout_s"):
        if not storage.getNode(key).empty():
            raise SsacError(
                f"{path}: {key} is a key of a Kalibr camchain's cameras, and this is OpenCV's file:"
                " make a camchain of it (--write-rig), and add it there"
            )

    def matrix(key: str) -> Array:
        node = storage.getNode(key)
        if node.empty():
            raise SsacError(f"{path}: expected a matrix {key}: add it from the calibration")
        return np.asarray(node.mat(), dtype=np.float64)

    def camera(i: int) -> Camera:
        of_sample = f"M{i}"  # as OpenCV's own sample of a stereo calibration writes it
        K = matrix(f"K{i}" if storage.getNode(of_sample).empty() else of_sample)
        coeffs, size = matrix(f"D{i}").ravel(), storage.getNode("size")
        if not (size.isSeq() and size.size() == 2):
            raise SsacError(f"{path}: the image size is missing: add `size: [ width, height ]`")
        sides = [size.at(axis).real() for axis in range(2)]
        model = storage.getNode("distortion_model").string() or "radtan"
        if coeffs[8:].any():  # OpenCV writes 14 for a rational model, the last six as zeros
            raise SsacError(
                f"{path}, camera {i}: expected no thin-prism or tilt terms in D{i}, got"
                f" {coeffs[8:].tolist()}: calibrate without those models"
            )
        return _checked_camera(f"{path}, camera {i}", K, sides, model, coeffs[:8])

    cam1, cam2 = map(camera, cameras)
    if cameras[0] == cameras[1] or (storage.getNode("R").empty() and storage.getNode("T").empty()):
        return Rig(cam1, cam2)
    T_2_1 = np.eye(4)
    T_2_1[:3, :3] = _numbers(matrix("R"), (3, 3), f"{path}, R")
    T_2_1[:3, 3] = _numbers(matrix("T").ravel(), (3,), f"{path}, T")
    check_transform(T_2_1, f"{path}, R")
    unit = storage.getNode("length_unit")  # a key of ours: OpenCV itself states no unit
    in_metres = not unit.empty() and _length_unit(unit.string(), str(path)) == LENGTH_UNITS[0]
    T_2_1 = T_2_1 if cameras[0] < cameras[1] else np.asarray(np.linalg.inv(T_2_1))
    return Rig(cam1, cam2, T_2_1, in_metres)


def _checked_camera(
    name: str, K: Array, size: Iterable[float], distortion_model: str, coeffs: Array, *more: Any
) -> Camera:
    """Make and check a camera; the model "none" may have coefficients that are all zero."""
    if distortion_model == "none" and not coeffs.any():
        coeffs = coeffs[:0]
    width, height = map(int, size)
    camera = Camera(K, width, height, distortion_model, tuple(coeffs.tolist()), *more)
    check_camera(camera, name)
    return camera


def _numbers(value: Any, shape: tuple[int, ...], name: str) -> Array:
    """Return a finite array of the given shape (-1: any length); SsacError otherwise."""
    try:
        numbers = np.array(value if _is_shaped(value, shape) else np.nan, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        numbers = np.array(np.nan)
    if not np.isfinite(numbers).all():
        words = {(): "a finite number", (-1,): "a list of finite numbers"}
        expected = words.get(shape, f"{' x '.join(map(str, shape))} finite numbers")
        raise SsacError(f"{name}: expected {expected}, got {_shown(value)}: correct it")
    return numbers


def _shown(value: Any) -> str:
    """Shorten a value from a file for a message."""
    short = reprlib.Repr()
    short.maxlevel = 2  # YAML's lists may be nested without end
    return value[:40] if isinstance(value, str) else short.repr(value)[:200]


def _is_shaped(value: Any, shape: tuple[int, ...]) -> bool:
    """Whether nested lists have a shape, tested before conversion: YAML's may be endless."""
    if isinstance(value, np.ndarray):
        return bool(value.shape == shape)
    if not shape:
        return isinstance(value, (int, float, str))
    if not isinstance(value, (list, tuple)):
        return False
    most = 14  # coefficients of OpenCV's largest lens model
    right = len(value) <= most if shape[0] == -1 else len(value) == shape[0]
    return right and all(_is_shaped(item, shape[1:]) for item in value)
