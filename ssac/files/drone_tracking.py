"""Conversion of public drone-tracking data sets to our track files and rig file.

The data sets (github.com/CenekAlbl/drone-tracking-datasets, Li et al., IROS 2020) are not ours to
ship: their licence is CC BY-NC-SA. A folder has `cameras.txt` and `detections/camK.txt`, with a
line `frame x y` for each frame (0 0: nothing seen). Beside it stands `calibration/MODEL/*.json`.
"""

import json
import re
from dataclasses import dataclass
from pathlib import Path
from statistics import mode

import numpy as np
import yaml

from ssac.arrays import Array
from ssac.camera import Camera, check_camera, with_deviations
from ssac.errors import SsacError
from ssac.files.damage import is_number, readable
from ssac.files.rigs import camchain_entry
from ssac.files.track_files import save_track
from ssac.files.whole_file import write_whole
from ssac.points import PointTrack, check_track

OF_DATA_SET = {"mate10": ("mate10_1", "mate10_2"), "sonyG": ("sonyG_1", "sonyG_2")}
"""Calibrations of each model that has two: for data sets 1 and 2, and for the later ones."""

KEYFRAMES = {4: 4}
"""For each data set of which only every n-th frame was labelled, n. The frames between are
interpolated, and would make deviations too small."""

FOCAL_STD, CENTRE_STD_PX = 0.005, 3.0
"""Deviations of phones' and camcorders' intrinsics, which focus and stabilisation change: between
those of a good calibration, which camera 1 of data set 1 contradicts, and of a careless one."""

_REMEDY = "get the file again"
_LINE = re.compile(r"cam(\d+)\s*-\s*(\S+)")


@dataclass(frozen=True)
class ImportedCamera:
    """One camera of a data set."""

    name: str  # camK, in its files and in the rig
    model: str
    fps: float  # frame rate [1/s] that its calibration states
    camera: Camera
    track: PointTrack
    n_outside: int  # number of points outside the image, which are left out


def import_data_set(folder: Path, out: Path) -> list[ImportedCamera]:
    """Write `camK.csv` for each camera of a data set, and `rig.yaml` with the same names."""
    listing = folder / "cameras.txt"
    if not listing.is_file():
        raise SsacError(
            f"{folder}: expected a data set with cameras.txt and detections/: give such a folder"
        )
    with readable(listing, "a list of cameras"):
        rows = _LINE.findall(listing.read_text(encoding="utf-8"))
    if not rows:
        raise SsacError(f"{listing}: expected lines like `cam0 - gopro3`: {_REMEDY}")
    for _, model in rows:
        if model == ".." or Path(model).name != model:  # it names a file of the calibrations
            raise SsacError(f"{listing}: expected a camera's name, got {model!r}: correct it")
    numbers = [k for k, _ in rows]
    if len(set(numbers)) < len(numbers):
        raise SsacError(f"{listing}: cam{mode(numbers)} is there twice: leave one out")
    number = re.search(r"\d+$", folder.resolve().name)
    if number is None:
        raise SsacError(
            f"{folder}: expected a name that ends in the data set's number, as dataset3, by which "
            "its calibrations are chosen: rename the folder"
        )
    cameras = [_camera(folder, f"cam{k}", model, int(number[0])) for k, model in rows]
    out.mkdir(parents=True, exist_ok=True)
    for camera in cameras:
        save_track(out / f"{camera.name}.csv", camera.track)
    rig = {one.name: camchain_entry(one.camera) for one in cameras}
    write_whole(out / "rig.yaml", yaml.safe_dump(rig, sort_keys=False))
    return cameras


def _camera(folder: Path, name: str, model: str, number: int) -> ImportedCamera:
    camera, fps = _calibration(folder.parent / "calibration" / model, model, number)
    path = folder / "detections" / f"{name}.txt"
    frames, points = _detections(path)
    step = KEYFRAMES.get(number, 1)
    seen = (points != 0.0).any(axis=1) & (frames % step == 1 % step)
    size = np.array([camera.width, camera.height])
    inside = np.all((points >= -0.5) & (points <= size - 0.5), axis=1)
    kept = seen & inside
    if not kept.any():
        raise SsacError(f"{path}: the object is seen in no frame: {_REMEDY}")
    track = PointTrack(frames[kept] / fps, points[kept])
    check_track(track, camera.width, camera.height, str(path))
    return ImportedCamera(name, model, fps, camera, track, int(np.count_nonzero(seen & ~inside)))


def _calibration(folder: Path, model: str, number: int) -> tuple[Camera, float]:
    name = OF_DATA_SET.get(model, (model, model))[number >= 3]
    path = folder / f"{name}.json"
    form = "a calibration with K-matrix, distCoeff, fps and resolution"
    with readable(path, form, _REMEDY):
        found = json.loads(path.read_text(encoding="utf-8"))
        K = np.array(found["K-matrix"], dtype=np.float64)
        coeffs = [float(value) for value in found["distCoeff"]]
        width, height = (int(value) for value in found["resolution"])
        fps = float(found["fps"])
        if not 0.0 < fps < np.inf:
            raise ValueError(f"{fps:g} frames a second")
        if K.shape != (3, 3):
            raise ValueError(f"a K-matrix of shape {K.shape}")
    camera = Camera(K, width, height, "radtan", tuple(coeffs))
    check_camera(camera, str(path))
    return with_deviations(camera, FOCAL_STD, CENTRE_STD_PX), fps


def _detections(path: Path) -> tuple[Array, Array]:
    """Read frame numbers (n,) and points (n, 2) [px]; a header line is skipped."""
    with readable(path, "a list of lines `frame x y`", _REMEDY):
        lines = path.read_text(encoding="utf-8").splitlines()
        rows = [line.split() for line in lines if line.strip()]
        if rows and not is_number(rows[0][0]):
            rows = rows[1:]
        table = np.array(rows, dtype=np.float64).reshape(-1, 3)
        if not np.isfinite(table[:, 0]).all():
            raise ValueError("a frame's number is not finite")
    return table[:, 0], table[:, 1:]
