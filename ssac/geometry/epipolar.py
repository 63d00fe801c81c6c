"""Relative pose or F and point pairs in, epipolar lines and distances out.

Conventions after Hartley and Zisserman, for points p = (x, y) [px] taken as (x, y, 1):
p2' F p1 = 0, E = K2' F K1 = [t]x R, x2 = R x1 + t.
"""

import numpy as np
from numpy.typing import NDArray

Matrix = NDArray[np.float64]


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
    products, lines_2, lines_1 = _epipolar_terms(F, p1_px, p2_px)
    return np.asarray(products / _gradient_norm(lines_2, lines_1))


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
    product, lines_2, lines_1 = _epipolar_terms(F, p1_px, p2_px)
    d_product, d_lines_2, d_lines_1 = _epipolar_terms(dF, p1_px, p2_px)
    d_product = d_product + np.sum(lines_2[:, :2] * dp2_px, axis=1)
    d_lines_1 = d_lines_1 + dp2_px @ F[:2]
    norm = _gradient_norm(lines_2, lines_1)
    d_norm = (
        np.sum(lines_2[:, :2] * d_lines_2[:, :2], axis=1)
        + np.sum(lines_1[:, :2] * d_lines_1[:, :2], axis=1)
    ) / norm
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
    products, lines_2, lines_1 = _epipolar_terms(F, p1_px, p2_px)
    norm = _gradient_norm(lines_2, lines_1)[:, None]
    ratio = products[:, None] / norm**2
    ones = np.ones((len(p1_px), 1))
    x1, x2 = np.hstack([p1_px, ones]), np.hstack([p2_px, ones])
    by_line_2, by_line_1 = x2.copy(), ratio * lines_1
    by_line_2[:, :2] -= ratio * lines_2[:, :2]
    by_line_1[:, 2] = 0.0
    return np.asarray(
        (by_line_2[:, :, None] * x1[:, None, :] - x2[:, :, None] * by_line_1[:, None, :])
        / norm[:, :, None]
    )


def _epipolar_terms(F: Matrix, p1_px: Matrix, p2_px: Matrix) -> tuple[Matrix, Matrix, Matrix]:
    """p2' F p1 (N,), lines F p1 (N, 3) in image 2 and lines F' p2 (N, 3) in image 1."""
    lines_2 = p1_px @ F.T[:2] + F.T[2]
    products = np.sum(lines_2[:, :2] * p2_px, axis=1) + lines_2[:, 2]
    return products, lines_2, epipolar_lines_1(F, p2_px)


def _gradient_norm(lines_2: Matrix, lines_1: Matrix) -> Matrix:
    """Norm (N,) of the gradient of p2' F p1 with respect to the four coordinates."""
    return np.asarray(
        np.sqrt(np.sum(lines_2[:, :2] ** 2, axis=1) + np.sum(lines_1[:, :2] ** 2, axis=1))
    )
