"""The second moments of an object, told by those of its images in several cameras.

The centre of an image's area is that of no point of the object: what is nearer looks larger.
Perspective alone shifts it by several millimetres for a body of half a metre at 5 m: to first order
as the body's second moments say, and these are told by its images'.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

Array = NDArray[np.float64]

LEAST_VIEWS = 3
"""Cameras that tell all second moments: two have one of theirs in common."""


@dataclass(frozen=True, eq=False)
class View:
    """One camera's, at n times."""

    R: Array  # (3, 3) x = R X + t
    focal_px: Array  # (2,)
    points: Array  # (n, 3) of the object, in the camera's frame
    spreads_px2: Array  # (n, 3) second moments xx, xy and yy of its image; NaN: not known

    def by_point(self) -> Array:
        """Give the derivatives (n, 2, 3) of the image by the object's place, X."""
        depths = self.points[:, 2]
        by_local = np.zeros((len(depths), 2, 3))
        for axis in (0, 1):
            by_local[:, axis, axis] = self.focal_px[axis] / depths
            by_local[:, axis, 2] = -self.focal_px[axis] * self.points[:, axis] / depths**2
        return np.asarray(by_local @ self.R)


def second_moments(views: list[View], smoothing: float) -> Array:
    """Find the object's second moments (n, 3, 3) in X at n even times, smoothed over some of them.

    NaN where too few views tell them.
    """
    n = len(views[0].points)
    normal, right = np.zeros((n, 6, 6)), np.zeros((n, 6))
    counts = np.zeros(n)
    for view in views:
        seen = np.isfinite(view.spreads_px2).all(axis=1) & (view.points[:, 2] > 0.0)
        counts += seen
        J = np.where(seen[:, None, None], view.by_point(), 0.0)
        spreads = np.where(seen[:, None], view.spreads_px2, 0.0)
        for spread, (i, j) in zip(spreads.T, ((0, 0), (0, 1), (1, 1)), strict=True):
            a, b = J[:, i], J[:, j]
            mixed = [a[:, p] * b[:, q] + a[:, q] * b[:, p] for p, q in ((0, 1), (0, 2), (1, 2))]
            row = np.column_stack([a * b, *mixed])
            normal += row[:, :, None] * row[:, None, :]
            right += row * spread[:, None]
    enough = counts >= LEAST_VIEWS
    scales = np.trace(normal, axis1=1, axis2=2) + 1e-300
    # A ridge, as views from nearly one direction leave depth open.
    normal += (1e-9 * scales + np.where(enough, 0.0, 1.0))[:, None, None] * np.eye(6)
    found = np.linalg.solve(normal, right[..., None])[..., 0] * enough[:, None]
    weights = gaussian_filter1d(enough.astype(np.float64), smoothing, truncate=3.0)
    smooth = gaussian_filter1d(found, smoothing, axis=0, truncate=3.0)
    with np.errstate(invalid="ignore", divide="ignore"):
        smooth = np.where(weights[:, None] > 1e-6, smooth / weights[:, None], np.nan)
    places = [[0, 3, 4], [3, 1, 5], [4, 5, 2]]
    return np.asarray(smooth[:, places])


def perspective_shifts(view: View, moments: Array, depth_power: float) -> Array:
    """Give the centre of the image's area less the image of the object's centre (n, 2) [px].

    The moments (n, 3, 3) are in X; shifts are NaN where these are.
    """
    local = view.R @ moments @ view.R.T
    depths = view.points[:, 2:]
    towards = local[:, :2, 2] - view.points[:, :2] / depths * local[:, 2, 2][:, None]
    return np.asarray(-depth_power * view.focal_px * towards / depths**2)
