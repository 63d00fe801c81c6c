"""Angles, intrinsics and clocks in; cameras that look at the origin, and their Kalibr YAML, out.

World frame W: origin at the point the cameras look at, x right, y forward (away from camera 1),
z up, metres. Camera frame C as in `sim.scene.camera`.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import yaml
from numpy.typing import NDArray

from sim.errors import SimError
from sim.scene.camera import Camera

FloatArray = NDArray[np.float64]

# The authors' public sample.
DISTANCE_M = 5.0
FOCAL_PX = 200.0
RESOLUTION = (346, 260)  # width, height [px]
PRINCIPAL_POINT = (173.0, 130.0)  # column, row [px]


@dataclass(frozen=True)
class Rig:
    """Cameras that watch the same scene; the first one is the reference."""

    cameras: tuple[Camera, ...]  # at least one

    def __post_init__(self) -> None:
        if not self.cameras:
            raise SimError("a rig needs at least one camera")

    def relative_pose(self, i: int, j: int) -> FloatArray:
        """Return T_j_i (4, 4): coordinates [m] of camera index i to those of camera index j."""
        return self.cameras[j].T_C_W @ np.linalg.inv(self.cameras[i].T_C_W)

    def extrinsics(self) -> tuple[FloatArray, FloatArray, float]:
        """Return the truth that an estimator seeks: pose of camera 1 in camera 2, up to scale.

        Returns
        -------
        R : (3, 3) array
        t : (3,) array
            |t| = 1; x2 = R x1 + baseline_m t.
        baseline_m : float

        Raises
        ------
        SimError
            When there is one camera only, or the first two are in the same place.
        """
        if len(self.cameras) < 2:
            raise SimError("extrinsics need two cameras, this rig has one")
        T_2_1 = self.relative_pose(0, 1)
        baseline_m = float(np.linalg.norm(T_2_1[:3, 3]))
        if baseline_m < 1e-9:
            raise SimError("the first two cameras are in the same place: t has no direction")
        return T_2_1[:3, :3], T_2_1[:3, 3] / baseline_m, baseline_m


def look_at_rig(
    angles_deg: Sequence[float] = (0.0, 90.0),
    distance_m: float = DISTANCE_M,
    focal_px: float = FOCAL_PX,
    resolution: tuple[int, int] = RESOLUTION,
    principal_point: tuple[float, float] = PRINCIPAL_POINT,
    distortion_model: str = "none",
    distortion_coeffs: Sequence[float] = (),
    time_offsets_s: Sequence[float] | None = None,
) -> Rig:
    """Place equal cameras on a horizontal circle about the origin, all looking at it.

    Parameters
    ----------
    angles_deg
        One per camera [deg], counter-clockwise seen from above: at 0 the camera stands at
        (0, -distance_m, 0), looks along +y, and the image's down is the world's -z.
    distance_m
        From the origin [m].
    focal_px
    resolution
        Width and height [px].
    principal_point
        Column and row [px].
    distortion_model
        "none", "radtan" or "equidistant".
    distortion_coeffs
    time_offsets_s
        Each camera's clock minus the world's [s]; zero by default.

    Returns
    -------
    Rig
        Cameras named cam1, cam2, ...

    Raises
    ------
    SimError
        When the distance is not positive, or the numbers of angles and offsets differ.
    """
    if not distance_m > 0:
        raise SimError(f"the cameras' distance must be positive, got {distance_m} m")
    offsets_s = [0.0] * len(angles_deg) if time_offsets_s is None else list(time_offsets_s)
    if len(offsets_s) != len(angles_deg):
        raise SimError(f"{len(angles_deg)} cameras need as many time offsets, got {len(offsets_s)}")
    u, v = principal_point
    K = np.array([[focal_px, 0.0, u], [0.0, focal_px, v], [0.0, 0.0, 1.0]])
    cameras = tuple(
        Camera(
            name=f"cam{number}",
            K=K,
            width=resolution[0],
            height=resolution[1],
            distortion_model=distortion_model,
            distortion_coeffs=tuple(distortion_coeffs),
            T_C_W=_look_at_origin(angle_deg, distance_m),
            time_offset_s=offset_s,
        )
        for number, (angle_deg, offset_s) in enumerate(zip(angles_deg, offsets_s, strict=True), 1)
    )
    return Rig(cameras)


def two_view_rig(
    angle_deg: float,
    distance_m: float = DISTANCE_M,
    focal_px: float = FOCAL_PX,
    resolution: tuple[int, int] = RESOLUTION,
    principal_point: tuple[float, float] = PRINCIPAL_POINT,
    distortion_model: str = "none",
    distortion_coeffs: Sequence[float] = (),
    t_d_s: float = 0.0,
) -> Rig:
    """Place the paper's two cameras: lines of sight `angle_deg` apart, clocks `t_d_s` apart.

    The arguments are those of `look_at_rig`; camera 2's clock shows t_cam1 + t_d_s.

    Raises
    ------
    SimError
        When the angle is not strictly between 0 and 180 deg, or the offset is not finite.
    """
    if not 0.0 < angle_deg < 180.0:
        raise SimError(
            f"the angle between the two lines of sight must be between 0 and 180 deg, exclusive, "
            f"got {angle_deg:g}"
        )
    if not np.isfinite(t_d_s):
        raise SimError(f"the time offset must be a finite number of seconds, got {t_d_s}")
    return look_at_rig(
        (0.0, angle_deg),
        distance_m=distance_m,
        focal_px=focal_px,
        resolution=resolution,
        principal_point=principal_point,
        distortion_model=distortion_model,
        distortion_coeffs=distortion_coeffs,
        time_offsets_s=(0.0, t_d_s),
    )


def kalibr_yaml(rig: Rig, with_extrinsics: bool) -> str:
    """Write a rig as a Kalibr camchain: cam0 is our camera 1, cam1 our camera 2, ...

    Clock offsets are not written, nor are the extrinsics (`T_cn_cnm1`: previous camera to this one)
    unless asked for: they are what an estimator has to find.
    """
    chain: dict[str, dict[str, object]] = {}
    for n, camera in enumerate(rig.cameras):
        K = camera.K
        entry: dict[str, object] = {
            "camera_model": "pinhole",
            "intrinsics": [float(k) for k in (K[0, 0], K[1, 1], K[0, 2], K[1, 2])],
            "intrinsics_std": [0.0, 0.0, 0.0, 0.0],  # [px] they are the ones simulated with
            "distortion_model": camera.distortion_model,
            "distortion_coeffs": [float(c) for c in camera.distortion_coeffs],
            "resolution": [camera.width, camera.height],
        }
        if with_extrinsics and n > 0:
            entry["T_cn_cnm1"] = rig.relative_pose(n - 1, n).tolist()
        chain[f"cam{n}"] = entry
    text: str = yaml.safe_dump(chain, default_flow_style=None, sort_keys=False)
    return text


def _look_at_origin(angle_deg: float, distance_m: float) -> FloatArray:
    """Return T_C_W of a camera at (0, -distance_m, 0), looking at the origin, turned about z."""
    T_C0_W = np.array(
        [
            [1.0, 0.0, 0.0, 0.0],
            [0.0, 0.0, -1.0, 0.0],
            [0.0, 1.0, 0.0, distance_m],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )
    cos, sin = np.cos(np.deg2rad(angle_deg)), np.sin(np.deg2rad(angle_deg))
    # Undoes the turn: the camera turned by +angle sees the world turned by -angle.
    T_W0_W = np.eye(4)
    T_W0_W[:2, :2] = [[cos, sin], [-sin, cos]]
    T_C_W: FloatArray = T_C0_W @ T_W0_W
    return T_C_W
