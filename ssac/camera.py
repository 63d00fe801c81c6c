"""Cameras and rigs, their checks, and points with and without the distortion of a lens.

The lens models are Kalibr's two: "radtan" (radial-tangential, OpenCV's k1, k2, p1, p2, and k3 to k6
where a calibration by OpenCV has them) and "equidistant" (OpenCV's fisheye k1 to k4). Undistorted
("ideal") points keep the camera's K, so that without distortion they are the measured points.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np

from ssac.arrays import Array
from ssac.errors import SsacError

DISTORTION_LENGTHS = {"none": (0,), "radtan": (4, 5, 8), "equidistant": (4,)}
"""Numbers of distortion coefficients that each lens model may have."""

# Standard deviations of a good calibration: focal lengths (as a share of them), principal point.
GOOD_FOCAL, GOOD_CENTRE_PX = 0.001, 0.3
LEAST_FOCAL_SIDES, MOST_FOCAL_SIDES = 0.1, 100.0
"""Bounds of a focal length, in sides of the image: beyond, it is not in pixels of this image."""

MAX_PIXELS = 200_000_000  # of a sensor: tables with an entry for each pixel still fit into memory
MAX_READOUT_S = 0.2  # longest readout of a rolling shutter: slow sensors of still cameras
READOUT_STD_S = 0.015  # prior deviation of an unknown readout from 0: phones have 10 to 30 ms
MAX_ROUND_TRIP_PX = 1e-6  # of a point that is undistorted, and distorted again


@dataclass(frozen=True)
class Camera:
    """Intrinsics of one camera (Kalibr's pinhole model)."""

    K: Array  # (3, 3) [px], pixel centres at integer coordinates
    width: int  # [px]
    height: int  # [px]
    distortion_model: str = "none"  # "none", "radtan" or "equidistant"
    distortion_coeffs: tuple[float, ...] = ()  # 4 values unless "none"; OpenCV's radtan also 5, 8
    intrinsics_std_px: tuple[float, ...] = None  # type: ignore[assignment]
    """Standard deviations of fu, fv, pu, pv [px]; 0: exact. Left out: of a good calibration."""
    readout_s: float | None = None  # rolling shutter, first row to last [s]; None: unknown, so 0
    readout_std_s: float = 0.0  # prior standard deviation of readout_s [s]; 0: it is not estimated
    centre_was_exchanged: bool = False  # the rig states (pv, pu): see `with_usual_centres`

    def __post_init__(self) -> None:
        K = _floats(self.K)  # NaN if it is no array of numbers: `check_camera` reports it
        object.__setattr__(self, "K", K)
        if self.intrinsics_std_px is None:
            object.__setattr__(self, "intrinsics_std_px", self._good_std_px)
        for name in ("distortion_coeffs", "intrinsics_std_px"):  # lists and arrays too
            values = _floats(getattr(self, name))
            if values.ndim == 1 and not np.isnan(values).all():
                object.__setattr__(self, name, tuple(values.tolist()))

    @property
    def states_intrinsics(self) -> bool:
        """Whether the intrinsics' deviations are stated, and not those of a good calibration."""
        return tuple(self.intrinsics_std_px) != self._good_std_px

    @property
    def _good_std_px(self) -> tuple[float, ...]:
        focal_px = GOOD_FOCAL * np.ravel(self.K)[:5:4]
        return (*focal_px.tolist(), GOOD_CENTRE_PX, GOOD_CENTRE_PX)


@dataclass(frozen=True)
class Rig:
    """Two cameras and, where it is known, the transform from camera 1 to camera 2."""

    cam1: Camera  # its frame and its clock are those of the rig
    cam2: Camera  # the other
    T_2_1: Array | None = None  # (4, 4), x2 = T_2_1 x1, [m]
    in_metres: bool = True  # False: T_2_1 is in an unknown unit, as the distance between cameras

    @property
    def is_exact(self) -> bool:
        """Whether all intrinsics are stated to be exact."""
        return not any(self.cam1.intrinsics_std_px) and not any(self.cam2.intrinsics_std_px)

    @property
    def unposed(self) -> "Rig":
        """The same cameras without the pose, for a method that is not given it."""
        return Rig(self.cam1, self.cam2)


@dataclass(frozen=True)
class Cameras:
    """Any number of cameras and, where they are known, the transforms from each to the next."""

    cameras: tuple[Camera, ...]  # in the order of their recordings
    steps: tuple[Array | None, ...] = ()  # (4, 4) each, x_next = T x, [m]
    name: str = "the rig"  # for messages: a file's path
    in_metres: bool = True  # as in `Rig`

    def __len__(self) -> int:
        return len(self.cameras)

    def pair(self, i: int, j: int) -> Rig:
        """Return cameras i and j, counted from 0 and i before j, as cameras 1 and 2 of a rig."""
        T = np.eye(4)
        for step in self.steps[i:j] or (None,):
            if step is None:
                return Rig(self.cameras[i], self.cameras[j])
            T = step @ T
        return Rig(self.cameras[i], self.cameras[j], T, self.in_metres)


def with_deviations(
    camera: Camera, focal: float | None = GOOD_FOCAL, centre_px: float | None = GOOD_CENTRE_PX
) -> Camera:
    """Set deviations of focal lengths (as a share) and principal point; None: keep the camera's."""
    said = tuple(camera.intrinsics_std_px)
    fu_px, fv_px = float(camera.K[0, 0]), float(camera.K[1, 1])
    focals = said[:2] if focal is None else (focal * fu_px, focal * fv_px)
    centre = said[2:] if centre_px is None else (centre_px, centre_px)
    return replace(camera, intrinsics_std_px=focals + centre)


def to_be_read_out(camera: Camera) -> Camera:
    """Give a track's camera the prior of an unknown readout, unless a readout is stated."""
    return replace(camera, readout_std_s=READOUT_STD_S) if camera.readout_s is None else camera


def same_camera(a: Camera, b: Camera) -> bool:
    """Whether two cameras map points alike; `==` cannot tell, as K is an array."""
    names = "width", "height", "distortion_model", "distortion_coeffs", "readout_s", "readout_std_s"
    same = all(getattr(a, name) == getattr(b, name) for name in names)
    return same and np.array_equal(a.K, b.K)


def check_camera(camera: Camera, name: str = "camera") -> None:
    """Raise SsacError unless `camera` is a usable pinhole camera; `name` starts the message."""
    if not isinstance(camera, Camera):
        raise SsacError(f"{name}: expected a ssac.Camera, got {type(camera).__name__}")
    K, model = camera.K, camera.distortion_model
    coeffs, deviations = _floats(camera.distortion_coeffs), _floats(camera.intrinsics_std_px)
    readout = _floats([camera.readout_s or 0.0, camera.readout_std_s])
    size = camera.width, camera.height
    said = ""
    if K.shape != (3, 3) or not np.isfinite(K).all():
        said = f"K must be a finite 3x3 matrix, got {K.tolist()}: calibrate again"
    elif K[0, 0] <= 0 or K[1, 1] <= 0:
        said = (
            f"focal lengths must be positive, got fu = {K[0, 0]:g}, fv = {K[1, 1]:g} px: "
            "check the order [fu, fv, pu, pv] of the intrinsics"
        )
    elif K[0, 1] != 0 or K[1, 0] != 0 or not np.array_equal(K[2], (0.0, 0.0, 1.0)):
        said = (
            f"K must be [[fu, 0, pu], [0, fv, pv], [0, 0, 1]], got {K.tolist()}: "
            "calibrate with a pinhole model without skew"
        )
    elif not (
        all(isinstance(side, (int, np.integer)) and side >= 1 for side in size)
        and camera.width * camera.height <= MAX_PIXELS
    ):
        said = (
            f"the resolution must be at least 1 x 1 px and at most {MAX_PIXELS} pixels, "
            f"got {camera.width} x {camera.height}: give it as [width, height]"
        )
    elif not all(
        LEAST_FOCAL_SIDES <= K[axis, axis] / side <= MOST_FOCAL_SIDES
        for axis, side in enumerate(size)
    ):
        said = (
            f"focal lengths of {K[0, 0]:g} and {K[1, 1]:g} px are no camera's of"
            f" {camera.width} x {camera.height} px: give them in pixels of this resolution, not mm"
        )
    elif model not in tuple(DISTORTION_LENGTHS):
        known = ", ".join(DISTORTION_LENGTHS)
        said = f"unknown distortion model {model!r}: use one of {known}"
    elif (
        coeffs.ndim != 1
        or len(coeffs) not in DISTORTION_LENGTHS[model]
        or not np.isfinite(coeffs).all()
    ):
        lengths = " or ".join(map(str, DISTORTION_LENGTHS[model]))
        said = (
            f"the distortion model {model!r} needs {lengths} finite coefficients, got"
            f" {coeffs.tolist()}: calibrate again"
        )
    elif deviations.shape != (4,) or not (np.isfinite(deviations) & (deviations >= 0.0)).all():
        said = (
            "intrinsics_std must be 4 deviations of fu, fv, pu, pv [px], none negative, "
            f"got {deviations.tolist()}: give 0 for exact ones"
        )
    elif readout.shape != (2,) or not (
        0.0 <= readout[0] <= MAX_READOUT_S and 0.0 <= readout[1] < np.inf
    ):
        said = (
            f"the readout must take 0 to {MAX_READOUT_S:g} s, and its deviation must be 0 "
            f"or more, got {camera.readout_s} s and {camera.readout_std_s} s: give seconds"
        )
    if said:
        raise SsacError(f"{name}: {said}")


def check_cameras(rig: Cameras) -> None:
    """Raise SsacError unless all cameras, and the transforms between them, can be used."""
    if not isinstance(rig.cameras, tuple | list):
        raise SsacError(f"{rig.name}: expected the ssac.Camera of each, got {rig.cameras!r}")
    if len(rig.steps) not in (0, len(rig.cameras) - 1):
        raise SsacError(
            f"{rig.name}: expected a transform from each of {len(rig.cameras)} cameras to the next,"
            f" or none at all, got {len(rig.steps)}: give None for one that is not known"
        )
    for k, camera in enumerate(rig.cameras, start=1):
        check_camera(camera, f"camera {k}")
    for k, step in enumerate(rig.steps, start=1):
        if step is not None:
            check_transform(_floats(step), f"{rig.name}, from camera {k} to camera {k + 1}")


def with_usual_centres(rig: Cameras) -> Cameras:
    """Swap principal points that seem to be (pv, pu), unless a camera states its deviations."""
    cameras = []
    for camera in rig.cameras:
        given_px = camera.K[:2, 2]
        middle_px = 0.5 * np.array([camera.width - 1, camera.height - 1])
        off_px, exchanged_px = np.linalg.norm([given_px, given_px[::-1]] - middle_px, axis=1)
        # No lens is off by a tenth of the width. Exchanged, the point must be within half as far.
        is_exchanged = off_px > 0.1 * camera.width and exchanged_px < 0.5 * off_px
        if is_exchanged and not camera.states_intrinsics:
            K = camera.K.copy()
            K[:2, 2] = given_px[::-1]
            camera = replace(camera, K=K, centre_was_exchanged=True)
        cameras.append(camera)
    return replace(rig, cameras=tuple(cameras))


def check_transform(T: Array, name: str) -> None:
    """Raise SsacError, starting with `name`, unless `T` is a rigid transform (4, 4)."""
    if T.shape != (4, 4) or not np.isfinite(T).all():
        raise SsacError(
            f"{name}: expected a finite 4x4 transform x2 = T x1, got {T.tolist()}: give R and t in"
            " one matrix, or leave it out where the pose is not known"
        )
    R = T[:3, :3]
    error, most = np.abs(R.T @ R - np.eye(3)).max(), 1e-3  # rounding to few digits leaves as much
    if error > most or np.linalg.det(R) < 0 or not np.array_equal(T[3], (0, 0, 0, 1)):
        raise SsacError(
            f"{name}: expected a rotation, got {R.tolist()} (R'R differs from I by {error:.2g}): "
            "calibrate again"
        )


def _floats(values: object) -> Array:
    """Convert values to an array of floats; a single NaN where they are no numbers."""
    try:
        return np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        return np.array([np.nan])


def undistort_points(camera: Camera, points_px: Array) -> Array:
    """Ideal pixel coordinates (N, 2) of measured points, in the image of the same K.

    NaN where no ray reaches a point under the lens model (far out, where a fitted polynomial turns
    back).
    """
    check_camera(camera)
    measured = _checked_points(points_px)
    if camera.distortion_model == "none" or len(measured) == 0:
        return measured
    coeffs = np.array(camera.distortion_coeffs)
    stop = cv2.TERM_CRITERIA_MAX_ITER | cv2.TERM_CRITERIA_EPS, 500, 1e-7
    if camera.distortion_model == "radtan":
        ideal = cv2.undistortPointsIter(
            measured[:, None], camera.K, coeffs, np.eye(3), camera.K, stop
        )
    else:
        ideal = cv2.fisheye.undistortPoints(
            measured[:, None], camera.K, coeffs, P=camera.K, criteria=stop
        )
    ideal_points = np.asarray(ideal, dtype=np.float64).reshape(-1, 2)
    round_trip_px = np.linalg.norm(distort_points(camera, ideal_points) - measured, axis=1)
    ideal_points[~(round_trip_px <= MAX_ROUND_TRIP_PX)] = np.nan
    return ideal_points


def distort_points(camera: Camera, points_px: Array) -> Array:
    """Measured coordinates (N, 2) [px] of ideal ones: the inverse of `undistort_points`."""
    check_camera(camera)
    ideal = _checked_points(points_px)
    if camera.distortion_model == "none" or len(ideal) == 0:
        return ideal
    coeffs = np.array(camera.distortion_coeffs)
    rays = (ideal - camera.K[:2, 2]) / (camera.K[0, 0], camera.K[1, 1])
    if camera.distortion_model == "radtan":
        rays = np.column_stack([rays, np.ones(len(rays))])
        measured, _ = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), camera.K, coeffs)
    else:
        measured = cv2.fisheye.distortPoints(rays[:, None], camera.K, coeffs)
    return np.asarray(measured, dtype=np.float64).reshape(-1, 2)


