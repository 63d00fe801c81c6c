"""Zhang's calibration of a rig from views of a chessboard.

The board's corners are projected, not rendered, and a corner detector's error is added. OpenCV then
calibrates each camera by itself, and finds the relative pose from views that both share.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from sim.arrays import Float32Array, FloatArray
from sim.errors import SimError, check_numbers
from sim.scene.rig import Camera, Rig

MAX_TRIES = 20_000  # of places for the board, before the set-up is refused
MIN_COSINE = 0.17  # of the angle from the board's normal to a camera: beyond, no corner is found

_MARGIN_PX = 4.0  # a corner nearer to the border is not found


@dataclass(frozen=True)
class CalibrationConfig:
    """How a bench is calibrated (Zhang, A flexible new technique, PAMI 2000)."""

    corners: tuple[int, int] = (9, 6)  # inner corners of the board, along its two sides
    square_m: float = 0.025
    n_views: int = 30  # of each camera by itself
    n_shared: int = 20  # of both cameras at once
    corner_std_px: float = 0.1  # of each detected corner, in each direction
    distance_m: tuple[float, float] = (0.35, 0.7)  # of the board from a camera by itself
    max_tilt_deg: float = 45.0  # of the board against a camera by itself
    shared_tilt_deg: float = 15.0  # deviation about each axis, from facing both cameras alike
    shared_m: float = 0.05  # deviation of the board's places from the point both cameras look at

    def __post_init__(self) -> None:
        if min(self.corners) < 3 or min(self.n_views, self.n_shared) < 3:
            raise SimError(
                f"calibration: expected a board of 3 x 3 corners or more and 3 views or more, got "
                f"{self.corners}, {self.n_views} and {self.n_shared}"
            )
        check_numbers(self, "calibration: ", or_zero=("corner_std_px",))


@dataclass(frozen=True)
class CalibratedCamera:
    """Intrinsics as a calibration finds them."""

    K: FloatArray  # (3, 3) [px]
    distortion_coeffs: tuple[float, ...]  # of the camera's own model
    intrinsics_std_px: tuple[float, float, float, float]  # stated deviations of fu, fv, pu, pv
    rms_px: float  # of the corners' reprojection errors


def exact(camera: Camera) -> CalibratedCamera:
    """Return a camera's true intrinsics, with deviations of 0."""
    return CalibratedCamera(camera.K, camera.distortion_coeffs, (0.0, 0.0, 0.0, 0.0), 0.0)


def calibrated_camera(
    camera: Camera, config: CalibrationConfig, rng: np.random.Generator
) -> CalibratedCamera:
    """Calibrate a "radtan" or "none" camera by itself; SimError if too few views are found."""
    board = _board(config)
    views = _own_views(camera, board, config, rng)
    corners = [_found(camera, points, config, rng) for points in views]
    flags = cv2.CALIB_FIX_K3
    if camera.distortion_model == "none":
        flags |= cv2.CALIB_FIX_K1 | cv2.CALIB_FIX_K2 | cv2.CALIB_ZERO_TANGENT_DIST
    K: Any = None
    coeffs: Any = None
    with _one_thread():
        # Twice: the first run may stay at the mirrored pose of a flat board in some view; the
        # second run initialises every board's pose anew from the intrinsics of the first.
        for start in (0, cv2.CALIB_USE_INTRINSIC_GUESS):
            rms_px, K, coeffs, _, _, deviations, _, _ = cv2.calibrateCameraExtended(
                [board.astype(np.float32)] * len(views),
                corners,
                (camera.width, camera.height),
                K,
                coeffs,
                flags=flags | start,
                criteria=_STOP,
            )
    n_coeffs = len(camera.distortion_coeffs)
    fu, fv, pu, pv = (float(value) for value in np.ravel(deviations)[:4])
    found = tuple(float(value) for value in np.ravel(coeffs)[:n_coeffs])
    return CalibratedCamera(np.asarray(K, np.float64), found, (fu, fv, pu, pv), float(rms_px))


def calibrated_pose(
    rig: Rig,
    cameras: Sequence[CalibratedCamera],
    config: CalibrationConfig,
    rng: np.random.Generator,
) -> FloatArray:
    """Find T_2_1 (4, 4), camera 1 [m] to camera 2 [m], from views that both cameras share.

    Both cameras look at the world's origin. The intrinsics in `cameras` are held fixed.
    """
    board = _board(config)
    seen = _shared_views(rig, board, config, rng)
    corners = [[_found(camera, points, config, rng) for points in seen] for camera in rig.cameras]
    lenses = [(one.K.copy(), np.array(one.distortion_coeffs or (0.0,) * 4)) for one in cameras]
    with _one_thread():
        *_, R, t, _, _ = cv2.stereoCalibrate(
            [board.astype(np.float32)] * len(seen),
            *corners,
            *lenses[0],
            *lenses[1],
            (rig.cameras[0].width, rig.cameras[0].height),
            flags=cv2.CALIB_FIX_INTRINSIC,
            criteria=_STOP,
        )  # type: ignore[call-overload]
    T_2_1 = np.eye(4)
    T_2_1[:3, :3], T_2_1[:3, 3] = R, t.ravel()
    return T_2_1


