"""The fundamental matrix of point pairs with outliers: the paper's LMedS and two alternatives.

Deviation: the paper names LMedS only, and its sample uses OpenCV's. OpenCV's stops at about 450
trials (at confidence 0.999), whatever number it is asked for, and returns the seven-point solution
of its best trial, which makes d_avg a jagged curve. Here all trials are made, each with eight
pairs, whose solution is linear, and the best one starts the reweighted least squares with which
Rousseeuw's LMedS ends.
"""

from collections.abc import Callable
from functools import lru_cache

import cv2
import numba
import numpy as np

from ssac.arrays import Array, IntArray
from ssac.geometry.epipolar import CAUCHY, TO_DEVIATION, epipolar_terms, fundamental_from_essential

_BLOCK = 64  # pairs counted between two tests of the count: enough for vector instructions


@numba.njit(cache=True)
def best_subset(x1: Array, x2: Array, uniform: Array) -> Array:
    """F (rank 3) of the subset of eight pairs with the least median squared Sampson distance.

    Each row of `uniform` (trials, 8), in [0, 1), draws a subset without repetition, after Floyd.
    """
    n = x1.shape[1]
    middle = n // 2
    blocks = in_blocks(x1, x2)
    subset, system = np.empty(8, np.int64), np.empty((8, 9))
    F, best_F = np.empty((3, 3)), np.zeros((3, 3))
    best_median = np.inf
    for numbers in uniform:
        _draw(numbers, n, subset)
        for row in range(8):
            _monomials(x1, x2, subset[row], system[row])
        # A count tells whether the median would be a new best; few trials need the median itself.
        if (
            _solve_null_vector(system, F)
            and count_near(best_median, F.ravel(), n, blocks, middle) > middle
        ):
            squares, _ = sampson(F, x1, x2)
            best_median = np.sort(squares)[middle]
            best_F[:] = F
    return best_F


@numba.njit(cache=True)
def _draw(uniform: Array, n: int, subset: IntArray) -> None:
    """Fill `subset` with eight different indices below n, from eight random numbers."""
    for row in range(8):
        last = n - 8 + row
        drawn = int(uniform[row] * (last + 1))
        for other in range(row):  # a loop, since an array of comparisons costs an allocation
            if subset[other] == drawn:
                drawn = last
                break
        subset[row] = drawn


