"""Errors of an estimate against the ground truth, also in units of its stated deviations."""

from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from ssac.arrays import Array
from ssac.estimate import Estimate
from ssac.geometry.pose import pose_step

POSE_SCORES = (
    "r_std_deg",  # of R: root of the trace of the covariance of its angles
    "t_std_deg",
    "r_mahalanobis",  # of R's three angles; its square should be chi^2 with 3 degrees of freedom
    "t_mahalanobis",  # of t's two angles
    "r_x_normalised",  # signed error of an angle over its deviation
    "r_y_normalised",
    "r_z_normalised",
    "t_1_normalised",
    "t_2_normalised",
)
"""Scores of a pose's errors against its covariance, in the angles of `ssac.geometry.pose`."""


@dataclass(frozen=True)
class Truth:
    """The ground truth of an estimate: x2 = R x1 + t, and `t_cam2 = t_cam1 + t_d`."""

    t_d_s: float  # at t_mid_s; NaN: there is no true offset, and any estimate is wrong
    R: Array  # (3, 3)
    t: Array  # (3,) unit length
    skew_ppm: float = 0.0
    t_mid_s: float = 0.0  # middle of the flight, on camera 1's clock

    def t_d_of(self, estimate: Estimate) -> float:
        """Return the true offset [s] at the time for which the estimate states its own."""
        since_s = estimate.t_ref_s - self.t_mid_s if np.isfinite(estimate.t_ref_s) else 0.0
        return self.t_d_s + 1e-6 * self.skew_ppm * since_s


def scored(estimate: Estimate, truth: Truth, has_pose: bool = True) -> dict[str, Any]:
    """Return all columns of an estimate's scores, NaN for a quantity that it does not give.

    Without `has_pose` the pose's columns are left out: a pose that was given has no error. That of
    R is the angle of R_est' R_true, that of t the angle between the directions, sign included.
    """
    t_d_s, R, t = truth.t_d_of(estimate), truth.R, truth.t
    skew_error_ppm = estimate.skew_ppm - truth.skew_ppm
    columns = {
        "status": str(estimate.status),
        "reason": estimate.reason,
        "n_samples": estimate.n_samples,
        "d_avg_px": estimate.d_avg_px,
        "t_d_estimate_ms": 1e3 * estimate.t_d_s,
        "t_d_error_ms": abs(estimate.t_d_s - t_d_s) * 1e3,
        "t_d_std_ms": 1e3 * estimate.t_d_std_s,
        "t_d_normalised": _over(estimate.t_d_s - t_d_s, estimate.t_d_std_s),
        "skew_ppm": estimate.skew_ppm,
        "skew_std_ppm": estimate.skew_std_ppm,
        "skew_error_ppm": abs(skew_error_ppm),
        "skew_normalised": _over(skew_error_ppm, estimate.skew_std_ppm),
    }
    if not has_pose:
        return columns
    errors = {
        "r_error_deg": np.nan if estimate.R is None else rotation_angle_deg(estimate.R.T @ R),
        "t_error_deg": np.nan if estimate.t is None else angle_between_deg(estimate.t, t),
    }
    return columns | errors | pose_score(estimate, R, t)


def kept(row_type: type, columns: dict[str, Any]) -> dict[str, Any]:
    """Return those of the columns that are fields of a row type."""
    return {one.name: columns[one.name] for one in fields(row_type) if one.name in columns}


def _over(error: float, std: float) -> float:
    """Divide an error by its deviation; NaN if this is 0, as for a quantity not estimated."""
    return error / std if std else np.nan


def pose_score(estimate: Estimate, R: Array, t: Array) -> dict[str, float]:
    """Return POSE_SCORES of an estimate, NaN without covariance; R and t as in `Truth`."""
    if estimate.covariance is None or estimate.R is None or estimate.t is None:
        return dict.fromkeys(POSE_SCORES, np.nan)
    errors_rad = -pose_step(estimate.R, estimate.t, R, t)
    covariance = estimate.covariance[1:, 1:]
    both = slice(3), slice(3, None)
    distances = (mahalanobis(errors_rad[of], covariance[of, of]) for of in both)
    normalised = (errors_rad / np.sqrt(np.diag(covariance))).tolist()
    values = (estimate.r_std_deg, estimate.t_std_deg, *distances, *normalised)
    return dict(zip(POSE_SCORES, values, strict=True))


def mahalanobis(off: Array, covariance: Array) -> float:
    """Return the Mahalanobis distance of an error (n,) with a covariance (n, n)."""
    return float(np.sqrt(off @ np.linalg.solve(covariance, off)))


def rotation_angle_deg(R: Array) -> float:
    """Return the angle [deg] of a rotation matrix (3, 3), exact for small angles too."""
    sine = 0.5 * np.linalg.norm([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    return float(np.rad2deg(np.arctan2(sine, 0.5 * (np.trace(R) - 1.0))))


def angle_between_deg(a: Array, b: Array) -> float:
    """Return the angle [deg] between two vectors (3,), exact for small angles too."""
    return float(np.rad2deg(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b)))
