"""What every method gives: an offset, a pose, and how far they are to be relied upon."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

POSE_IS_OPEN = ("ambiguous_pose", "degenerate_pose")
"""Statuses of estimates whose offset holds all the same."""


@dataclass(frozen=True)
class Estimate:
    """The result of any method; what a method does not estimate stays NaN or None."""

    method: str
    status: str = "ok"  # or the name of the reason why there is no reliable estimate
    reason: str = ""  # that reason as a sentence
    t_d_s: float = np.nan  # t_cam2 = t_cam1 + t_d
    t_d_std_s: float = np.nan  # standard deviation of t_d
    R: Array | None = None  # (3, 3) x2 = R x1 + t
    t: Array | None = None  # (3,) length 1
    F: Array | None = None  # (3, 3) p2' F p1 = 0 for undistorted pixels, norm 1
    covariance: Array | None = None  # (6, 6), parameters as in `refinement`
    alternatives_s: Array = field(default_factory=lambda: np.empty(0))  # (k,) other offsets t_d
    unobservable: Array = field(default_factory=lambda: np.empty((0, 6)))  # (k, 6) unit vectors
    n_samples: int = 0  # valid pairs at the offset found
    d_avg_px: float = np.nan  # the paper's Eq. 4 at the offset found
    candidates_s: Array = field(default_factory=lambda: np.empty(0))  # (M,) offsets tried
    costs: Array = field(default_factory=lambda: np.empty(0))  # (M,) d_avg [px] or -correlation

    @property
    def has_offset(self) -> bool:
        """Whether `t_d_s` is to be relied upon: it may be though the pose is not."""
        return self.status in ("ok", *POSE_IS_OPEN) and bool(np.isfinite(self.t_d_s))
