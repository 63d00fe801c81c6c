"""Point pairs with outliers in, F out: LMedS as in the paper, and two alternatives.

Deviation: the paper names LMedS only, and its sample uses OpenCV's. That one stops at about 450
trials (at confidence 0.999), whatever number it is asked for, and returns the seven-point solution
of its best trial, which makes d_avg a jagged curve. Here every trial asked for is made, with eight
pairs, whose solution is linear, and the best one starts the reweighted least squares with which
Rousseeuw's LMedS ends.
"""

from functools import lru_cache

import cv2
import numba
import numpy as np
from numpy.typing import NDArray

from ssac.geometry.epipolar import fundamental_from_essential
from ssac.geometry.robust import CAUCHY, TO_DEVIATION
from ssac.geometry.subsets import best_subset, sampson

Matrix = NDArray[np.float64]

MIN_PAIRS = 15
"""Fewer pairs leave too little freedom beside F's seven for a median to mean anything."""

_POLISH_ITERATIONS = 8
_MAGSAC_THRESHOLD_PX = 1.0
_NOT_YET = np.zeros((3, 3))  # an F
_TWO_COORDINATES = ((0, 0), (1, 0), (1, 1), (2, 0), (2, 1), (2, 2))  # of (u, v, 1)


def lmeds_fundamental(p1_px: Matrix, p2_px: Matrix, trials: int, seed: int = 0) -> Matrix:
    """F by least median of squares over Sampson distances, then reweighted least squares.

    Parameters
    ----------
    p1_px, p2_px
        Pairs, shape (N, 2) [px], N >= 8.
    trials
        Random subsets of eight pairs to try.
    seed
        Of the subsets; the same seed gives the same F.

    Returns
    -------
    NDArray[np.float64]
        F, shape (3, 3), rank 2; NaN when the pairs allow none, as those of an object at rest.
    """
    x1, x2, T1, T2 = _normalised(p1_px, p2_px)
    F = best_subset(x1, x2, _uniform(trials, seed))
    if not F.any():
        return np.full((3, 3), np.nan)
    return np.asarray(T2.T @ _reweighted(x1, x2, F) @ T1)


def reweighted_fundamental(p1_px: Matrix, p2_px: Matrix) -> Matrix:
    """F by the eight-point algorithm, then reweighted least squares: cheaper, for few outliers.

    Pairs and result as for `lmeds_fundamental`.
    """
    x1, x2, T1, T2 = _normalised(p1_px, p2_px)
    if not (x1.any() or x2.any()):  # an object at rest
        return np.full((3, 3), np.nan)
    return np.asarray(T2.T @ _reweighted(x1, x2, _NOT_YET) @ T1)


@numba.njit(cache=True, error_model="numpy")
def median_after_fit(p1_px: Matrix, p2_px: Matrix, iterations: int) -> float:
    """Median Sampson distance [px] of pairs (n, 2) from the F that fits most of them.

    As `reweighted_fundamental`, in fewer iterations, for loops that are compiled.
    """
    x1, x2, T1, _ = _normalised(p1_px, p2_px)
    F = _reweighted(x1, x2, np.zeros((3, 3)), iterations)
    squares, _ = sampson(F, x1, x2)
    median_px: float = np.sqrt(np.median(squares)) / T1[0, 0]
    return median_px


def second_best(p1_px: Matrix, p2_px: Matrix) -> float:
    """How many times worse than the best F another one fits the pairs, one as unlike it as can be.

    The ratio of the two least singular values of the weighted eight-point system. Near 1 the pairs
    leave F open: those of a planar path allow a family of them, whatever the noise.

    Pairs as for `lmeds_fundamental`; 1 when they allow no F at all, as those of an object at rest.
    """
    x1, x2, _, _ = _normalised(p1_px, p2_px)
    if not (x1.any() or x2.any()):
        return 1.0
    F = _reweighted(x1, x2, _NOT_YET)
    squares, squared_norms = sampson(F, x1, x2)
    scale = TO_DEVIATION * np.sqrt(np.median(squares)) + 1e-15
    weights = 1.0 / (squared_norms * (1.0 + squares / (CAUCHY * scale) ** 2))
    values = np.linalg.eigvalsh(_moments(x1, x2, weights))
    rounding = 9.0 * np.finfo(np.float64).eps * values[-1]  # all that pairs without noise leave
    return float(np.sqrt(max(values[1], rounding) / max(values[0], rounding)))


