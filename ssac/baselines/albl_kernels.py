"""The loops of Albl et al.'s RANSAC, compiled: random numbers and constraints in, inliers out."""

import numba
import numpy as np
from numpy.typing import NDArray

from ssac.baselines.albl_eigen import eigenvector, real_eigenvalues

Array = NDArray[np.float64]

_LEAST_PIVOT = 1e-12  # on coordinates of order 1
_WIDER = 1.0 + 1e-6  # the bounds of what may count, as a share: more than rounding makes of them
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
def constraints(x1: Array, x2: Array, v2: Array) -> tuple[Array, Array]:
    """Build A and B (n, 9) with (A + b B) f = 0 for f = F row by row, of points (2, n) each."""
    A, B = np.empty((x1.shape[1], 9)), np.zeros((x1.shape[1], 9))
    for i in range(len(A)):
        for row in range(3):
            left = x2[row, i] if row < 2 else 1.0
            for column in range(3):
                right = x1[column, i] if column < 2 else 1.0
                A[i, 3 * row + column] = left * right
                if row < 2:
                    B[i, 3 * row + column] = v2[row, i] * right
    return A, B


@numba.njit(cache=True)
def quotient(A: Array, B: Array, subset: NDArray[np.intp], X: Array) -> None:
    """Fill in A^-1 B of the rows in a subset, (9, 6), by Gaussian elimination with pivoting.

    At the true offset A is singular but for noise. A pivot of zero is then taken as the least
    number that can be divided by: the shift b comes out as zero.
    """
    rows = np.empty((9, 15))
    for i in range(9):
        rows[i, :9] = A[subset[i]]
        rows[i, 9:] = B[subset[i], :6]
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
                total -= rows[k, i] * X[i, j]
            X[k, j] = total / rows[k, k]


@numba.njit(cache=True)
def next_better(
    A: Array,
    B: Array,
    subsets: NDArray[np.intp],
    first: int,
    longest_s: float,
    x1: Array,
    x2: Array,
    v2: Array,
    limit: float,
    most: int,
) -> tuple[int, Array]:
    """Find the first subset, of (T, 9) and from `first` on, that may have a better solution.

    Parameters
    ----------
    A, B
        As of `constraints`.
    longest_s
        Of the shifts that count.
    x1, x2, v2, limit
        As for `_count`.
    most
        Inliers to exceed.

    Returns
    -------
    tuple
        Its place, T when there is none, and its `quotient` (9, 6). With the limit and the longest
        shift a little too wide, since its solutions are only good to rounding.
    """
    X, H, found = np.empty((9, 6)), np.empty((6, 6)), np.empty(6)
    head, F = np.empty(6), np.empty((3, 3))
    for trial in range(first, len(subsets)):
        quotient(A, B, subsets[trial], X)
        H[:] = -X[:6]
        n_found = real_eigenvalues(H, found)
        for k in range(n_found):
            if abs(found[k]) * longest_s * _WIDER < 1.0:
                continue
            H[:] = -X[:6]
            eigenvector(H, found[k], head)
            for i in range(6):
                F[i // 3, i % 3] = head[i]
            for i in range(3):
                total = 0.0
                for j in range(6):
                    total += X[6 + i, j] * head[j]
                F[2, i] = -total / found[k]
            if _exceeds(1.0 / found[k], F, x1, x2, v2, _WIDER * limit, most) > most:
                return trial, X
    return len(subsets), X


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
    best = -1
    for s in range(len(shifts_s)):
        count = _exceeds(shifts_s[s], F[s], x1, x2, v2, limit, most)
        if count > most:
            best, most = s, count
    return best, most


@numba.njit(cache=True)
def _exceeds(b: float, F: Array, x1: Array, x2: Array, v2: Array, limit: float, most: int) -> int:
    """Inliers of a solution if they are more than `most`; else that number, or fewer."""
    n = x1.shape[1]
    count = 0
    for first in range(0, n, _BLOCK):
        last = min(first + _BLOCK, n)
        count += _count(b, F, x1, x2, v2, limit, first, last)
        if count + n - last <= most:
            return most
    return count


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