def undistortion_map(camera: Camera) -> Array:
    """Ideal (x, y) of every pixel (height, width, 2) [px], at [y, x]; NaN where no ray reaches."""
    check_camera(camera)
    y, x = np.mgrid[: camera.height, : camera.width]
    pixels = np.column_stack([x.ravel(), y.ravel()]).astype(np.float64)
    return undistort_points(camera, pixels).reshape(camera.height, camera.width, 2)


def _checked_points(points_px: Array) -> Array:
    """Copy of the points as float64; SsacError unless their shape is (N, 2)."""
    points = np.array(points_px, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 2:
        raise SsacError(f"points must have shape (N, 2), got {points.shape}: pass one point a row")
    return points


def known_pose(rig: Rig) -> tuple[Array, Array]:
    """R (3, 3) and t (3,) of length 1 of the rig; SsacError when they are unknown."""
    if rig.T_2_1 is None:
        raise SsacError("known extrinsics were asked for, but the rig has no T_2_1")
    length_m = np.linalg.norm(rig.T_2_1[:3, 3])
    if not length_m > 0.0:
        raise SsacError(f"the rig's T_2_1 must have a translation, got {rig.T_2_1[:3, 3]} m")
    return rig.T_2_1[:3, :3], np.asarray(rig.T_2_1[:3, 3] / length_m)