def magsac_fundamental(p1_px: Matrix, p2_px: Matrix, K1: Matrix, K2: Matrix) -> Matrix:
    """F of the essential matrix that OpenCV's MAGSAC++ finds, with the help of the intrinsics.

    Parameters
    ----------
    p1_px, p2_px
        Pairs, shape (N, 2) [px], N >= 8.
    K1, K2
        Intrinsics, shape (3, 3) [px].

    Returns
    -------
    NDArray[np.float64]
        F, shape (3, 3), rank 2; NaN when MAGSAC++ finds no model.
    """
    focal_px = np.sqrt(K1[0, 0] * K2[0, 0])
    x1, x2 = (cv2.undistortPoints(p[:, None], K, None)[:, 0] for p, K in ((p1_px, K1), (p2_px, K2)))
    E, _ = cv2.findEssentialMat(
        x1, x2, np.eye(3), cv2.USAC_MAGSAC, 0.999, _MAGSAC_THRESHOLD_PX / focal_px
    )
    if E is None or E.shape != (3, 3):
        return np.full((3, 3), np.nan)
    return fundamental_from_essential(E.astype(np.float64), K1, K2)


@lru_cache(maxsize=4)
def _uniform(trials: int, seed: int) -> Matrix:
    """Numbers (trials, 8) in [0, 1), drawn once for all candidates of a search; read only."""
    numbers = np.random.default_rng(seed).random((trials, 8))
    numbers.flags.writeable = False
    return numbers


@numba.njit(cache=True)
def _normalised(p1_px: Matrix, p2_px: Matrix) -> tuple[Matrix, Matrix, Matrix, Matrix]:
    """Both images' points (2, N), centred and scaled, and the transforms (3, 3) that do so.

    Hartley's normalisation, but with one scale for both images, which keeps Sampson distances
    proportional to those in pixels.
    """
    n = len(p1_px)
    x1, x2, T1, T2 = np.empty((2, n)), np.empty((2, n)), np.eye(3), np.eye(3)
    square = 0.0
    for p, x, T in ((p1_px, x1, T1), (p2_px, x2, T2)):
        for axis in range(2):
            centre = np.mean(p[:, axis])
            T[axis, 2] = -centre
            for i in range(n):
                x[axis, i] = p[i, axis] - centre
                square += x[axis, i] ** 2
    scale = np.sqrt(4 * n / square) if square > 0.0 else 1.0
    T1[:2] *= scale
    T2[:2] *= scale
    return scale * x1, scale * x2, T1, T2


@numba.njit(cache=True, error_model="numpy")
def _reweighted(x1: Matrix, x2: Matrix, F: Matrix, iterations: int = _POLISH_ITERATIONS) -> Matrix:
    """Iterate the weighted eight-point fit with Sampson and Cauchy weights, starting from F.

    An F of zeros stands for the fit that weighs all pairs alike.
    """
    if not F.any():
        F = _eight_point(x1, x2, np.ones(x1.shape[1]))
    for _ in range(iterations):
        squares, squared_norms = sampson(F, x1, x2)
        scale = TO_DEVIATION * np.sqrt(np.median(squares)) + 1e-15
        F = _eight_point(x1, x2, 1.0 / (squared_norms * (1.0 + squares / (CAUCHY * scale) ** 2)))
    return F


@numba.njit(cache=True)
def _eight_point(x1: Matrix, x2: Matrix, weights: Matrix) -> Matrix:
    """F (rank 2) near the least weighted sum of (x2' F x1)^2: the eight-point algorithm."""
    _, vectors = np.linalg.eigh(_moments(x1, x2, weights))
    U, singular, Vt = np.linalg.svd(np.ascontiguousarray(vectors[:, 0]).reshape(3, 3))
    singular[2] = 0.0
    F: Matrix = (U * singular) @ Vt
    return F


@numba.njit(cache=True, fastmath=True)
def _moments(x1: Matrix, x2: Matrix, weights: Matrix) -> Matrix:
    """Weighted sums (9, 9) of the products of two monomials, the lower triangle that eigh reads.

    Such a product is one of two coordinates of x2 times one of two coordinates of x1, the third
    coordinate being 1: six times six sums, each over whole arrays.
    """
    n = len(weights)
    products_1, products_2 = np.empty((6, n)), np.empty((6, n))
    for i in range(n):
        u, v = x1[0, i], x1[1, i]
        products_1[0, i], products_1[1, i], products_1[2, i] = u * u, u * v, v * v
        products_1[3, i], products_1[4, i], products_1[5, i] = u, v, 1.0
        u, v, w = x2[0, i], x2[1, i], weights[i]
        products_2[0, i], products_2[1, i], products_2[2, i] = w * u * u, w * u * v, w * v * v
        products_2[3, i], products_2[4, i], products_2[5, i] = w * u, w * v, w
    moments = np.zeros((9, 9))
    for k in range(6):
        left, (a, b) = products_2[k], _TWO_COORDINATES[k]
        for m in range(6):
            right, (c, d) = products_1[m], _TWO_COORDINATES[m]
            total = 0.0
            for i in range(n):
                total += left[i] * right[i]
            moments[3 * a + c, 3 * b + d] = moments[3 * a + d, 3 * b + c] = total
    return moments
