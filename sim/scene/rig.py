"""Cameras, each with its lens, pose and clock, and rigs of them that look at the origin.

World frame W: origin at the point the cameras look at, x right, y forward (away from camera 1),
z up, metres. Camera frame C: x right, y down, z forward, metres; pixel centres at integer
coordinates.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import yaml

from sim.arrays import FloatArray
from sim.errors import SimError

N_COEFFS = {"none": 0, "radtan": 4, "equidistant": 4}
MIN_DEPTH_M = 1e-3  # nearer points, and those behind the camera, have no image
MAX_FIELD_ANGLE_RAD = math.radians(89.0)  # from the optical axis; a pinhole sees less than 90 deg


@dataclass(frozen=True)
class Camera:
    """One camera: Kalibr's pinhole model, pose and clock.

    SimError when a number, the distortion model or its coefficients are wrong, or when the
    distortion folds the image back on itself.
    """

    name: str  # "cam1", "cam2", ...
    K: FloatArray  # (3, 3) [px]
    width: int  # [px]
    height: int  # [px]
    distortion_model: str  # "none", "radtan" (k1, k2, p1, p2) or "equidistant" (k1, k2, k3, k4)
    distortion_coeffs: tuple[float, ...]  # 4 values, or none for "none"
    T_C_W: FloatArray  # (4, 4), world [m] to camera [m]
    time_offset_s: float  # t_cam = t_world + time_offset_s

    def __post_init__(self) -> None:
        K, model, coeffs = self.K, self.distortion_model, self.distortion_coeffs
        if not (K[0, 0] > 0 and K[1, 1] > 0 and self.width > 0 and self.height > 0):
            got = f"{K[0, 0]}, {K[1, 1]} px and {self.width} x {self.height}"
            said = f"focal lengths and resolution must be positive, got {got}"
        elif not (np.isfinite(K).all() and np.isfinite(self.T_C_W).all()):
            said = f"K and T_C_W must be finite, got {K.tolist()} and {self.T_C_W.tolist()}"
        elif model not in N_COEFFS:
            said = f"unknown distortion model {model!r}: use one of {', '.join(N_COEFFS)}"
        elif len(coeffs) != N_COEFFS[model] or not np.isfinite(coeffs).all():
            needs = f"{N_COEFFS[model]} finite coefficients"
            said = f"the distortion model {model!r} needs {needs}, got {coeffs}"
        elif self._folds_within_image():
            said = (
                f"the {model} coefficients {coeffs} fold the image back on itself before its "
                "border: use weaker distortion"
            )
        else:
            return
        raise SimError(f"{self.name}: {said}")

    def project(self, points_W: FloatArray) -> FloatArray:
        """Project points (..., 3) [m] of the world to distorted pixels (..., 2), column and row.

        Pixels may lie outside the image. NaN for points behind the camera or so far from the axis
        that the lens model, past its turning point, would fold them back into the image.
        """
        points_C = np.asarray(points_W) @ self.T_C_W[:3, :3].T + self.T_C_W[:3, 3]
        depth_m = np.where(points_C[..., 2] > MIN_DEPTH_M, points_C[..., 2], np.nan)
        rays = points_C[..., :2] / depth_m[..., None]
        slope2 = rays[..., 0] ** 2 + rays[..., 1] ** 2
        is_within = slope2 <= math.tan(self.field_angle_rad) ** 2
        rays = np.where(is_within[..., None], rays, np.nan)
        return self._pixels(self.distort(rays))

    def distort(self, rays: FloatArray) -> FloatArray:
        """Move rays (..., 2), x / z and y / z in frame C, to where the lens images them.

        The models are Kalibr's and OpenCV's radial-tangential one, and Kalibr's equidistant one
        (OpenCV's fisheye; Kannala & Brandt, PAMI 2006).
        """
        x, y = rays[..., 0], rays[..., 1]
        r2 = x**2 + y**2
        if self.distortion_model == "radtan":
            k1, k2, p1, p2 = self.distortion_coeffs
            radial = 1.0 + r2 * (k1 + r2 * k2)
            bent_x = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x**2)
            bent_y = y * radial + 2.0 * p2 * x * y + p1 * (r2 + 2.0 * y**2)
            return np.stack([bent_x, bent_y], axis=-1)
        if self.distortion_model == "equidistant":
            k1, k2, k3, k4 = self.distortion_coeffs
            r = np.sqrt(r2)
            angle = np.arctan(r)
            a2 = angle**2
            distorted = angle * (1.0 + a2 * (k1 + a2 * (k2 + a2 * (k3 + a2 * k4))))
            scale: FloatArray = np.divide(distorted, r, out=np.ones_like(r), where=r > 1e-12)
            return rays * scale[..., None]
        return rays

    @cached_property
    def field_angle_rad(self) -> float:
        """Largest angle from the optical axis [rad] up to which the distortion is one-to-one.

        There the determinant of its Jacobian, on a polar grid of rays, first fails to be positive.
        """
        angles_rad = MAX_FIELD_ANGLE_RAD * np.arange(1, 721) / 720
        by_angle, by_azimuth = np.gradient(self.distort(_cone_rays(angles_rad)), axis=(0, 1))
        determinant = by_angle[..., 0] * by_azimuth[..., 1] - by_angle[..., 1] * by_azimuth[..., 0]
        folded = (determinant <= 0.0).any(axis=1)
        return float(angles_rad[np.argmax(folded)]) if folded.any() else MAX_FIELD_ANGLE_RAD

    def _folds_within_image(self) -> bool:
        """Tell whether the distortion stops being one-to-one before the image's border."""
        if self.field_angle_rad == MAX_FIELD_ANGLE_RAD:
            return False
        ring = self._pixels(self.distort(_cone_rays(np.array([self.field_angle_rad]))))
        return bool(((ring > 0) & (ring < (self.width - 1, self.height - 1))).all(axis=-1).any())

    def _pixels(self, rays: FloatArray) -> FloatArray:
        """Apply K to distorted rays (..., 2)."""
        return rays @ self.K[:2, :2].T + self.K[:2, 2]


def _cone_rays(angles_rad: FloatArray) -> FloatArray:
    """Return rays x / z, y / z, (n, 73, 2), around the axis at each of n angles from it [rad]."""
    azimuths_rad = np.linspace(-np.pi, np.pi, 73)
    directions = np.stack([np.cos(azimuths_rad), np.sin(azimuths_rad)], axis=-1)
    rays: FloatArray = np.tan(angles_rad)[:, None, None] * directions
    return rays


# Camera and distance of the authors' public sample.
DISTANCE_M = 5.0
FOCAL_PX = 200.0
RESOLUTION = (346, 260)  # width, height [px]
PRINCIPAL_POINT = (173.0, 130.0)  # column, row [px]


@dataclass(frozen=True)
class Rig:
    """Cameras that watch the same scene; the first one is the reference."""

    cameras: tuple[Camera, ...]  # at least one

    def relative_pose(self, i: int, j: int) -> FloatArray:
        """Return T_j_i (4, 4): coordinates [m] of camera index i to those of camera index j."""
        return self.cameras[j].T_C_W @ np.linalg.inv(self.cameras[i].T_C_W)

    def extrinsics(self) -> tuple[FloatArray, FloatArray, float]:
        """Return the truth that an estimator seeks: R, t with |t| = 1, and the baseline [m].

        x2 = R x1 + baseline_m t.
        """
        T_2_1 = self.relative_pose(0, 1)
        baseline_m = float(np.linalg.norm(T_2_1[:3, 3]))
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
    """Place equal cameras, cam1, cam2, ..., on a horizontal circle, all looking at the origin.

    Angles [deg] are counter-clockwise seen from above: at 0 a camera stands at (0, -distance_m, 0),
    looks along +y, and the image's down is the world's -z. Offsets are the clocks minus the world's
    [s]. Resolution is width and height, the principal point column and row [px].
    """
    if not distance_m > 0:
        raise SimError(f"the cameras' distance must be positive, got {distance_m} m")
    offsets_s = [0.0] * len(angles_deg) if time_offsets_s is None else time_offsets_s
    u, v = principal_point
    K = np.array([[focal_px, 0.0, u], [0.0, focal_px, v], [0.0, 0.0, 1.0]])
    lens = (distortion_model, tuple(distortion_coeffs))
    placed = enumerate(zip(angles_deg, offsets_s, strict=True), 1)
    return Rig(
        tuple(
            Camera(f"cam{n}", K, *resolution, *lens, _look_at_origin(angle_deg, distance_m), offset)
            for n, (angle_deg, offset) in placed
        )
    )


def two_view_rig(angle_deg: float, *, t_d_s: float = 0.0, **placed: Any) -> Rig:
    """Place the paper's two cameras: lines of sight `angle_deg` apart, clocks `t_d_s` apart.

    The other arguments are those of `look_at_rig`; camera 2's clock shows t_cam1 + t_d_s.
    """
    if not 0.0 < angle_deg < 180.0:
        raise SimError(
            f"the angle between the two lines of sight must be between 0 and 180 deg, exclusive, "
            f"got {angle_deg:g}"
        )
    if not np.isfinite(t_d_s):
        raise SimError(f"the time offset must be a finite number of seconds, got {t_d_s}")
    return look_at_rig((0.0, angle_deg), time_offsets_s=(0.0, t_d_s), **placed)


Known = list[tuple[FloatArray, FloatArray]]
"""For each camera, K (3, 3) and the stated standard deviations (4,) of fu, fv, pu and pv [px]."""


def kalibr_yaml(rig: Rig, with_extrinsics: bool, known: Known | None = None) -> str:
    """Return a rig as the text of a Kalibr camchain: cam0 is our camera 1, cam1 our camera 2, ...

    It has no clock offsets and, unless asked for, no extrinsics (`T_cn_cnm1`: previous camera to
    this one), as an estimator has to find them. `known` is by default the true intrinsics.
    """
    chain: dict[str, dict[str, object]] = {}
    for n, camera in enumerate(rig.cameras):
        K, deviations_px = known[n] if known else (camera.K, np.zeros(4))
        entry: dict[str, object] = {
            "camera_model": "pinhole",
            "intrinsics": [float(k) for k in (K[0, 0], K[1, 1], K[0, 2], K[1, 2])],
            "intrinsics_std": deviations_px.tolist(),
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
    # At 0 deg the camera's x is the world's x, its y the world's -z, and its z the world's y.
    T_C0_W = np.eye(4)[[0, 2, 1, 3]]
    T_C0_W[1, 2], T_C0_W[2, 3] = -1.0, distance_m
    cos, sin = np.cos(np.deg2rad(angle_deg)), np.sin(np.deg2rad(angle_deg))
    # A camera turned by +angle sees the world turned by -angle.
    T_W0_W = np.eye(4)
    T_W0_W[:2, :2] = [[cos, sin], [-sin, cos]]
    T_C_W: FloatArray = T_C0_W @ T_W0_W
    return T_C_W
