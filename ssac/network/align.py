"""Two sets of points in space that belong together in, the similarity between them out."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ssac.errors import SsacError

Array = NDArray[np.float64]

_LEAST_SPREAD = 1e-6
"""Second singular value by the first, below which points lie on a line: turns about it fit too."""


@dataclass(frozen=True, eq=False)
class Similarity:
    """Takes points from the source's frame to the target's: x -> scale R x + t."""

    scale: float
    R: Array  # (3, 3)
    t: Array  # (3,) in the target's unit

    def apply(self, points: Array) -> Array:
        """Give points (..., 3) in the target's frame."""
        return np.asarray(self.scale * points @ self.R.T + self.t)

    def inverse(self) -> "Similarity":
        """Give the similarity that takes the target's frame to the source's."""
        return Similarity(1.0 / self.scale, self.R.T, -self.R.T @ self.t / self.scale)

    def after(self, first: "Similarity") -> "Similarity":
        """Give the similarity that applies `first`, and then this one."""
        return Similarity(self.scale * first.scale, self.R @ first.R, self.apply(first.t))


def similarity(source: Array, target: Array, with_scale: bool = True) -> Similarity:
    """Fit the similarity of least squares (Umeyama, PAMI 1991, Eqs. 34 to 43).

    Parameters
    ----------
    source, target
        Points (n, 3), row by row the same ones.
    with_scale
        Whether the scale is free; 1 if not.

    Returns
    -------
    Similarity
        From the source's frame to the target's.

    Raises
    ------
    SsacError
        If the points of one side lie on a line or in a point, so that a turn is unknown.
    """
    shares: Array = np.full(len(source), 1.0 / max(len(source), 1))
    middle, middle_target = shares @ source, shares @ target
    centred, centred_target = source - middle, target - middle_target
    for points, name in ((centred, "source"), (centred_target, "target")):
        spread = np.linalg.svd(np.sqrt(shares)[:, None] * points, compute_uv=False)
        if len(spread) < 3 or spread[1] <= _LEAST_SPREAD * spread[0]:
            raise SsacError(
                f"the {name}'s {len(points)} points lie on a line or in one place, and do not tell "
                "how it is turned: give a path with a curve in it"
            )
    covariance = centred_target.T @ (shares[:, None] * centred)
    U, d, Vt = np.linalg.svd(covariance)
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(U) * np.linalg.det(Vt))])  # no reflection
    R = (U * signs) @ Vt
    scale = float(d @ signs / (shares @ np.sum(centred**2, axis=1))) if with_scale else 1.0
    return Similarity(scale, R, middle_target - scale * R @ middle)
