"""The path's splines, and the normal equations of path and cameras.

The normal matrix is an arrowhead: banded where the path's coefficients are, with a border of the
parameters of the cameras. It is solved by the Schur complement of the band, in time linear in the
path's length, although the border grows with that too, because a piece of a clock affects only
seconds of the path.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field

import numba
import numpy as np
from scipy.linalg import cho_factor, cho_solve, cholesky_banded
from scipy.sparse import csr_array

from ssac.arrays import Array, IntArray

BAND = 12
"""Entries of a column of the lower band: four neighbouring coefficients of three axes."""

ORDER = 4
"""Basis splines that are not zero at a time: four for a cubic."""


@dataclass(frozen=True, eq=False)
class Spline:
    """A curve in space, smooth in time: twice continuously differentiable."""

    knots_s: Array  # (m + 4,) ascending
    coefficients: Array  # (m, 3)

    def at(self, times_s: Array, derivative: int = 0) -> Array:
        """Positions (n, 3) at times (n,) [s], or derivatives; the end cubics extend beyond."""
        first, weights = basis(self.knots_s, times_s, derivative)
        return products(first, weights, self.coefficients)


def knots_for(times_s: Array, step_s: float, max_gap_s: float) -> Array:
    """Place knots (m + 4,), ends fourfold, at most a step apart where times (n,) have no gaps."""
    ordered = np.sort(times_s)
    ends = np.flatnonzero(np.diff(ordered) > max_gap_s)
    starts = np.concatenate([[0], ends + 1])
    stops = np.concatenate([ends, [len(ordered) - 1]])
    parts = []
    for start, stop in zip(ordered[starts], ordered[stops], strict=True):
        n = max(1, int(np.ceil((stop - start) / step_s)))
        parts.append(np.linspace(start, stop, n + 1, dtype=np.float64))
    inner = np.unique(np.concatenate(parts))
    inner = inner[np.concatenate([[True], np.diff(inner) > 1e-3 * step_s])]
    if len(inner) < 2:
        inner = inner[0] + step_s * np.arange(2.0)
    return np.concatenate([np.repeat(inner[0], 3), inner, np.repeat(inner[-1], 3)])


def basis(knots_s: Array, times_s: Array, derivative: int = 0) -> tuple[IntArray, Array]:
    """Evaluate the basis splines that are not zero at times (n,), by de Boor's recursion.

    Returns the index (n,) of the first of four neighbouring coefficients, and their weights (n, 4)
    for the derivative of that order, up to 3 [1/s^derivative].
    """
    m = len(knots_s) - ORDER
    span = np.clip(np.searchsorted(knots_s, times_s, side="right") - 1, ORDER - 1, m - 1)
    weights = np.ones((len(times_s), 1))
    for degree in range(1, ORDER):
        raised = np.zeros((len(times_s), degree + 1))
        for i in range(degree):  # spline i of the lower degree begins at this knot
            begin = span - degree + 1 + i
            low, high = knots_s[begin], knots_s[begin + degree]
            if degree > ORDER - 1 - derivative:
                slope = degree * weights[:, i] / (high - low)
                raised[:, i] -= slope
                raised[:, i + 1] += slope
            else:
                share = weights[:, i] / (high - low)
                raised[:, i] += (high - times_s) * share
                raised[:, i + 1] += (times_s - low) * share
        weights = raised
    return (span - ORDER + 1).astype(np.int64), weights


def products(first: IntArray, weights: Array, coefficients: Array) -> Array:
    """Weighted sums (n, 3) of four neighbouring coefficients (m, 3) each, as of `basis`."""
    around = coefficients[first[:, None] + np.arange(ORDER)]
    return np.asarray(np.einsum("na,nax->nx", weights, around))


def jerks(knots_s: Array) -> tuple[IntArray, Array]:
    """Rows [s^-2.5] as of `basis`, whose products' squares sum to the squared jerk's integral."""
    inner = knots_s[ORDER - 1 : len(knots_s) - ORDER + 1]
    first, weights = basis(knots_s, 0.5 * (inner[:-1] + inner[1:]), 3)
    return first, weights * np.sqrt(np.diff(inner))[:, None]


@dataclass(frozen=True, eq=False)
class Linear:
    """Linearised sightings of one camera, divided by their deviations."""

    first: IntArray  # (n,) of four coefficients of the path
    weights: Array  # (n, 4)
    by_point: Array  # (n, 2, 3)
    by_camera: Array  # (n, 2, p) by the parameters at `columns`
    columns: IntArray  # (n, p) places in the border
    residuals: Array  # (n, 2)

    def weighed(self, rows: IntArray, scale: Array, offset: int) -> "Linear":
        """Return chosen rows, each times a scale, of a camera whose columns begin at an offset."""
        by_point, by_camera = (
            part[rows] * scale[:, None, None] for part in (self.by_point, self.by_camera)
        )
        residuals = self.residuals[rows] * scale[:, None]
        places = self.columns[rows] + offset
        return Linear(self.first[rows], self.weights[rows], by_point, by_camera, places, residuals)


class Normal:
    """Normal equations of the path's m coefficients and the cameras' b parameters."""

    def __init__(self, n_coefficients: int, n_border: int) -> None:
        m = 3 * n_coefficients
        self.band = np.zeros((BAND, m))  # lower form
        self.mixed = np.zeros((n_border, m))
        self.border = np.zeros((n_border, n_border))
        self.right_path = np.zeros(m)
        self.right_border = np.zeros(n_border)
        self.pull = np.zeros(m)  # on the path, which only the cameras follow

    def add(self, linear: Linear) -> None:
        """Add the sightings of one camera."""
        parts = linear.weights, linear.by_point, linear.by_camera, linear.residuals
        weights, by_point, by_camera, residuals = map(np.ascontiguousarray, parts)
        path, border = (self.band, self.right_path), (self.border, self.right_border)
        places = linear.first, linear.columns
        _add_sightings(places, weights, by_point, by_camera, residuals, path, border, self.mixed)

    def add_smoothness(self, first: IntArray, weights: Array, coefficients: Array) -> Array:
        """Add rows (k, 4) for all axes, whose `products` (k, 3) are to be 0; return the latter."""
        values = products(first, weights, coefficients)
        for a in range(ORDER):
            for x in range(3):
                np.add.at(self.right_path, 3 * (first + a) + x, -weights[:, a] * values[:, x])
                for b in range(a, ORDER):
                    entries = weights[:, a] * weights[:, b]
                    np.add.at(self.band[3 * (b - a)], 3 * (first + a) + x, entries)
        return values

    def add_rows(self, rows: Array, residuals: Array) -> None:
        """Add rows (k, b) of the cameras' parameters alone, divided by their deviations."""
        sparse = csr_array(rows)
        self.border += (sparse.T @ sparse).toarray()
        self.right_border += rows.T @ residuals


