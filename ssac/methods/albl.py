"""Two tracks in, offset and pose out: the eigenvalue solver of Albl et al. (CVPR 2017).

From "On the two-view geometry of unsynchronized cameras", the strongest method of frame cameras.

With p2(t + t_d + b) linearised in the time shift b, the epipolar constraint of a pair is
(p2 + b v2)' F p1 = 0, linear in F for a given b. Nine pairs give a generalised eigenvalue problem
for b and F, which is solved inside RANSAC. The linearisation holds for small shifts only, so the
solution is iterated: v2 is the secant over a time step that grows while the shift found does not
gain inliers, and starts small again when it does.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import cast

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from ssac.estimate import Estimate, Status
from ssac.geometry.epipolar import sampson_distance
from ssac.geometry.fundamental import MIN_PAIRS, reweighted_fundamental
from ssac.methods.algorithms import with_fit, with_pose
from ssac.methods.method import method
from ssac.search.offset_search import candidate_offsets
from ssac.search.two_views import Pairs, TwoViews
from ssac.track.motion import Track

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


STEPS_S = (0.02, 0.04, 0.08, 0.16, 0.32, 0.64)
"""Time steps of the secants; Albl et al. use 1, 2, 4, ... frames."""

MIN_INLIER_SHARE = 0.75
"""With fewer inliers among the pairs, the iteration has stopped at a local optimum.

Deviation: Albl et al. do not say when to distrust the result. In flights of 10 and 20 s the share
is above 0.95 at the true offset and below 0.55 where the iteration gets stuck.
"""

START_STEP_S = 0.12
"""Between the offsets from which the solver may start, the odd multiples of half of it.

