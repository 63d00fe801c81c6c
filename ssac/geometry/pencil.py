"""A relative pose in, the epipolar planes of both cameras out, told apart by one angle.

The epipolar planes of two cameras form a pencil: all hold the baseline, and an angle about it names
each of them, the same in both cameras.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ssac.geometry.pose import tangent_basis

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Pencil:
    """Epipolar planes in one camera: atan2(sine . p, cosine . p) is the angle of p = (x, y, 1)."""

    sine: Array  # (3,)
    cosine: Array  # (3,)

    def angles(self, points_px: Array) -> Array:
        """Angles (n,) [rad], in -pi to pi, of the planes through points (n, 2)."""
        return np.arctan2(*self._parts(points_px))

    def gradients(self, points_px: Array) -> Array:
        """Change (n, 2) [rad/px] of the angle with the point."""
        sines, cosines = self._parts(points_px)
        along = np.outer(cosines, self.sine[:2]) - np.outer(sines, self.cosine[:2])
        return np.asarray(along / (sines**2 + cosines**2)[:, None])

    def _parts(self, points_px: Array) -> tuple[Array, Array]:
        return (
            points_px @ self.sine[:2] + self.sine[2],
            points_px @ self.cosine[:2] + self.cosine[2],
        )


def pencils(R: Array, t: Array, K1: Array, K2: Array) -> tuple[Pencil, Pencil]:
    """Pencils of both cameras with x2 = R x1 + t; a plane has the same angle in both."""
    axes = tangent_basis(t)
    first, second = (
        Pencil(*(axis @ turn @ np.linalg.inv(K) for axis in axes))
        for turn, K in ((R, K1), (np.eye(3), K2))
    )
    return first, second