@dataclass(frozen=True, eq=False)
class Solved:
    """A step, and the factors that give its covariance."""

    path: Array  # (m / 3, 3)
    border: Array  # (b,) 0 where held
    free: IntArray  # (f,) places in the border
    factor: Array  # (BAND, m) Cholesky factor L of the band
    half: Array  # (f, m) L^-1 times the free rows that path and cameras share
    schur: tuple[Array, bool] = field(repr=False)

    def border_covariance(self) -> Array:
        """Covariance (b, b) of the cameras' parameters; 0 where held."""
        covariance = np.zeros((len(self.border), len(self.border)))
        covariance[np.ix_(self.free, self.free)] = cho_solve(self.schur, np.eye(len(self.free)))
        return covariance

    def path_covariances(self, first: IntArray, weights: Array, with_cameras: bool = True) -> Array:
        """Covariances (n, 3, 3) of points as of `basis`; without cameras, these count as known."""
        inverse = np.asarray(_inverse_band(self.factor), np.float64)
        if with_cameras and len(self.free):
            # The path moves by -spread' when the cameras do, which adds spread' S^-1 spread to its
            # covariance, of which points need the band alone.
            spread, spans = _backward(self.factor, self.half)
            cameras = cho_solve(self.schur, np.eye(len(self.free)))
            for start, stop, active in _blocks(spans, spread.shape[1], BAND - 1):
                part = spread[active, start : stop + BAND - 1]
                spread_back = cameras[np.ix_(active, active)] @ part
                for down in range(min(BAND, part.shape[1])):
                    n = min(stop - start, part.shape[1] - down)
                    inverse[down, start : start + n] += np.einsum(
                        "fi,fi->i", part[:, :n], spread_back[:, down : down + n]
                    )
        return np.asarray(_point_covariances(first, weights, inverse))


