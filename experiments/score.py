"""An estimate and the truth in, errors with units out."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ssac.interface import Estimate

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Score:
    """How far an estimate is from the truth; NaN for what it does not give."""

    t_d_error_ms: float  # |estimate - truth|
    r_error_deg: float  # angle of R_est' R_true
    t_error_deg: float  # angle between the translation directions, sign included


def score(estimate: Estimate, t_d_s: float, R: FloatArray, t: FloatArray) -> Score:
    """Score an estimate.

    Parameters
    ----------
    estimate : Estimate
    t_d_s : float
        True offset [s], `t_cam2 = t_cam1 + t_d`.
    R, t : FloatArray
        True rotation (3, 3) and translation direction (3,): x2 = R x1 + t.
    """
    return Score(
        t_d_error_ms=abs(estimate.t_d_s - t_d_s) * 1e3,
        r_error_deg=np.nan if estimate.R is None else rotation_angle_deg(estimate.R.T @ R),
        t_error_deg=np.nan if estimate.t is None else angle_between_deg(estimate.t, t),
    )


def rotation_angle_deg(R: FloatArray) -> float:
    """Angle [deg] by which a rotation matrix (3, 3) turns, exact for small angles too."""
    sine = 0.5 * np.linalg.norm([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    return float(np.rad2deg(np.arctan2(sine, 0.5 * (np.trace(R) - 1.0))))


def angle_between_deg(a: FloatArray, b: FloatArray) -> float:
    """Angle [deg] between two vectors (3,), exact for small angles too."""
    return float(np.rad2deg(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b)))