Of ten flights of 10 s and ten of 20 s, one linearisation within 0.06 s of the true offset makes
inliers of 95 % of the pairs or more, elsewhere of 72 % at most.
"""

_START_SECANT_S = 0.06  # as far as the nearest start may be from the true offset
_START_TRIALS = 20  # of RANSAC at each
_TRIALS = 300  # at each offset on the way from there
_INLIER_PX = 2.0  # Sampson distance
_MAX_ROUNDS = 20
_LAST_ROUNDS = 2


@dataclass(frozen=True)
class _Linearised:
    """Pairs at one offset with the secant velocity of p2, centred and scaled to order 1."""

    x1: Array  # (2, n)
    x2: Array  # (2, n)
    v2: Array  # (2, n) [1/s]
    px_per_unit: float

    def __len__(self) -> int:
        return self.x1.shape[1]

    @cached_property
    def constraints(self) -> tuple[Array, Array]:
        """A and B (n, 9) with (A + b B) f = 0 for f = F row by row."""
        A, B = constraints(self.x1, self.x2, self.v2)
        return A, B


@dataclass(frozen=True)
class _Secants:
    """Where p2 is some time after the times of pairs."""

    ahead: Track  # (M, N)
    step_s: float  # negative: before them


@dataclass(frozen=True)
class _Solution:
    shift_s: float  # b, to be added to t_d
    inlier_share: float  # of all pairs, 0 to 1


@dataclass(frozen=True)
class _Agreement:
    """The solution of nine pairs with which most pairs agree."""

    pairs: _Linearised
    shift_s: float
    inliers: NDArray[np.bool_]  # (n,) of the pairs

    @property
    def inlier_share(self) -> float:
        return float(np.mean(self.inliers))


@method("albl", "eigenvalue solver of Albl et al. (2017)", place=7)
def albl_of_views(views: TwoViews) -> Estimate:
    """Time offset and relative pose by the iterated eigenvalue solver of Albl et al. (2017).

    The iteration may stop at a local optimum.

    Deviation from Albl et al.: they start from a rough offset, which nobody has here. The
    iteration starts where a first RANSAC finds most inliers, of offsets all over the search
    interval that do not depend on where this lies. Their image tracks are sampled per frame, ours
    at any time, so the shift is not rounded to frames; RANSAC's solution is polished by a search in
    b for the least singular value of the same equations over all its inliers; and two more rounds
    of that follow at the end, whether they gain inliers or not, as all pairs may be inliers some
    milliseconds off.
    """
    usable_s = candidate_offsets(views)
    if len(usable_s) == 0:
        low, high = views.config.offsets_s
        reason = f"the events have no common time at any offset between {low:g} and {high:g} s"
        return Estimate("albl", Status.NO_COMMON_TIME, reason)
    low, high = float(usable_s[0]), float(usable_s[-1])
    t_d_s = _start(views, start_offsets(low, high))
    rng = np.random.default_rng(views.config.seed)
    best_share = 0.0
    level, pairs = 0, views.pairs(np.array([t_d_s]))
    for _ in range(_MAX_ROUNDS):
        if level == len(STEPS_S):
            break
        found = _best_shift(views, pairs, STEPS_S[level], rng, best_share)
        if found.inlier_share > best_share and low <= t_d_s + found.shift_s <= high:
            t_d_s, best_share, level = t_d_s + found.shift_s, found.inlier_share, 0
            pairs = views.pairs(np.array([t_d_s]))
        else:
            level += 1
    for _ in range(_LAST_ROUNDS):
        last = _best_shift(views, pairs, STEPS_S[0], rng)
        if abs(last.shift_s) < STEPS_S[0]:
            t_d_s += last.shift_s
            pairs = views.pairs(np.array([t_d_s]))
    p1, p2 = pairs.valid_positions(0)
    if len(p1) < MIN_PAIRS:
        reason = f"{len(p1)} valid pairs at t_d = {t_d_s:.3f} s, {MIN_PAIRS} are needed"
        return Estimate("albl", Status.TOO_FEW_SAMPLES, reason)
    F = reweighted_fundamental(p1, p2)
    # Once more without the linearisation, which favours large shifts: a secant bends to many F.
    share = min(best_share, float(np.mean(np.abs(sampson_distance(F, p1, p2)) < _INLIER_PX)))
    if share < MIN_INLIER_SHARE:
        reason = (
            f"only {100 * share:.0f} % of the pairs agree on t_d = {t_d_s:.3f} s, so that it is a"
            " local optimum: search a shorter interval around the true offset"
        )
        return Estimate("albl", Status.NO_CONVERGENCE, reason)
    return with_pose(with_fit(Estimate("albl", t_d_s=t_d_s), F, p1, p2), F, views.rig, p1, p2)


def start_offsets(low_s: float, high_s: float) -> Array:
    """Offsets [s] to start from: odd multiples of START_STEP_S / 2 between two bounds, and these.

    They are fixed to the clocks and not to the bounds, lest an interval that somebody put around
    the offset tell where it is.
    """
    first, last = (round(bound_s / START_STEP_S) for bound_s in (low_s, high_s))
    grid_s = START_STEP_S * (np.arange(first - 1, last + 2) + 0.5)
    return np.unique(np.clip(grid_s, low_s, high_s))


def _start(views: TwoViews, starts_s: Array) -> float:
    """Choose the start [s] from which one linearisation makes inliers of most pairs.

    The same random numbers for each, so that none depends on which others there are.
    """
    best_s, best_share = float(starts_s[0]), 0.0
    pairs = views.pairs(starts_s)
    both = _secants(views, pairs, _START_SECANT_S)
    for m, start_s in enumerate(starts_s.tolist()):
        rng = np.random.default_rng(views.config.seed)
        found = _most_agreed(pairs, both, m, rng, best_share, _START_TRIALS)
        if found is not None:
            best_s, best_share = start_s, found.inlier_share
        if best_share == 1.0:  # none is better
            break
    return best_s


def _best_shift(
    views: TwoViews,
    pairs: Pairs,
    step_s: float,
    rng: np.random.Generator,
    share_to_exceed: float = 0.0,
) -> _Solution:
    """Find the shift of one offset with most inliers, with the secants ahead and those back."""
    both = _secants(views, pairs, step_s)
    found = _most_agreed(pairs, both, 0, rng, share_to_exceed, _TRIALS)
    if found is None:
        return _Solution(0.0, 0.0)
    return _Solution(_polished(found, step_s), found.inlier_share)


def _secants(views: TwoViews, pairs: Pairs, step_s: float) -> list[_Secants]:
    """Look where p2 is a step after its times, and a step before them."""
    clock_s = views.on_clock_2(pairs.times_s, pairs.t_d_s[:, None])
    return [_Secants(views.motion2.at(clock_s + by_s), by_s) for by_s in (step_s, -step_s)]


def _most_agreed(
    pairs: Pairs,
    both: list[_Secants],
    m: int,
    rng: np.random.Generator,
    share_to_exceed: float,
    trials: int,
) -> _Agreement | None:
    """Find what more than a share of the pairs of offset m agree with, by either of the secants.

    Nothing exceeds a share of 1, so there the solver is not run; what it would have drawn is passed
    over, so that no other draw depends on it.
    """
    best: _Agreement | None = None
    best_share = share_to_exceed
    for secants in both:
        linearised = _linearised(pairs, secants, m)
        n = len(linearised)
        if n < MIN_PAIRS:
            continue
        if best_share < 1.0:
            step_s, numbers = abs(secants.step_s), rng.random((trials, n))
            found = _ransac(linearised, step_s, numbers, best_share)
            if found is not None and found.inlier_share > best_share:
                best, best_share = found, found.inlier_share
        else:
            cast(np.random.PCG64, rng.bit_generator).advance(trials * n)
    return best


def _linearised(pairs: Pairs, secants: _Secants, m: int) -> _Linearised:
    """Pairs of offset m, with the mean velocity of p2 from t + t_d to t + t_d + step."""
    valid, ahead_px = pairs.valid[m] & secants.ahead.valid[m], secants.ahead.positions_px[m]
    points, squares = centred(pairs.p1_px[m], pairs.p2_px[m], ahead_px, valid, secants.step_s)
    unit_px = float(np.sqrt(np.mean(squares))) if points.shape[2] >= MIN_PAIRS else 1.0
    x1, x2, v2 = points / unit_px
    return _Linearised(x1, x2, v2, unit_px)


def _ransac(
    pairs: _Linearised, step_s: float, numbers: Array, share_to_exceed: float
) -> _Agreement | None:
    """Find the shift with most inliers over random subsets of nine pairs; None if these are few.

    One subset per row of `numbers` (T, n), which are random. Of each, a quick solution tells
    whether the exact one can matter.
    """
    n, (A, B) = len(pairs), pairs.constraints
    x1, x2, v2 = pairs.x1, pairs.x2, pairs.v2
    limit, longest_s = (_INLIER_PX / pairs.px_per_unit) ** 2, 2.0 * step_s
    shift_s, F, least = 0.0, np.zeros((3, 3)), int(share_to_exceed * n) - 1
    subsets, trial, most = nine_least(numbers), -1, max(least, 0)
    while most < n:
        trial, X = next_better(A, B, subsets, trial + 1, longest_s, x1, x2, v2, limit, most)
        if trial == len(subsets):
            break
        shifts_s, Fs = solve_nine(X)
        plausible = np.abs(shifts_s) <= longest_s
        shifts_s, Fs = shifts_s[plausible], Fs[plausible]
        index, count = most_inliers(shifts_s, Fs, x1, x2, v2, limit, most)
        if count > most:
            shift_s, F, most = float(shifts_s[index]), Fs[index], count
    if most <= max(least, 0):
        return None
    return _Agreement(pairs, shift_s, inliers_of(shift_s, F, x1, x2, v2, limit))


def _polished(found: _Agreement, step_s: float) -> float:
    """Shift [s] near the one found at which all its inliers agree best."""
    A, B = (of_all[found.inliers] for of_all in found.pairs.constraints)
    moments = A.T @ A, A.T @ B + B.T @ A, B.T @ B
    polished = minimize_scalar(
        lambda b: np.linalg.eigvalsh(moments[0] + b * moments[1] + b**2 * moments[2])[0],
        args=(),
        bounds=(found.shift_s - step_s, found.shift_s + step_s),
        method="bounded",
    )
    return float(polished.x)
