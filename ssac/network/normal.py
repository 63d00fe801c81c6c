"""Sightings, linearised, in; the least-squares step of path and cameras, and its covariance, out.

The normal matrix is an arrowhead: banded where the path's coefficients are, with a border of the
parameters of the cameras. It is solved by the Schur complement of the band, in time linear in the
path's length, although the border grows with that too: a piece of a clock moves seconds of the path
and nothing beyond.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve, cholesky_banded
from scipy.sparse import csr_array

from ssac.network.kernels import (
    BAND,
    add_sightings,
    backward,
    forward,
    inverse_band,
    point_covariances,
)
from ssac.network.spline import ORDER

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

_BLOCK = 256  # of the path's numbers, in which the same cameras' parameters count


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
        self.mixed = np.zeros((n_border, m))
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
        sparse = csr_array(rows)
        self.border += (sparse.T @ sparse).toarray()
        self.right_border += rows.T @ residuals


@dataclass(frozen=True, eq=False)
class Solved:
    """A step, and the factors that tell its covariance."""

    path: Array  # (m / 3, 3)
    border: Array  # (b,) 0 where held
    free: Indices  # (f,) of the border's
    factor: Array  # (BAND, m) of the band
    half: Array  # (f, m) L^-1 of what path and cameras share, L being the factor
    spans: Indices  # (f, 2) where that is not 0
    schur: tuple[Array, bool] = field(repr=False)

    def border_covariance(self) -> Array:
        """Covariance (b, b) of the cameras' parameters; 0 where held."""
        covariance = np.zeros((len(self.border), len(self.border)))
        covariance[np.ix_(self.free, self.free)] = cho_solve(self.schur, np.eye(len(self.free)))
        return covariance

    def path_covariances(self, first: Indices, weights: Array, with_cameras: bool = True) -> Array:
        """Covariances (n, 3, 3) of the path's points, as of `basis`; of known cameras if not."""
        inverse = np.asarray(inverse_band(self.factor), np.float64)
        if with_cameras and len(self.free):
            # The path moves by -spread' when the cameras do, which adds spread' S^-1 spread to its
            # covariance, of which points need the band alone.
            spread, spans = backward(self.factor, self.half, self.spans)
            cameras = cho_solve(self.schur, np.eye(len(self.free)))
            for start, stop, active in _blocks(spans, spread.shape[1], BAND - 1):
                part = spread[active, start : stop + BAND - 1]
                told = cameras[np.ix_(active, active)] @ part
                for down in range(min(BAND, part.shape[1])):
                    n = min(stop - start, part.shape[1] - down)
                    inverse[down, start : start + n] += np.einsum(
                        "fi,fi->i", part[:, :n], told[:, down : down + n]
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
    half, spans = forward(factor, normal.mixed, free)
    alone, whole = forward(factor, normal.right_path[None], np.zeros(1, np.int64))
    border = normal.border[np.ix_(free, free)]
    schur = border + damping * np.diag(np.diag(border))
    right = normal.right_border[free]
    blocks = list(_blocks(spans, len(normal.right_path)))
    for start, stop, active in blocks:
        part = half[active, start:stop]
        schur[np.ix_(active, active)] -= part @ part.T
        right[active] -= part @ alone[0, start:stop]
    scale = np.sqrt(np.maximum(np.diag(border), 1e-300))
    # Scaled, as offsets, angles and pixels are of very different size.
    chol, low = cho_factor(schur / np.outer(scale, scale), lower=True)
    chol = np.tril(chol) * scale[:, None]
    step = cho_solve((chol, low), right)
    for start, stop, active in blocks:
        alone[0, start:stop] -= step[active] @ half[active, start:stop]
    whole[0] = 0, len(normal.right_path)
    path = backward(factor, alone, whole)[0][0]
    full = np.zeros(len(normal.right_border))
    full[free] = step
    return Solved(path.reshape(-1, 3), full, free, factor, half, spans, (chol, low))


def _blocks(spans: Indices, m: int, more: int = 0) -> Iterator[tuple[int, int, Indices]]:
    """Cut m places into blocks, and say which rows, of spans (f, 2), are not 0 in or just behind.

    Most of a camera's parameters move all of the path; those of a clock's pieces do so for seconds.
    """
    for start in range(0, m, _BLOCK):
        stop = min(start + _BLOCK, m)
        active = np.flatnonzero((spans[:, 0] < stop + more) & (spans[:, 1] > start))
        yield start, stop, active
