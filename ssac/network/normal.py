"""Sightings, linearised, in; the least-squares step of path and cameras, and its covariance, out.

The normal matrix is an arrowhead: banded where the path's coefficients are, with a border of the
few parameters of the cameras. It is solved by the Schur complement of the band, in time linear in
the path's length.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import (
    cho_factor,
    cho_solve,
    cho_solve_banded,
    cholesky_banded,
    solve_triangular,
)

from ssac.network.kernels import BAND, add_sightings, inverse_band, point_covariances
from ssac.path.spline import ORDER

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Linear:
    """Sightings of one camera, linearised, all over their deviations."""

    first: Indices  # (n,) of the path's coefficients
    weights: Array  # (n, 4)
    by_point: Array  # (n, 2, 3)
    by_camera: Array  # (n, 2, p)
    columns: Indices  # (n, p) among the border's
    residuals: Array  # (n, 2)


class Normal:
    """Normal equations: m numbers of the path, b of the cameras."""

    def __init__(self, n_coefficients: int, n_border: int) -> None:
        m = 3 * n_coefficients
        self.band = np.zeros((BAND, m))  # lower form
        self.mixed = np.zeros((m, n_border))
        self.border = np.zeros((n_border, n_border))
        self.right_path = np.zeros(m)
        self.right_border = np.zeros(n_border)

    def add(self, linear: Linear) -> None:
        """Add the sightings of one camera."""
        add_sightings(
            linear.first,
            np.ascontiguousarray(linear.weights),
            np.ascontiguousarray(linear.by_point),
            np.ascontiguousarray(linear.by_camera),
            linear.columns,
            np.ascontiguousarray(linear.residuals),
            self.band,
            self.mixed,
            self.border,
            self.right_path,
            self.right_border,
        )

    def add_smoothness(self, first: Indices, weights: Array, coefficients: Array) -> None:
        """Add k rows (k, 4), each of all three axes, whose products with the path are to be 0."""
        values = np.einsum("na,nax->nx", weights, coefficients[first[:, None] + np.arange(ORDER)])
        for a in range(ORDER):
            for x in range(3):
                np.add.at(self.right_path, 3 * (first + a) + x, -weights[:, a] * values[:, x])
                for b in range(a, ORDER):
                    entries = weights[:, a] * weights[:, b]
                    np.add.at(self.band[3 * (b - a)], 3 * (first + a) + x, entries)

    def add_rows(self, rows: Array, residuals: Array) -> None:
        """Add rows (k, b) that tell of the cameras alone, over their deviations."""
        self.border += rows.T @ rows
        self.right_border += rows.T @ residuals


@dataclass(frozen=True, eq=False)
class Solved:
    """A step, and the factors that tell its covariance."""

    path: Array  # (m / 3, 3)
    border: Array  # (b,) 0 where held
    free: Indices  # (f,) of the border's
    factor: Array  # (BAND, m) of the band
    spread: Array  # (m, f) how the path follows the cameras: it moves by -spread @ change
    schur: tuple[Array, bool] = field(repr=False)

    def border_covariance(self) -> Array:
        """Covariance (b, b) of the cameras' parameters; 0 where held."""
        covariance = np.zeros((len(self.border), len(self.border)))
        inverse = cho_solve(self.schur, np.eye(len(self.free)))
        covariance[np.ix_(self.free, self.free)] = inverse
        return covariance

    def path_covariances(self, first: Indices, weights: Array, with_cameras: bool = True) -> Array:
        """Covariances (n, 3, 3) of the path's points, as of `basis`; of known cameras if not."""
        inverse = np.asarray(inverse_band(self.factor), np.float64)
        if with_cameras and len(self.free):
            # What the cameras add is spread S^-1 spread', of which points need the band alone.
            chol, low = self.schur
            half = solve_triangular(chol, self.spread.T, lower=low)
            m = len(self.spread)
            for down in range(BAND):
                inverse[down, : m - down] += np.einsum(
                    "fi,fi->i", half[:, : m - down], half[:, down:]
                )
        return np.asarray(point_covariances(first, weights, inverse))


def solve(normal: Normal, free: Indices, damping: float = 0.0) -> Solved:
    """Solve the normal equations for the path and the free of the cameras' parameters.

    Raises
    ------
    np.linalg.LinAlgError
        If the data leave a combination of them open.
    """
    band = normal.band.copy()
    band[0] *= 1.0 + damping
    factor = np.asarray(cholesky_banded(band, lower=True), np.float64)
    mixed = normal.mixed[:, free]
    spread = np.asarray(cho_solve_banded((factor, True), mixed), np.float64) if len(free) else mixed
    border = normal.border[np.ix_(free, free)]
    schur = border + damping * np.diag(np.diag(border)) - mixed.T @ spread
    scale = np.sqrt(np.maximum(np.diag(border), 1e-300))
    right = normal.right_border[free] - spread.T @ normal.right_path
    # Scaled, as offsets, angles and pixels are of very different size.
    chol, low = cho_factor(schur / np.outer(scale, scale), lower=True)
    chol = np.tril(chol) * scale[:, None]
    step = cho_solve((chol, low), right)
    path = np.asarray(
        cho_solve_banded((factor, True), normal.right_path) - spread @ step, np.float64
    )
    full = np.zeros(len(normal.right_border))
    full[free] = step
    return Solved(path.reshape(-1, 3), full, free, factor, spread, (chol, low))
