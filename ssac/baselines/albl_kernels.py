"""The loops of Albl et al.'s RANSAC, compiled: random numbers and constraints in, inliers out."""

import numba
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_LEAST_PIVOT = 1e-12  # on coordinates of order 1
_BLOCK = 64  # pairs counted between two looks at the count: enough for vector instructions


@numba.njit(cache=True)
def nine_least(numbers: Array) -> NDArray[np.intp]:
    """Find the nine least of each row of random numbers (T, n): indices (T, 9), nine at random."""
    subsets = np.empty((len(numbers), 9), np.intp)
    for trial in range(len(numbers)):
        row, subset = numbers[trial], subsets[trial]
        n_kept = 0
        for i in range(len(row)):
            if n_kept == 9 and row[i] >= row[subset[8]]:
                continue
            place = min(n_kept, 8)
            while place > 0 and row[subset[place - 1]] > row[i]:
                subset[place] = subset[place - 1]
                place -= 1
            subset[place] = i
            n_kept = min(n_kept + 1, 9)
    return subsets


@numba.njit(cache=True)
def quotients(A: Array, B: Array, subsets: NDArray[np.intp]) -> Array:
    """A^-1 B of the rows in each subset, (T, 9, 6), by Gaussian elimination with pivoting.

    At the true offset A is singular but for noise. A pivot of zero is then taken as the least
    number that can be divided by: the shift b comes out as zero.
    """
    X = np.empty((len(subsets), 9, 6))
    rows = np.empty((9, 15))
    for trial in range(len(subsets)):
        for i in range(9):
            rows[i, :9] = A[subsets[trial, i]]
            rows[i, 9:] = B[subsets[trial, i], :6]
        for k in range(9):
            pivot = k
            for i in range(k + 1, 9):
                if abs(rows[i, k]) > abs(rows[pivot, k]):
                    pivot = i
            for j in range(k, 15):
                rows[k, j], rows[pivot, j] = rows[pivot, j], rows[k, j]
            if abs(rows[k, k]) < _LEAST_PIVOT:
                rows[k, k] = _LEAST_PIVOT
            for i in range(k + 1, 9):
                ratio = rows[i, k] / rows[k, k]
                for j in range(k + 1, 15):
                    rows[i, j] -= ratio * rows[k, j]
        for k in range(8, -1, -1):
            for j in range(6):
                total = rows[k, 9 + j]
                for i in range(k + 1, 9):
                    total -= rows[k, i] * X[trial, i, j]
                X[trial, k, j] = total / rows[k, k]
    return X


@numba.njit(cache=True)
def most_inliers(
    shifts_s: Array, F: Array, x1: Array, x2: Array, v2: Array, limit: float, most: int
) -> tuple[int, int]:
    """Find the first solution with the most inliers: its index and their number.

    Parameters
    ----------
    shifts_s, F
        Solutions, shapes (S,) and (S, 3, 3).
    x1, x2, v2, limit
        As for `_count`.
    most
        Inliers to exceed; the index is -1, and the number this one, when no solution does.
    """
    n = x1.shape[1]
    best = -1
    for s in range(len(shifts_s)):
        count = 0
        for first in range(0, n, _BLOCK):
            last = min(first + _BLOCK, n)
            count += _count(shifts_s[s], F[s], x1, x2, v2, limit, first, last)
            if count + n - last <= most:
                break
        else:
            best, most = s, count
    return best, most


@numba.njit(cache=True, fastmath=True)
def _count(
    b: float, F: Array, x1: Array, x2: Array, v2: Array, limit: float, first: int, last: int
) -> int:
    """Pairs from `first` up to `last` whose squared Sampson distance is below the limit.

    The points and velocities have the shape (2, n). Without a branch, so that it compiles to vector
    instructions.
    """
    count = 0
    for i in range(first, last):
        square, norm = _sampson_terms(b, F, x1, x2, v2, i)
        count += square < limit * norm
    return count


@numba.njit(cache=True, fastmath=True)
def inliers_of(
    b: float, F: Array, x1: Array, x2: Array, v2: Array, limit: float
) -> NDArray[np.bool_]:
    """Tell which of the pairs `_count` counts, (n,)."""
    inliers = np.empty(x1.shape[1], np.bool_)
    for i in range(len(inliers)):
        square, norm = _sampson_terms(b, F, x1, x2, v2, i)
        inliers[i] = square < limit * norm
    return inliers


@numba.njit(cache=True, fastmath=True)
def _sampson_terms(
    b: float, F: Array, x1: Array, x2: Array, v2: Array, i: int
) -> tuple[float, float]:
    """(p2' F p1)^2 and its squared gradient norm for pair i, p2 being shifted by b."""
    u1, v1 = x1[0, i], x1[1, i]
    u2, w2 = x2[0, i] + b * v2[0, i], x2[1, i] + b * v2[1, i]
    a2 = F[0, 0] * u1 + F[0, 1] * v1 + F[0, 2]
    b2 = F[1, 0] * u1 + F[1, 1] * v1 + F[1, 2]
    c2 = F[2, 0] * u1 + F[2, 1] * v1 + F[2, 2]
    a1 = F[0, 0] * u2 + F[1, 0] * w2 + F[2, 0]
    b1 = F[0, 1] * u2 + F[1, 1] * w2 + F[2, 1]
    product = u2 * a2 + w2 * b2 + c2
    return product * product, a1 * a1 + b1 * b1 + a2 * a2 + b2 * b2
