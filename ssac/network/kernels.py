"""The loops over sightings and over the banded normal matrix of a path, compiled."""

import numba
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

BAND = 12
"""Entries of a column of the lower band: four neighbouring coefficients of three axes."""

_FADED = 1e-18
"""Share of a row's largest entry below which a band of entries is nothing beside rounding."""


@numba.njit(cache=True)
def add_sightings(
    first: Indices,
    weights: Array,
    by_point: Array,
    by_camera: Array,
    columns: Indices,
    residuals: Array,
    band: Array,
    mixed: Array,
    border: Array,
    right_path: Array,
    right_border: Array,
) -> None:
    """Add n sightings to the normal equations, all of them already over their deviations.

    Parameters
    ----------
    first, weights
        Of the path's coefficients at each sighting's time: (n,) and (n, 4).
    by_point, by_camera, columns
        Derivatives (n, 2, 3) and (n, 2, p), and the places (n, p) of the latter among the border's.
    residuals
        Shape (n, 2).
    band, mixed, border, right_path, right_border
        Added to: (BAND, m) of the path, lower form; (b, m); (b, b); (m,); (b,).
    """
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
                            band[down, row + x] += weights[i, b] * (
                                along_0 * by_point[i, 0, y] + along_1 * by_point[i, 1, y]
                            )
        for c in range(p):
            k = columns[i, c]
            for z in range(2):
                right_border[k] += by_camera[i, z, c] * residuals[i, z]
                for d in range(p):
                    border[k, columns[i, d]] += by_camera[i, z, c] * by_camera[i, z, d]


@numba.njit(cache=True)
def forward(factor: Array, mixed: Array, chosen: Indices) -> tuple[Array, Indices]:
    """Solve L y = x for some rows x of a matrix, where they are not next to nothing.

    What is short in time, as a piece of a clock, has an end in y too: it fades by some factor from
    each of the path's coefficients to the next.

    Parameters
    ----------
    factor
        L in lower form (BAND, m), as of `scipy.linalg.cholesky_banded`.
    mixed, chosen
        Shape (b, m), and which of its rows (f,).

    Returns
    -------
    tuple
        Shape (f, m), and of each the first place that is not 0 and the one after the last (f, 2).
    """
    m = factor.shape[1]
    solved, spans = np.zeros((len(chosen), m)), np.zeros((len(chosen), 2), np.int64)
    for k in range(len(chosen)):
        given, own = mixed[chosen[k]], solved[k]
        start, stop = 0, m
        while start < m and given[start] == 0.0:
            start += 1
        while stop > start and given[stop - 1] == 0.0:
            stop -= 1
        largest, faded, i = 0.0, 0, start
        while i < m and (i < stop or faded < BAND - 1):
            value = given[i]
            for j in range(1, min(BAND - 1, i - start) + 1):
                value -= factor[j, i - j] * own[i - j]
            own[i] = value / factor[0, i]
            largest = max(largest, abs(own[i]))
            faded = faded + 1 if abs(own[i]) <= _FADED * largest else 0
            i += 1
        spans[k, 0], spans[k, 1] = start, i
    return solved, spans


@numba.njit(cache=True)
def backward(factor: Array, right: Array, spans: Indices) -> tuple[Array, Indices]:
    """Solve L' y = x for rows x, each of a span as of `forward`, which gives y alike."""
    m = factor.shape[1]
    solved, found = np.zeros(right.shape), np.zeros(spans.shape, np.int64)
    for k in range(len(right)):
        given, own = right[k], solved[k]
        start, stop = spans[k, 0], spans[k, 1]
        largest, faded, i = 0.0, 0, stop - 1
        while i >= 0 and (i >= start or faded < BAND - 1):
            value = given[i]
            for j in range(1, min(BAND - 1, m - 1 - i) + 1):
                value -= factor[j, i] * own[i + j]
            own[i] = value / factor[0, i]
            largest = max(largest, abs(own[i]))
            faded = faded + 1 if abs(own[i]) <= _FADED * largest else 0
            i -= 1
        found[k, 0], found[k, 1] = i + 1, stop
    return solved, found


@numba.njit(cache=True)
def inverse_band(factor: Array) -> Array:
    """Give the band of a matrix's inverse from its banded Cholesky factor: Takahashi's recursion.

    Parameters
    ----------
    factor
        Lower form (BAND, m), as of `scipy.linalg.cholesky_banded`.

    Returns
    -------
    Array
        Lower form (BAND, m).
    """
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
def point_covariances(first: Indices, weights: Array, inverse: Array) -> Array:
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
