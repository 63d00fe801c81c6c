"""Relative pose or F and point pairs in, epipolar lines and distances out.

Conventions after Hartley and Zisserman, for points p = (x, y) [px] taken as (x, y, 1):
p2' F p1 = 0, E = K2' F K1 = [t]x R, x2 = R x1 + t.
"""

from collections.abc import Sequence
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

Matrix = NDArray[np.float64]
Entries = Matrix | Sequence[float]
T = TypeVar("T", float, Matrix)


def cross_matrix(v: Matrix) -> Matrix:
    """Return [v]x (3, 3), with which [v]x w is the cross product of v and w."""
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def fundamental_from_pose(K1: Matrix, K2: Matrix, R: Matrix, t: Matrix) -> Matrix:
    """F = K2^-T [t]x R K1^-1 of the relative pose x2 = R x1 + t, as below the paper's Eq. 2."""
    return fundamental_from_essential(cross_matrix(t) @ R, K1, K2)


def fundamental_from_essential(E: Matrix, K1: Matrix, K2: Matrix) -> Matrix:
    """F = K2^-T E K1^-1; linear in E (..., 3, 3), so it also takes dE to dF."""
    return np.asarray(np.linalg.inv(K2).T @ E @ np.linalg.inv(K1))


def essential_from_fundamental(F: Matrix, K1: Matrix, K2: Matrix) -> Matrix:
    """E = K2' F K1; its two non-zero singular values differ as far as F is not exact."""
    return np.asarray(K2.T @ F @ K1)


def epipolar_lines_1(F: Matrix, p2_px: Matrix) -> Matrix:
    """Epipolar lines in image 1 of points in image 2.

    Parameters
    ----------
    F
        Shape (3, 3).
    p2_px
        Shape (..., 2) [px].

    Returns
    -------
    NDArray[np.float64]
        Shape (..., 3): lines l1 = F' p2, as (a, b, c) of a x + b y + c = 0, not normalised.
        Deviation: the paper writes l1 = F p2 below Eq. 3, which contradicts its own Eq. 2.
    """
    return np.asarray(p2_px @ F[:2] + F[2])


def epipolar_distance(F: Matrix, p1_px: Matrix, p2_px: Matrix) -> Matrix:
    """Distances d(p1, l1) in image 1 between points and epipolar lines, the summands of Eq. 4.

    Parameters
    ----------
    F
        Shape (3, 3).
    p1_px, p2_px
        Pairs, shape (..., 2) [px].

    Returns
    -------
    NDArray[np.float64]
        Shape (...,) [px], not negative; NaN where p2 is the epipole, which has no epipolar line.
    """
    lines = epipolar_lines_1(F, p2_px)
    with np.errstate(invalid="ignore"):
        products = np.sum(lines[..., :2] * p1_px, axis=-1) + lines[..., 2]
        return np.asarray(np.abs(products) / np.hypot(lines[..., 0], lines[..., 1]))


def epipolar_terms(f: Entries, u1: T, v1: T, u2: T, v2: T) -> tuple[T, T, T, T, T]:
    """p2' F p1, and the first two coordinates of the lines F p1 in image 2 and F' p2 in image 1.

    All that Sampson distances are made of. One definition for arrays and, compiled, for the kernels
    of `fundamental`.

    Parameters
    ----------
    f
        The nine entries of F, row by row.
    u1, v1, u2, v2
        Coordinates of p1 and p2: numbers, or arrays of one shape.
    """
    a2 = f[0] * u1 + f[1] * v1 + f[2]
    b2 = f[3] * u1 + f[4] * v1 + f[5]
    a1 = f[0] * u2 + f[3] * v2 + f[6]
    b1 = f[1] * u2 + f[4] * v2 + f[7]
    return u2 * a2 + v2 * b2 + (f[6] * u1 + f[7] * v1 + f[8]), a2, b2, a1, b1


def sampson_distance(F: Matrix, p1_px: Matrix, p2_px: Matrix) -> Matrix:
    """Signed Sampson distances: to first order, how far a pair is from satisfying Eq. 2.

    Parameters
    ----------
    F
        Shape (3, 3).
    p1_px, p2_px
        Pairs, shape (N, 2) [px].

    Returns
    -------
    NDArray[np.float64]
        Shape (N,) [px]: p2' F p1 / sqrt(|(F p1)_12|^2 + |(F' p2)_12|^2). Noise of deviation sigma
        in all four coordinates gives distances of deviation sigma.
    """
    products, gradients = _product_and_gradient(F, p1_px, p2_px)
    return np.asarray(products / np.linalg.norm(gradients, axis=0))


def sampson_derivative(
    F: Matrix, dF: Matrix, p1_px: Matrix, p2_px: Matrix, dp2_px: Matrix
) -> Matrix:
    """Differentiate `sampson_distance`, with F and p2 moving at the rates dF and dp2.

    Parameters
    ----------
    F, dF
        Shape (3, 3).
    p1_px, p2_px, dp2_px
        Shape (N, 2) [px].

    Returns
    -------
    NDArray[np.float64]
        Shape (N,) [px per unit of the parameter].
    """
    product, gradient = _product_and_gradient(F, p1_px, p2_px)
    d_product, d_gradient = _product_and_gradient(dF, p1_px, p2_px)
    d_product = d_product + np.sum(gradient[:2] * dp2_px.T, axis=0)
    d_gradient[2:] += F[:2, :2].T @ dp2_px.T
    norm = np.linalg.norm(gradient, axis=0)
    d_norm = np.sum(gradient * d_gradient, axis=0) / norm
    return np.asarray((d_product - product / norm * d_norm) / norm)


def sampson_gradient(F: Matrix, p1_px: Matrix, p2_px: Matrix) -> Matrix:
    """Differentiate `sampson_distance` by the entries of F, with p1 and p2 at rest.

    Parameters
    ----------
    F
        Shape (3, 3).
    p1_px, p2_px
        Pairs, shape (N, 2) [px].

    Returns
    -------
    NDArray[np.float64]
        Shape (N, 3, 3): its sum with dF over both indices is `sampson_derivative` by dF.
    """
    products, gradients = _product_and_gradient(F, p1_px, p2_px)
    norm = np.linalg.norm(gradients, axis=0)[:, None]
    ratio = products[:, None] / norm**2
    ones = np.ones((len(p1_px), 1))
    x1, x2 = np.hstack([p1_px, ones]), np.hstack([p2_px, ones])
    by_line_2, by_line_1 = x2.copy(), np.zeros_like(x1)
    by_line_2[:, :2] -= ratio * gradients[:2].T
    by_line_1[:, :2] = ratio * gradients[2:].T
    return np.asarray(
        (by_line_2[:, :, None] * x1[:, None, :] - x2[:, :, None] * by_line_1[:, None, :])
        / norm[:, :, None]
    )


def _product_and_gradient(F: Matrix, p1_px: Matrix, p2_px: Matrix) -> tuple[Matrix, Matrix]:
    """p2' F p1 (N,), and its derivatives (4, N) by the coordinates of p2 and then of p1."""
    product, *gradient = epipolar_terms(F.ravel(), *p1_px.T, *p2_px.T)
    return product, np.stack(gradient)