def solve(normal: Normal, free: IntArray, damping: float = 0.0) -> Solved:
    """Solve for the path and the free parameters; LinAlgError if any is undetermined."""
    band = normal.band.copy()
    band[0] *= 1.0 + damping
    factor = np.asarray(cholesky_banded(band, lower=True), np.float64)
    half, spans = _forward(factor, normal.mixed, free)
    alone, _ = _forward(factor, np.stack([normal.right_path, normal.pull]), np.arange(2))
    border = normal.border[np.ix_(free, free)]
    schur = border + damping * np.diag(np.diag(border))
    right = normal.right_border[free]
    blocks = list(_blocks(spans, len(normal.right_path)))
    for start, stop, active in blocks:
        part = half[active, start:stop]
        schur[np.ix_(active, active)] -= part @ part.T
        right[active] -= part @ alone[:, start:stop].sum(axis=0)
    scale = np.sqrt(np.maximum(np.diag(border), 1e-300))
    # Scaled, as offsets, angles and pixels are of very different size.
    chol, low = cho_factor(schur / np.outer(scale, scale), lower=True)
    chol = np.tril(chol) * scale[:, None]
    step = cho_solve((chol, low), right)
    for start, stop, active in blocks:
        alone[0, start:stop] -= step[active] @ half[active, start:stop]
    path = _backward(factor, alone[:1])[0][0]
    full = np.zeros(len(normal.right_border))
    full[free] = step
    return Solved(path.reshape(-1, 3), full, free, factor, half, (chol, low))


def _blocks(spans: IntArray, m: int, more: int = 0) -> Iterator[tuple[int, int, IntArray]]:
    """Yield blocks of m places, each with the rows whose spans (f, 2) of non-zeros reach it."""
    block = 256
    for start in range(0, m, block):
        stop = min(start + block, m)
        active = np.flatnonzero((spans[:, 0] < stop + more) & (spans[:, 1] > start))
        yield start, stop, active


@numba.njit(cache=True)
def _add_sightings(
    places: tuple[IntArray, IntArray],
    weights: Array,
    by_point: Array,
    by_camera: Array,
    residuals: Array,
    of_path: tuple[Array, Array],
    of_border: tuple[Array, Array],
    mixed: Array,
) -> None:
    """Add n sightings, as of `Linear`, to the normal equations, as of `Normal`."""
    (first, columns), (band, right_path), (border, right_border) = places, of_path, of_border
    n, p = columns.shape
    for i in range(n):
        for a in range(4):
            row = 3 * (first[i] + a)
            for x in range(3):
                along_0 = weights[i, a] * by_point[i, 0, x]
                along_1 = weights[i, a] * by_point[i, 1, x]
                right_path[row + x] += along_0 * residuals[i, 0] + along_1 * residuals[i, 1]
                for c in range(p):
                    mixed[columns[i, c], row + x] += (
                        along_0 * by_camera[i, 0, c] + along_1 * by_camera[i, 1, c]
                    )
                for b in range(a, 4):
                    for y in range(3):
                        down = 3 * (b - a) + y - x
                        if down >= 0:
                            both = along_0 * by_point[i, 0, y] + along_1 * by_point[i, 1, y]
                            band[down, row + x] += weights[i, b] * both
        for c in range(p):
            k = columns[i, c]
            for z in range(2):
                right_border[k] += by_camera[i, z, c] * residuals[i, z]
                for d in range(p):
                    border[k, columns[i, d]] += by_camera[i, z, c] * by_camera[i, z, d]


