"""A small matrix in, its real eigenvalues and their eigenvectors out.

What is compiled here is good to rounding but not to the last bit of LAPACK, which takes five times
as long: it fills all of a decomposition of which a RANSAC over minimal subsets has little use. By
Golub and Van Loan, Matrix Computations: elimination to Hessenberg form, then Francis's double
shifts (7.4 and 7.5).
"""

import numba
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_EPS = float(np.finfo(np.float64).eps)
_MAX_SWEEPS = 60  # for one eigenvalue or two
_UNUSUAL = 10  # sweeps after which the shifts are others, lest they go round in a circle
_ROUNDING = 1e3 * _EPS  # what a matrix's entries may be off by, as a share of its size


def solve_nine(X: Array) -> tuple[Array, Array]:
    """All real solutions of (A + b B) f = 0 for nine pairs, from X (9, 6) = A^-1 B.

    B has no entries in f's last three columns: with X of the first six, f = -b X f[:6]. Its first
    six rows are an eigenvalue problem with six shifts b, the others give the rest of f.

    Returns
    -------
    tuple of NDArray[np.float64]
        Shifts b (s,) [s] and their F (s, 3, 3).
    """
    inverse_shifts, heads = np.linalg.eig(-X[:6])
    real = (np.abs(inverse_shifts.imag) < 1e-9) & (inverse_shifts.real != 0.0)
    shifts_s = 1.0 / inverse_shifts.real[real]
    heads = np.ascontiguousarray(heads.real[:, real].T)
    tails = -shifts_s[:, None] * np.einsum("ij,sj->si", X[6:], heads)
    return shifts_s, np.concatenate([heads, tails], axis=1).reshape(-1, 3, 3)


@numba.njit(cache=True)
def real_eigenvalues(H: Array, found: Array) -> int:
    """Fill in the real eigenvalues of a matrix (n, n), n >= 3, which is used up; their number.

    Two that rounding may have made complex count as real.
    """
    _to_hessenberg(H)
    size = np.sum(np.abs(H))
    n_found, last = 0, len(H) - 1
    sweep = 0
    while last >= 0:
        first = last
        while first > 0:
            beside = abs(H[first - 1, first - 1]) + abs(H[first, first])
            if abs(H[first, first - 1]) <= _EPS * (beside if beside > 0.0 else size):
                break
            first -= 1
        if first == last:
            found[n_found] = H[last, last]
            n_found, last, sweep = n_found + 1, last - 1, 0
        elif first == last - 1:
            half = 0.5 * (H[first, first] - H[last, last])
            product = H[first, last] * H[last, first]
            square = half * half + product
            block = abs(half) + abs(H[first, last]) + abs(H[last, first])
            if square > -_ROUNDING * size * block:
                root = half + np.copysign(np.sqrt(max(square, 0.0)), half)
                found[n_found] = H[last, last] + root
                found[n_found + 1] = H[last, last] - (product / root if root != 0.0 else 0.0)
                n_found += 2
            last, sweep = last - 2, 0
        elif sweep == _MAX_SWEEPS:
            break
        else:
            sweep += 1
            _sweep(H, first, last, sweep % _UNUSUAL == 0)
    return n_found


@numba.njit(cache=True)
def _to_hessenberg(H: Array) -> None:
    """Make all below the first subdiagonal zero, by elimination with pivoting."""
    n = len(H)
    for k in range(1, n - 1):
        pivot = k
        for i in range(k + 1, n):
            if abs(H[i, k - 1]) > abs(H[pivot, k - 1]):
                pivot = i
        if pivot != k:
            for j in range(k - 1, n):
                H[k, j], H[pivot, j] = H[pivot, j], H[k, j]
            for i in range(n):
                H[i, k], H[i, pivot] = H[i, pivot], H[i, k]
        if H[k, k - 1] == 0.0:
            continue
        for i in range(k + 1, n):
            ratio = H[i, k - 1] / H[k, k - 1]
            H[i, k - 1] = 0.0
            if ratio != 0.0:
                for j in range(k, n):
                    H[i, j] -= ratio * H[k, j]
                for j in range(n):
                    H[j, k] += ratio * H[j, i]


