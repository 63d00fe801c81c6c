"""Epipolar lines and distances of point pairs, and robust statistics of residuals.

Conventions after Hartley and Zisserman, for points p = (x, y) [px] taken as (x, y, 1):
p2' F p1 = 0, E = K2' F K1 = [t]x R, x2 = R x1 + t.
"""

from collections.abc import Callable, Sequence
from functools import lru_cache

import numba
import numpy as np

from ssac.arrays import Array

CAUCHY = 2.385  # scale of Cauchy's loss, in robust deviations: 95 % efficiency on Gaussian noise
TO_DEVIATION = 1.4826  # from the median absolute value of Gaussian noise to its deviation


def robust_deviation(residuals: Array) -> float:
    """Deviation, from zero, of Gaussian noise with the same median absolute value."""
    return float(TO_DEVIATION * np.median(np.abs(residuals)))


def cauchy_weights(residuals: Array, turn: float = CAUCHY) -> tuple[Array, Array]:
    """First derivative of Cauchy's loss divided by the residual, and second derivative: (n,) each.

    The second derivative changes sign `turn` robust standard deviations from zero.
    """
    deviation = robust_deviation(residuals) + 1e-12  # not 0 where all residuals are
    squares = (residuals / (turn * deviation)) ** 2
    return 1.0 / (1.0 + squares), (1.0 - squares) / (1.0 + squares) ** 2


def cross_matrix(v: Array) -> Array:
    """Return [v]x (3, 3), with which [v]x w is the cross product of v and w."""
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def fundamental_from_pose(K1: Array, K2: Array, R: Array, t: Array) -> Array:
    """F = K2^-T [t]x R K1^-1 of the relative pose x2 = R x1 + t, as below the paper's Eq. 2."""
    return fundamental_from_essential(cross_matrix(t) @ R, K1, K2)


def fundamental_from_essential(E: Array, K1: Array, K2: Array) -> Array:
    """F = K2^-T E K1^-1; linear in E (..., 3, 3), so it also takes dE to dF."""
    inverse1, inverse2 = (_inverse(np.asarray(K, np.float64).tobytes()) for K in (K1, K2))
    return np.asarray(inverse2.T @ E @ inverse1)


@lru_cache  # a refinement asks for the same two at each of thousands of steps
def _inverse(K: bytes) -> Array:
    return np.asarray(np.linalg.inv(np.frombuffer(K, np.float64).reshape(3, 3)))


def epipolar_lines_1(F: Array, p2_px: Array) -> Array:
    """Epipolar lines (..., 3) in image 1 of points (..., 2) in image 2.

    They are l1 = F' p2, as (a, b, c) of a x + b y + c = 0, not normalised.
    Deviation: the paper writes l1 = F p2 below Eq. 3, which contradicts its own Eq. 2.
    """
    return np.asarray(p2_px @ F[:2] + F[2])


def epipolar_distance(F: Array, p1_px: Array, p2_px: Array) -> Array:
    """Distances d(p1, l1) (...,) [px] in image 1 of pairs (..., 2), the summands of Eq. 4.

    NaN where p2 is the epipole; infinite where its line is the line at infinity.
    """
    lines = epipolar_lines_1(F, p2_px)
    with np.errstate(divide="ignore", invalid="ignore"):
        a, b, c = lines[..., 0], lines[..., 1], lines[..., 2]  # by columns: np.sum of two is slow
        products = a * p1_px[..., 0] + b * p1_px[..., 1] + c
        return np.asarray(np.abs(products) / np.hypot(a, b))


def epipolar_terms(
    f: Array | Sequence[float], u1: float, v1: float, u2: float, v2: float
) -> tuple[float, float, float, float, float]:
    """p2' F p1, and the first two coordinates of the lines F p1 in image 2 and F' p2 in image 1.

    To be compiled in kernels; f has the nine entries of F, row by row.
    """
    a2 = f[0] * u1 + f[1] * v1 + f[2]
    b2 = f[3] * u1 + f[4] * v1 + f[5]
    a1 = f[0] * u2 + f[3] * v2 + f[6]
    b1 = f[1] * u2 + f[4] * v2 + f[7]
    return u2 * a2 + v2 * b2 + (f[6] * u1 + f[7] * v1 + f[8]), a2, b2, a1, b1


