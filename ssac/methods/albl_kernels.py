"""The loops of Albl et al.'s RANSAC, compiled: random numbers and constraints in, inliers out."""

import numba
import numpy as np
from numpy.typing import NDArray

from ssac.methods.albl_eigen import eigenvector, real_eigenvalues

Array = NDArray[np.float64]

_LEAST_PIVOT = 1e-12  # on coordinates of order 1
_WIDER = 1.0 + 1e-6  # the bounds of what may count, as a share: more than rounding makes of them
_BLOCK = 64  # pairs counted between two looks at the count: enough for vector instructions
_AT_ONCE = 32  # random numbers, of which none may be among the least


@numba.njit(cache=True)
def nine_least(numbers: Array) -> NDArray[np.intp]:
    """Find the nine least of each row of random numbers (T, n): indices (T, 9), nine at random."""
    subsets = np.empty((len(numbers), 9), np.intp)
    least = np.empty(9)
    for trial in range(len(numbers)):
        row, subset = numbers[trial], subsets[trial]
        least[:] = np.inf
        for first in range(0, len(row), _AT_ONCE):
            some, limit = row[first : first + _AT_ONCE], least[8]
            n_less = 0
            for i in range(len(some)):
                n_less += some[i] < limit
            if n_less == 0:
                continue
            for i in range(len(some)):
                if some[i] >= least[8]:
                    continue
                place = 8
                while place > 0 and least[place - 1] > some[i]:
                    least[place], subset[place] = least[place - 1], subset[place - 1]
                    place -= 1
                least[place], subset[place] = some[i], first + i
    return subsets


@numba.njit(cache=True)
def centred(
    p1_px: Array, p2_px: Array, ahead_px: Array, valid: NDArray[np.bool_], step_s: float
) -> tuple[Array, Array]:
    """Take the valid ones of pairs (N, 2), and the secants from p2 to where it is ahead.

    Returns
    -------
    tuple of NDArray[np.float64]
        Points and secants (3, 2, n): x1 and x2 about their means [px], v2 [px/s]; and the squares
        (2, n, 2) of x1 and x2.
    """
    n = np.count_nonzero(valid)
    found, squares = np.empty((3, 2, n)), np.empty((2, n, 2))
    for axis in range(2):
        x1, x2, v2 = found[0, axis], found[1, axis], found[2, axis]
        sum_1, sum_2, k = 0.0, 0.0, 0
        for i in range(len(valid)):
            if valid[i]:
                x1[k], x2[k] = p1_px[i, axis], p2_px[i, axis]
                v2[k] = (ahead_px[i, axis] - p2_px[i, axis]) / step_s
                sum_1, sum_2, k = sum_1 + x1[k], sum_2 + x2[k], k + 1
        for k in range(n):
            x1[k], x2[k] = x1[k] - sum_1 / n, x2[k] - sum_2 / n
            squares[0, k, axis], squares[1, k, axis] = x1[k] * x1[k], x2[k] * x2[k]
    return found, squares


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

    The points and velocities have the shape (2, n). Without a branch and by rows, so that it
    compiles to vector instructions: eight times as fast as by two indices.
    """
    f = _entries(F)
    u1, v1 = x1[0, first:last], x1[1, first:last]
    u2, w2 = x2[0, first:last], x2[1, first:last]
    du2, dw2 = v2[0, first:last], v2[1, first:last]
    count = 0
    for i in range(len(u1)):
        square, norm = _sampson_terms(f, u1[i], v1[i], u2[i] + b * du2[i], w2[i] + b * dw2[i])
        count += square < limit * norm
    return count


@numba.njit(cache=True, fastmath=True)
def inliers_of(
    b: float, F: Array, x1: Array, x2: Array, v2: Array, limit: float
) -> NDArray[np.bool_]:
    """Tell which of the pairs `_count` counts, (n,)."""
    f = _entries(F)
    inliers = np.empty(x1.shape[1], np.bool_)
    for i in range(len(inliers)):
        u2, w2 = x2[0, i] + b * v2[0, i], x2[1, i] + b * v2[1, i]
        square, norm = _sampson_terms(f, x1[0, i], x1[1, i], u2, w2)
        inliers[i] = square < limit * norm
    return inliers


@numba.njit(cache=True, fastmath=True)
def _entries(F: Array) -> tuple[float, ...]:
    """Put the entries of F (3, 3) in a tuple, row by row."""
    return (
        *(F[0, 0], F[0, 1], F[0, 2]),
        *(F[1, 0], F[1, 1], F[1, 2]),
        *(F[2, 0], F[2, 1], F[2, 2]),
    )


@numba.njit(cache=True, fastmath=True)
def _sampson_terms(
    f: tuple[float, ...], u1: float, v1: float, u2: float, w2: float
) -> tuple[float, float]:
    """(p2' F p1)^2 and its squared gradient norm, for the points (u1, v1) and (u2, w2)."""
    a2 = f[0] * u1 + f[1] * v1 + f[2]
    b2 = f[3] * u1 + f[4] * v1 + f[5]
    c2 = f[6] * u1 + f[7] * v1 + f[8]
    a1 = f[0] * u2 + f[3] * w2 + f[6]
    b1 = f[1] * u2 + f[4] * w2 + f[7]
    product = u2 * a2 + w2 * b2 + c2
    return product * product, a1 * a1 + b1 * b1 + a2 * a2 + b2 * b2