@numba.njit(cache=True, error_model="numpy")
def _sweep(H: Array, first: int, last: int, unusual: bool) -> None:
    """Make one double QR step on the block from `first` to `last`, of three or more.

    Each mirror is I - u w' with u = (1, u1, u2) and takes (x, y, z) to the first axis; the last one
    has two rows. Without tests of what a division is by, and with few of them: they are what waits.
    """
    total, product = _shifts(H, last, unusual)
    a, b, c = H[first, first], H[first, first + 1], H[first + 1, first]
    d = H[first + 1, first + 1]
    # The first column of H^2 - total H + product, over c.
    x = (a * a - total * a + product) / c + b
    y = a + d - total
    z = H[first + 2, first + 1]
    for k in range(first, last - 1):
        if k > first:
            x, y, z = H[k, k - 1], H[k + 1, k - 1], H[k + 2, k - 1]
        square = x * x + y * y + z * z
        if square == 0.0:
            continue
        length = np.copysign(np.sqrt(square), x)
        if k > first:
            H[k, k - 1], H[k + 1, k - 1], H[k + 2, k - 1] = -length, 0.0, 0.0
        w0, inverse = (x + length) / length, 1.0 / (x + length)
        u1, u2 = y * inverse, z * inverse
        w1, w2 = w0 * u1, w0 * u2
        for j in range(k, last + 1):
            dot = w0 * H[k, j] + w1 * H[k + 1, j] + w2 * H[k + 2, j]
            H[k, j] -= dot
            H[k + 1, j] -= dot * u1
            H[k + 2, j] -= dot * u2
        for i in range(first, min(last, k + 3) + 1):
            dot = w0 * H[i, k] + w1 * H[i, k + 1] + w2 * H[i, k + 2]
            H[i, k] -= dot
            H[i, k + 1] -= dot * u1
            H[i, k + 2] -= dot * u2
    k = last - 1
    x, y = H[k, k - 1], H[k + 1, k - 1]
    square = x * x + y * y
    if square == 0.0:
        return
    length = np.copysign(np.sqrt(square), x)
    H[k, k - 1], H[k + 1, k - 1] = -length, 0.0
    w0, u1 = (x + length) / length, y / (x + length)
    w1 = w0 * u1
    for j in range(k, last + 1):
        dot = w0 * H[k, j] + w1 * H[k + 1, j]
        H[k, j] -= dot
        H[k + 1, j] -= dot * u1
    for i in range(first, last + 1):
        dot = w0 * H[i, k] + w1 * H[i, k + 1]
        H[i, k] -= dot
        H[i, k + 1] -= dot * u1


@numba.njit(cache=True)
def _shifts(H: Array, last: int, unusual: bool) -> tuple[float, float]:
    """Sum and product of the two shifts: the eigenvalues of the last 2 x 2, as a rule."""
    if unusual:
        size = abs(H[last, last - 1]) + abs(H[last - 1, last - 2])
        return 1.5 * size, size * size
    a, d = H[last - 1, last - 1], H[last, last]
    return a + d, a * d - H[last, last - 1] * H[last - 1, last]


@numba.njit(cache=True)
def eigenvector(M: Array, eigenvalue: float, vector: Array) -> None:
    """Fill in the eigenvector (n,) of an eigenvalue of a matrix (n, n), which is used up.

    By elimination with complete pivoting, which leaves the zero for the last column.
    """
    n = len(M)
    order = np.arange(n)  # of the columns
    for i in range(n):
        M[i, i] -= eigenvalue
    for k in range(n - 1):
        row, column = k, k
        for i in range(k, n):
            for j in range(k, n):
                if abs(M[i, j]) > abs(M[row, column]):
                    row, column = i, j
        if M[row, column] == 0.0:  # all that is left: then any vector will do
            break
        for j in range(n):
            M[k, j], M[row, j] = M[row, j], M[k, j]
        for i in range(n):
            M[i, k], M[i, column] = M[i, column], M[i, k]
        order[k], order[column] = order[column], order[k]
        for i in range(k + 1, n):
            ratio = M[i, k] / M[k, k]
            for j in range(k + 1, n):
                M[i, j] -= ratio * M[k, j]
    vector[order[n - 1]] = 1.0
    for k in range(n - 2, -1, -1):
        total = M[k, n - 1]
        for j in range(k + 1, n - 1):
            total += M[k, j] * vector[order[j]]
        vector[order[k]] = -total / M[k, k] if M[k, k] != 0.0 else 0.0