@numba.njit(cache=True)
def in_blocks(x1: Array, x2: Array) -> Array:
    """Copy the pairs' coordinates into blocks (b, 4, _BLOCK), the last one padded with zeros."""
    n = x1.shape[1]
    blocks = np.zeros((-(-n // _BLOCK), 4, _BLOCK))
    for i in range(n):
        block, place = blocks[i // _BLOCK], i % _BLOCK
        block[0, place], block[1, place] = x1[0, i], x1[1, i]
        block[2, place], block[3, place] = x2[0, i], x2[1, i]
    return blocks


@numba.njit(cache=True)
def count_near(limit: float, F: Array, n: int, blocks: Array, most: int) -> int:
    """Count the n pairs of `in_blocks` with a squared Sampson distance below the limit.

    It stops early, at a count of at most `most`, once the pairs left cannot raise it above that.
    """
    f = _entries(F)
    count, left = 0, n
    for b in range(len(blocks)):
        block, size = blocks[b], min(_BLOCK, left)
        count += _count_in_block(limit, f, block[0], block[1], block[2], block[3], size)
        left -= size
        if count + left <= most:
            return count
    return count


@numba.njit(cache=True, fastmath=True)
def _count_in_block(
    limit: float, f: tuple[float, ...], u1: Array, v1: Array, u2: Array, v2: Array, n: int
) -> int:
    """Count those of the first n pairs with a squared distance below the limit."""
    count = 0
    for i in range(n):
        product, norm = _product_and_norm(f, u1[i], v1[i], u2[i], v2[i])
        count += product * product < limit * norm
    return count


@numba.njit(cache=True)
def _monomials(x1: Array, x2: Array, i: int, row: Array) -> None:
    """Fill in the coefficients (9,) of F's entries, row by row, in x2' F x1 of pair i."""
    row[0], row[1], row[2] = x2[0, i] * x1[0, i], x2[0, i] * x1[1, i], x2[0, i]
    row[3], row[4], row[5] = x2[1, i] * x1[0, i], x2[1, i] * x1[1, i], x2[1, i]
    row[6], row[7], row[8] = x1[0, i], x1[1, i], 1.0


@numba.njit(cache=True, error_model="numpy")  # no line at an epipole: NaN, not an exception
def sampson(F: Array, x1: Array, x2: Array) -> tuple[Array, Array]:
    """Squared Sampson distances (N,) and their squared denominators (N,)."""
    n = x1.shape[1]
    squares, squared_norms = np.empty(n), np.empty(n)
    f = _entries(F.ravel())
    for i in range(n):
        product, norm = _product_and_norm(f, x1[0, i], x1[1, i], x2[0, i], x2[1, i])
        squares[i], squared_norms[i] = product * product / norm, norm
    return squares, squared_norms


@numba.njit(cache=True)
def _entries(f: Array) -> tuple[float, ...]:
    """Put nine entries in a tuple, so that loops keep them in registers."""
    return f[0], f[1], f[2], f[3], f[4], f[5], f[6], f[7], f[8]


_terms: Callable[..., tuple[float, float, float, float, float]] = numba.njit(
    cache=True, fastmath=True
)(epipolar_terms)


@numba.njit(cache=True, fastmath=True)
def _product_and_norm(
    f: tuple[float, ...], u1: float, v1: float, u2: float, v2: float
) -> tuple[float, float]:
    """x2' F x1 and its squared gradient norm, for the points (u1, v1) and (u2, v2)."""
    product, a2, b2, a1, b1 = _terms(f, u1, v1, u2, v2)
    return product, a1 * a1 + b1 * b1 + a2 * a2 + b2 * b2


@numba.njit(cache=True, fastmath=True)
def _solve_null_vector(A: Array, F: Array) -> bool:
    """Solve A f = 0 for f = F row by row; False when A (8, 9), overwritten, has a rank below 8."""
    # By Gaussian elimination with the row's largest entry as pivot: columns are exchanged so that
    # the last one, whose unknown is set to 1, is never one that the equations determine to be 0.
    rank_tolerance = 1e-12  # on coordinates of order 1
    order = np.arange(9)
    for k in range(8):
        row, pivot, largest = A[k], k, 0.0
        for j in range(k, 9):
            if abs(row[j]) > largest:
                pivot, largest = j, abs(row[j])
        if largest < rank_tolerance:
            return False
        if pivot != k:
            order[k], order[pivot] = order[pivot], order[k]
            for i in range(8):
                A[i, k], A[i, pivot] = A[i, pivot], A[i, k]
        inverse = 1.0 / row[k]
        for i in range(k + 1, 8):
            other = A[i]  # rows by name: half the time of entries by two indices
            ratio = other[k] * inverse
            for j in range(k + 1, 9):
                other[j] -= ratio * row[j]
    f = np.ones(9)
    for k in range(7, -1, -1):
        row, total = A[k], A[k, 8]
        for j in range(k + 1, 8):
            total += row[j] * f[j]
        f[k] = -total / row[k]
    for k in range(9):
        F[order[k] // 3, order[k] % 3] = f[k]
    return True


_POLISH_ITERATIONS = 8
_NOT_YET = np.zeros((3, 3))  # no F to start from
_TWO_COORDINATES = ((0, 0), (1, 0), (1, 1), (2, 0), (2, 1), (2, 2))  # of (u, v, 1)


def lmeds_fundamental(p1_px: Array, p2_px: Array, trials: int, seed: int = 0) -> Array:
    """F by least median of squares over Sampson distances, then reweighted least squares.

    Each trial draws a random subset of eight of the pairs (N, 2) [px], N >= 8. F has rank 2, and
    is NaN when the pairs do not determine it, as for an object at rest.
    """
    x1, x2, T1, T2 = _normalised(p1_px, p2_px)
    F = best_subset(x1, x2, _uniform(trials, seed))
    if not F.any():
        return np.full((3, 3), np.nan)
    return np.asarray(T2.T @ _reweighted(x1, x2, F) @ T1)


def reweighted_fundamental(p1_px: Array, p2_px: Array) -> Array:
    """F by reweighted least squares from an eight-point start: cheaper, for few outliers."""
    x1, x2, T1, T2 = _normalised(p1_px, p2_px)
    return np.asarray(T2.T @ _reweighted(x1, x2, _NOT_YET) @ T1)


@numba.njit(cache=True, error_model="numpy")
def median_after_fit(p1_px: Array, p2_px: Array, iterations: int) -> float:
    """Median Sampson distance [px] of pairs (n, 2) from F after some reweighted iterations."""
    x1, x2, T1, _ = _normalised(p1_px, p2_px)
    F = _reweighted(x1, x2, np.zeros((3, 3)), iterations)
    squares, _ = sampson(F, x1, x2)
    median_px: float = np.sqrt(np.median(squares)) / T1[0, 0]
    return median_px


def second_best(p1_px: Array, p2_px: Array) -> float:
    """How many times worse than the best F the best matrix orthogonal to it fits the pairs.

    It is the ratio of the two least singular values of the weighted eight-point system. Near 1 the
    pairs do not determine F, as on a planar path; it is 1 when they allow no F, as at rest.
    """
    x1, x2, _, _ = _normalised(p1_px, p2_px)
    F = _reweighted(x1, x2, _NOT_YET)
    if not np.isfinite(F).all():
        return 1.0
    squares, squared_norms = sampson(F, x1, x2)
    scale = TO_DEVIATION * np.sqrt(np.median(squares)) + 1e-15
    weights = 1.0 / (squared_norms * (1.0 + squares / (CAUCHY * scale) ** 2))
    values = np.linalg.eigvalsh(_moments(x1, x2, weights))
    rounding = 9.0 * np.finfo(np.float64).eps * values[-1]  # all that noise-free pairs leave
    return float(np.sqrt(max(values[1], rounding) / max(values[0], rounding)))


def magsac_fundamental(p1_px: Array, p2_px: Array, K1: Array, K2: Array) -> Array:
    """F of the essential matrix that MAGSAC++ finds, given the intrinsics; NaN if it finds none."""
    x1, x2 = (
        np.asarray(cv2.undistortPoints(p_px[:, None], K, None)[:, 0], np.float64)
        for p_px, K in ((p1_px, K1), (p2_px, K2))
    )
    E = magsac_essential(x1, x2, K1, K2)
    return np.full((3, 3), np.nan) if E is None else fundamental_from_essential(E, K1, K2)


def magsac_essential(x1: Array, x2: Array, K1: Array, K2: Array) -> Array | None:
    """E by OpenCV's MAGSAC++ from rays (N, 2), with a threshold of a pixel; None if not found."""
    threshold = 1.0 / float(np.sqrt(K1[0, 0] * K2[0, 0]))
    E, _ = cv2.findEssentialMat(x1, x2, np.eye(3), cv2.USAC_MAGSAC, 0.999, threshold)
    return E.astype(np.float64) if E is not None and E.shape == (3, 3) else None


@lru_cache(maxsize=4)
def _uniform(trials: int, seed: int) -> Array:
    """Numbers (trials, 8) in [0, 1), drawn once for all candidates of a search."""
    return np.random.default_rng(seed).random((trials, 8))


@numba.njit(cache=True)
def _normalised(p1_px: Array, p2_px: Array) -> tuple[Array, Array, Array, Array]:
    """Both images' points (2, N), centred and scaled, and the transforms (3, 3) that do so."""
    # Hartley's normalisation, but with one scale for both images, which keeps Sampson distances
    # proportional to those in pixels.
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
def _reweighted(x1: Array, x2: Array, F: Array, iterations: int = _POLISH_ITERATIONS) -> Array:
    """Iterate the weighted eight-point fit, from F or, if it is 0, without weights; NaN at rest."""
    if not (x1.any() or x2.any()):
        return np.full((3, 3), np.nan)
    if not F.any():
        F = _eight_point(x1, x2, np.ones(x1.shape[1]))
    for _ in range(iterations):
        squares, squared_norms = sampson(F, x1, x2)
        scale = TO_DEVIATION * np.sqrt(np.median(squares)) + 1e-15
        weights = 1.0 / (squared_norms * (1.0 + squares / (CAUCHY * scale) ** 2))
        if not np.isfinite(weights).all():
            return np.full((3, 3), np.nan)
        F = _eight_point(x1, x2, weights)
    return F


@numba.njit(cache=True)
def _eight_point(x1: Array, x2: Array, weights: Array) -> Array:
    """F (rank 2) near the least weighted sum of (x2' F x1)^2: the eight-point algorithm."""
    _, vectors = np.linalg.eigh(_moments(x1, x2, weights))
    U, singular, Vt = np.linalg.svd(np.ascontiguousarray(vectors[:, 0]).reshape(3, 3))
    singular[2] = 0.0
    F: Array = (U * singular) @ Vt
    return F


@numba.njit(cache=True, fastmath=True)
def _moments(x1: Array, x2: Array, weights: Array) -> Array:
    """Weighted sums (9, 9) of the products of two monomials: the lower triangle, for eigh."""
    # Such a product is one of two coordinates of x2 times one of two coordinates of x1, the third
    # coordinate being 1: six times six sums, each over whole arrays.
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