def sampson_distance(F: Array, p1_px: Array, p2_px: Array) -> Array:
    """Signed Sampson distances (N,) [px]: to first order, how far pairs (N, 2) are from Eq. 2.

    They are p2' F p1 / sqrt(|(F p1)_12|^2 + |(F' p2)_12|^2). Noise of deviation sigma in all four
    coordinates gives distances of deviation sigma.
    """
    p1, p2 = (np.ascontiguousarray(points_px) for points_px in (p1_px, p2_px))
    return np.asarray(distances_of(F.ravel(), p1, p2))


def sampson_derivative(F: Array, p1_px: Array, p2_px: Array, dp2_px: Array) -> Array:
    """Differentiate `sampson_distance` (..., N), with p2 moving at the rates dp2 (..., N, 2)."""
    rates = np.ascontiguousarray(dp2_px).reshape(-1, len(p2_px), 2)
    p1, p2 = (np.ascontiguousarray(points_px) for points_px in (p1_px, p2_px))
    return np.asarray(_derivatives(F.ravel(), p1, p2, rates).reshape(dp2_px.shape[:-1]))


def sampson_gradient(F: Array, p1_px: Array, p2_px: Array) -> Array:
    """Differentiate `sampson_distance` by the entries of F: (N, 3, 3)."""
    points = (np.ascontiguousarray(points_px) for points_px in (p1_px, p2_px))
    return np.asarray(_by_entries(F.ravel(), *points))


compiled_terms: Callable[..., tuple[float, float, float, float, float]] = numba.njit(cache=True)(
    epipolar_terms
)


@numba.njit(cache=True, error_model="numpy")  # no line at an epipole: NaN, not an exception
def distances_of(f: Array, p1: Array, p2: Array) -> Array:
    """Return `sampson_distance` (n,) for the nine entries of F; also for other kernels."""
    found = np.empty(len(p1))
    for i in range(len(p1)):
        product, a2, b2, a1, b1 = compiled_terms(f, p1[i, 0], p1[i, 1], p2[i, 0], p2[i, 1])
        found[i] = product / np.sqrt(a2 * a2 + b2 * b2 + a1 * a1 + b1 * b1)
    return found


@numba.njit(cache=True, error_model="numpy")
def _derivatives(f: Array, p1: Array, p2: Array, rates: Array) -> Array:
    found = np.empty(rates.shape[:2])
    for i in range(len(p1)):
        u1, v1, u2, v2 = p1[i, 0], p1[i, 1], p2[i, 0], p2[i, 1]
        product, a2, b2, a1, b1 = compiled_terms(f, u1, v1, u2, v2)
        norm = np.sqrt(a2 * a2 + b2 * b2 + a1 * a1 + b1 * b1)
        for k in range(len(rates)):
            du2, dv2 = rates[k, i, 0], rates[k, i, 1]
            d_product = a2 * du2 + b2 * dv2
            d_a1 = f[0] * du2 + f[3] * dv2
            d_b1 = f[1] * du2 + f[4] * dv2
            d_norm = (a1 * d_a1 + b1 * d_b1) / norm
            found[k, i] = (d_product - product / norm * d_norm) / norm
    return found


@numba.njit(cache=True, error_model="numpy")
def _by_entries(f: Array, p1: Array, p2: Array) -> Array:
    found = np.empty((len(p1), 3, 3))
    for i in range(len(p1)):
        u1, v1, u2, v2 = p1[i, 0], p1[i, 1], p2[i, 0], p2[i, 1]
        product, a2, b2, a1, b1 = compiled_terms(f, u1, v1, u2, v2)
        norm = np.sqrt(a2 * a2 + b2 * b2 + a1 * a1 + b1 * b1)
        ratio = product / norm**2
        x1, x2 = (u1, v1, 1.0), (u2, v2, 1.0)
        by_line_2 = (u2 - ratio * a2, v2 - ratio * b2, 1.0)
        by_line_1 = (ratio * a1, ratio * b1, 0.0)
        for row in range(3):
            for column in range(3):
                entry = by_line_2[row] * x1[column] - x2[row] * by_line_1[column]
                found[i, row, column] = entry / norm
    return found