_STOP = (cv2.TERM_CRITERIA_MAX_ITER | cv2.TERM_CRITERIA_EPS, 200, 1e-10)


@contextmanager
def _one_thread() -> Iterator[None]:
    """Make OpenCV sum in a fixed order: with several threads the last digits vary."""
    n_threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(n_threads)


def _board(config: CalibrationConfig) -> FloatArray:
    """Return the board's corners (n, 3) [m] in its plane z = 0, about its middle."""
    columns, rows = config.corners
    grid = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1).reshape(-1, 2)
    flat = config.square_m * (grid - 0.5 * np.array([columns - 1, rows - 1]))
    return np.column_stack([flat, np.zeros(len(flat))])


def _views(n: int, draw: Callable[[], FloatArray | None], camera: Camera) -> list[FloatArray]:
    """Draw places of the board, its corners (n, 3) [m] in the world, until n are in view."""
    views: list[FloatArray] = []
    for _ in range(MAX_TRIES):
        if len(views) == n:
            return views
        points_W = draw()
        if points_W is not None:
            views.append(points_W)
    raise SimError(
        f"calibration: of {MAX_TRIES} places for the board too few are in view, of "
        f"{camera.name} or of both: take a smaller one, or hold it elsewhere"
    )


def _own_views(
    camera: Camera, board: FloatArray, config: CalibrationConfig, rng: np.random.Generator
) -> list[FloatArray]:
    T_W_C = np.linalg.inv(camera.T_C_W)
    half = 0.5 * np.array([camera.width, camera.height]) / camera.K[0, 0]

    def draw() -> FloatArray | None:
        depth_m = rng.uniform(*config.distance_m)
        place = np.append(rng.uniform(-0.8, 0.8, 2) * half, 1.0) * depth_m
        axis = np.append(rng.standard_normal(2), 0.0)
        tilt = np.deg2rad(rng.uniform(0.0, config.max_tilt_deg)) * axis / np.linalg.norm(axis)
        roll = (0.0, 0.0, rng.uniform(-0.5, 0.5))
        turn = Rotation.from_rotvec(tilt) * Rotation.from_rotvec(roll)
        points_C = board @ turn.as_matrix().T + place
        points_W: FloatArray = points_C @ T_W_C[:3, :3].T + T_W_C[:3, 3]
        return points_W if _is_seen(camera, points_W) else None

    return _views(config.n_views, draw, camera)


def _shared_views(
    rig: Rig, board: FloatArray, config: CalibrationConfig, rng: np.random.Generator
) -> list[FloatArray]:
    """Draw places of the board that both cameras see, its normal about midway between them."""
    centres = [-camera.T_C_W[:3, :3].T @ camera.T_C_W[:3, 3] for camera in rig.cameras]
    towards = sum(centre / np.linalg.norm(centre) for centre in centres)
    # The board's z points away from the cameras, its y down.
    z = -towards / np.linalg.norm(towards)
    x = np.cross((0.0, 0.0, -1.0), z)
    x /= np.linalg.norm(x)
    facing = Rotation.from_matrix(np.column_stack([x, np.cross(z, x), z]))

    def draw() -> FloatArray | None:
        tilt = np.deg2rad(config.shared_tilt_deg) * rng.standard_normal(3)
        turn = facing * Rotation.from_rotvec(tilt)
        points_W: FloatArray = board @ turn.as_matrix().T + config.shared_m * rng.standard_normal(3)
        middle, normal = points_W.mean(axis=0), -turn.as_matrix()[:, 2]
        cosines = [normal @ (c - middle) / np.linalg.norm(c - middle) for c in centres]
        is_seen = min(cosines) > MIN_COSINE and all(_is_seen(c, points_W) for c in rig.cameras)
        return points_W if is_seen else None

    return _views(config.n_shared, draw, rig.cameras[0])


def _is_seen(camera: Camera, points_W: FloatArray) -> bool:
    pixels = camera.project(points_W)
    last = np.array([camera.width - 1, camera.height - 1]) - _MARGIN_PX
    return bool(((pixels >= _MARGIN_PX) & (pixels <= last)).all())  # NaN fails too


def _found(
    camera: Camera, points_W: FloatArray, config: CalibrationConfig, rng: np.random.Generator
) -> Float32Array:
    """Return the detected corners (n, 1, 2) [px] of a view, with their errors."""
    pixels = camera.project(points_W)
    pixels = pixels + config.corner_std_px * rng.standard_normal(pixels.shape)
    return pixels.astype(np.float32)[:, None]