@numba.njit(cache=True)
def _forward(factor: Array, mixed: Array, chosen: IntArray) -> tuple[Array, IntArray]:
    """Solve L y = x for f chosen rows x of (b, m): y (f, m), and its spans (f, 2) of non-zeros."""
    # For an x that is short in time, as of a piece of a clock, y fades from its last entry on.
    m = factor.shape[1]
    solved, spans = np.zeros((len(chosen), m)), np.zeros((len(chosen), 2), np.int64)
    for k in range(len(chosen)):
        given, own = mixed[chosen[k]], solved[k]
        start, stop = 0, m
        while start < m and given[start] == 0.0:
            start += 1
        while stop > start and given[stop - 1] == 0.0:
            stop -= 1
        largest, faded, i = 0.0, 0, start  # faded: a whole band of negligible entries
        while i < m and (i < stop or faded < BAND - 1):
            value = given[i]
            for j in range(1, min(BAND - 1, i - start) + 1):
                value -= factor[j, i - j] * own[i - j]
            own[i] = value / factor[0, i]
            largest = max(largest, abs(own[i]))
            faded = faded + 1 if abs(own[i]) <= 1e-18 * largest else 0
            i += 1
        spans[k, 0], spans[k, 1] = start, i
    return solved, spans


def _backward(factor: Array, right: Array) -> tuple[Array, IntArray]:
    """Solve L' y = x for rows x (f, m): `_forward` from the end on, with a mirrored band."""
    mirrored = np.zeros_like(factor)
    for down, entries in enumerate(factor):
        mirrored[down, : len(entries) - down] = entries[len(entries) - 1 - down :: -1]
    from_end = np.ascontiguousarray(right[:, ::-1])
    solved, spans = _forward(mirrored, from_end, np.arange(len(right)))
    return np.ascontiguousarray(solved[:, ::-1]), factor.shape[1] - spans[:, ::-1]


@numba.njit(cache=True)
def _inverse_band(factor: Array) -> Array:
    """Return the band of (L L')^-1 from that of L (BAND, m), by Takahashi's recursion."""
    m = factor.shape[1]
    inverse = np.zeros_like(factor)
    for i in range(m - 1, -1, -1):
        last = min(BAND - 1, m - 1 - i)
        for j in range(last, 0, -1):
            value = 0.0
            for k in range(1, last + 1):
                low, high = min(j, k), max(j, k)
                value -= factor[k, i] * inverse[high - low, i + low]
            inverse[j, i] = value / factor[0, i]
        value = 1.0 / factor[0, i]
        for k in range(1, last + 1):
            value -= factor[k, i] * inverse[k, i]
        inverse[0, i] = value / factor[0, i]
    return inverse


@numba.njit(cache=True)
def _point_covariances(first: IntArray, weights: Array, inverse: Array) -> Array:
    """Covariances (n, 3, 3) of a path's points, from the band of its inverse normal matrix."""
    n = len(first)
    found = np.zeros((n, 3, 3))
    for i in range(n):
        for a in range(4):
            for b in range(4):
                share = weights[i, a] * weights[i, b]
                for x in range(3):
                    for y in range(3):
                        row, column = 3 * (first[i] + a) + x, 3 * (first[i] + b) + y
                        low, high = min(row, column), max(row, column)
                        found[i, x, y] += share * inverse[high - low, low]
    return found
