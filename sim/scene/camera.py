"""Points of the world to pixels: one camera's lens, pose and clock.

Camera frame C: x right, y down, z forward, metres; pixel centres at integer coordinates.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from sim.errors import SimError

FloatArray = NDArray[np.float64]

N_COEFFS = {"none": 0, "radtan": 4, "equidistant": 4}
MIN_DEPTH_M = 1e-3  # nearer points, and those behind the camera, have no image
MAX_FIELD_ANGLE_RAD = math.radians(89.0)  # from the optical axis; a pinhole sees less than 90 deg


@dataclass(frozen=True)
class Camera:
    """One camera: Kalibr's pinhole model, pose and clock.

    Raises
    ------
    SimError
        When a shape, the distortion model or its coefficients are wrong, or when the distortion
        folds the image back on itself.
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
        if self.K.shape != (3, 3) or self.T_C_W.shape != (4, 4):
            raise SimError(
                f"{self.name}: K must be (3, 3) and T_C_W (4, 4), "
                f"got {self.K.shape} and {self.T_C_W.shape}"
            )
        if not (self.K[0, 0] > 0 and self.K[1, 1] > 0 and self.width > 0 and self.height > 0):
            raise SimError(
                f"{self.name}: focal lengths and resolution must be positive, "
                f"got {self.K[0, 0]}, {self.K[1, 1]} px and {self.width} x {self.height}"
            )
        if not (np.isfinite(self.K).all() and np.isfinite(self.T_C_W).all()):
            raise SimError(
                f"{self.name}: K and T_C_W must be finite, got {self.K.tolist()} and "
                f"{self.T_C_W.tolist()}"
            )
        if self.distortion_model not in N_COEFFS:
            raise SimError(
                f"{self.name}: unknown distortion model {self.distortion_model!r}: "
                f"use one of {', '.join(N_COEFFS)}"
            )
        n_coeffs = N_COEFFS[self.distortion_model]
        if len(self.distortion_coeffs) != n_coeffs or not np.isfinite(self.distortion_coeffs).all():
            raise SimError(
                f"{self.name}: the distortion model {self.distortion_model!r} needs {n_coeffs} "
                f"finite coefficients, got {self.distortion_coeffs}"
            )
        if self._folds_within_image():
            raise SimError(
                f"{self.name}: the {self.distortion_model} coefficients {self.distortion_coeffs} "
                "fold the image back on itself before its border: use weaker distortion"
            )

    def project(self, points_W: FloatArray) -> FloatArray:
        """Project points of the world into the distorted image.

        Parameters
        ----------
        points_W
            [m], frame W.

        Returns
        -------
        (..., 2) array
            Column and row [px]; they may lie outside the image. NaN for points behind the camera
            or so far from the axis that the lens model, past its turning point, would fold them
            back into the image.
        """
        points_C = np.asarray(points_W) @ self.T_C_W[:3, :3].T + self.T_C_W[:3, 3]
        depth_m = np.where(points_C[..., 2] > MIN_DEPTH_M, points_C[..., 2], np.nan)
        rays = points_C[..., :2] / depth_m[..., None]
        angle_rad = np.arctan(np.linalg.norm(rays, axis=-1))
        rays = np.where((angle_rad <= self.field_angle_rad)[..., None], rays, np.nan)
        return self._pixels(self.distort(rays))

    def distort(self, rays: FloatArray) -> FloatArray:
        """Move rays to where the lens images them.

        Parameters
        ----------
        rays
            x / z and y / z, frame C.

        Returns
        -------
        (..., 2) array
            The same, distorted: Kalibr's and OpenCV's radial-tangential model, or Kalibr's
            equidistant one (OpenCV's fisheye; Kannala & Brandt, PAMI 2006).
        """
        x, y = rays[..., 0], rays[..., 1]
        r2 = x**2 + y**2
        if self.distortion_model == "radtan":
            k1, k2, p1, p2 = self.distortion_coeffs
            radial = 1.0 + r2 * (k1 + r2 * k2)
            return np.stack(
                [
                    x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x**2),
                    y * radial + 2.0 * p2 * x * y + p1 * (r2 + 2.0 * y**2),
                ],
                axis=-1,
            )
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

        There the determinant of its Jacobian, positive on the axis, first fails to be positive; it
        is looked for on a polar grid of rays, whatever the model.
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
