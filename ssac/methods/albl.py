"""The eigenvalue solver of Albl et al. (CVPR 2017), the strongest method of frame cameras.

From "On the two-view geometry of unsynchronized cameras". With p2(t + t_d + b) linearised in the
time shift b, the epipolar constraint of a pair is (p2 + b v2)' F p1 = 0, linear in F for a given b.
Nine pairs give a generalised eigenvalue problem for b and F, which is solved inside RANSAC. The
linearisation holds for small shifts only, so the solution is iterated: v2 is the secant over a time
step that grows while the shift found does not gain inliers, and starts small again when it does.
"""

from dataclasses import dataclass
from functools import cached_property

import numba
import numpy as np
from scipy.optimize import minimize_scalar

from ssac.arrays import Array, Indices, Mask
from ssac.estimate import Estimate, Status
from ssac.geometry.epipolar import sampson_distance
from ssac.geometry.fundamental import count_near, in_blocks, reweighted_fundamental, sampson
from ssac.methods.algorithms import with_fit, with_pose
from ssac.methods.method import method
from ssac.rules import AlblRules, Rules
from ssac.search.offset_search import candidate_offsets
from ssac.search.two_views import Pairs, TwoViews
from ssac.track.motion import Track


@dataclass(frozen=True)
class _Linearised:
    """Pairs at one offset with the secant velocity of p2, centred and scaled to order 1."""

    x1: Array  # (2, n)
    x2: Array  # (2, n)
    v2: Array  # (2, n) [1/s]
    px_per_unit: float
    step_s: float  # of the secants

    def __len__(self) -> int:
        return self.x1.shape[1]

    @cached_property
    def constraints(self) -> tuple[Array, Array]:
        """A and B (n, 9) with (A + b B) f = 0 for f = F row by row."""
        ones, zeros = np.ones((1, len(self))), np.zeros((1, len(self)))
        x1 = np.vstack([self.x1, ones])
        A = np.vstack([self.x2, ones])[:, None] * x1
        B = np.vstack([self.v2, zeros])[:, None] * x1
        return np.ascontiguousarray(A.reshape(9, -1).T), np.ascontiguousarray(B.reshape(9, -1).T)


@dataclass(frozen=True)
class _Agreement:
    """RANSAC's solution: of all solutions from nine pairs, the one with most inliers."""

    pairs: _Linearised
    shift_s: float
    inliers: Mask  # (n,) of the pairs

    @property
    def inlier_share(self) -> float:
        return float(np.mean(self.inliers))

    def polished(self, step_s: float) -> float:
        """Shift [s], up to `step_s` from the one found, that fits all its inliers best."""
        A, B = (of_all[self.inliers] for of_all in self.pairs.constraints)
        moments = A.T @ A, A.T @ B + B.T @ A, B.T @ B
        polished = minimize_scalar(
            lambda b: np.linalg.eigvalsh(moments[0] + b * moments[1] + b**2 * moments[2])[0],
            args=(),
            bounds=(self.shift_s - step_s, self.shift_s + step_s),
            method="bounded",
        )
        return float(polished.x)


@method("albl", "eigenvalue solver of Albl et al. (2017)", place=7)
def albl_of_views(views: TwoViews) -> Estimate:
    """Time offset and relative pose by the iterated solver; it may stop at a local optimum.

    Deviation from Albl et al.: they start from a rough offset, which is not given here. The
    iteration starts at the offset where a first RANSAC finds most inliers, on a grid all over the
    search interval that is fixed to the clocks. Their image tracks are sampled per frame, ours
    at any time, so the shift is not rounded to frames; RANSAC's solution is polished by a search in
    b for the least singular value of the same equations over all its inliers; and two more such
    rounds follow at the end, whether they gain inliers or not, as all pairs may be inliers some
    milliseconds off. Albl et al. do not say when to distrust the result.
    """
    rules, min_pairs = views.rules.albl, views.rules.search.min_pairs
    usable_s = candidate_offsets(views)
    if len(usable_s) == 0:
        low, high = views.config.offsets_s
        reason = f"the events have no common time at any offset between {low:g} and {high:g} s"
        return Estimate("albl", Status.NO_COMMON_TIME, reason)
    low, high = float(usable_s[0]), float(usable_s[-1])
    t_d_s = _start(views, low, high)
    rng = np.random.default_rng(views.config.seed)
    best_share = 0.0
    level, pairs = 0, views.pairs(np.array([t_d_s]))
    for _ in range(rules.max_rounds):
        if level == rules.n_steps:
            break
        step_s = rules.first_step_s * 2**level
        shift_s, share = _best_shift(views, pairs, step_s, rng, best_share)
        if share > best_share and low <= t_d_s + shift_s <= high:
            t_d_s, best_share, level = t_d_s + shift_s, share, 0
            pairs = views.pairs(np.array([t_d_s]))
        else:
            level += 1
    for _ in range(rules.last_rounds):
        shift_s, _ = _best_shift(views, pairs, rules.first_step_s, rng)
        if abs(shift_s) < rules.first_step_s:
            t_d_s += shift_s
            pairs = views.pairs(np.array([t_d_s]))
    p1, p2 = pairs.valid_positions(0)
    if len(p1) < min_pairs:
        reason = f"{len(p1)} valid pairs at t_d = {t_d_s:.3f} s, {min_pairs} are needed"
        return Estimate("albl", Status.TOO_FEW_SAMPLES, reason)
    F = reweighted_fundamental(p1, p2)
    # Inliers are counted again without the linearisation, whose long secants fit many F.
    is_near = np.abs(sampson_distance(F, p1, p2)) < rules.inlier_px
    share = min(best_share, float(np.mean(is_near)))
    if share < rules.min_inlier_share:
        reason = (
            f"only {100 * share:.0f} % of the pairs agree on t_d = {t_d_s:.3f} s, so that it is a"
            " local optimum: search a shorter interval around the true offset"
        )
        return Estimate("albl", Status.NO_CONVERGENCE, reason)
    return with_pose(with_fit(Estimate("albl", t_d_s=t_d_s), F, p1, p2), F, views, p1, p2)


def _start(views: TwoViews, low_s: float, high_s: float) -> float:
    """Choose the start [s]: the offset at which one linearised RANSAC finds most inliers."""
    # Starts are odd multiples of half a step, fixed to the clocks: starts that depended on an
    # interval put around the true offset would give this offset away.
    rules, step_s = views.rules.albl, views.rules.albl.start_step_s
    first, last = (round(bound_s / step_s) for bound_s in (low_s, high_s))
    grid_s = step_s * (np.arange(first - 1, last + 2) + 0.5)
    starts_s = np.unique(np.clip(grid_s, low_s, high_s))
    best_s, best_share = float(starts_s[0]), 0.0
    pairs = views.pairs(starts_s)
    both = _secants(views, pairs, 0.5 * step_s)
    for m, start_s in enumerate(starts_s.tolist()):
        rng = np.random.default_rng(views.config.seed)  # the same numbers for each start
        linearised = [_linearised(pairs, *secants, m) for secants in both]
        found = _most_agreed(linearised, views.rules, rng, best_share, rules.start_trials)
        if found is not None:
            best_s, best_share = start_s, found.inlier_share
        if best_share == 1.0:  # none is better
            break
    return best_s


def _best_shift(
    views: TwoViews, pairs: Pairs, step_s: float, rng: np.random.Generator, to_exceed: float = 0.0
) -> tuple[float, float]:
    """Shift [s] with most inliers, by forward or backward secants, and their share; or 0, 0."""
    both = [_linearised(pairs, *secants, 0) for secants in _secants(views, pairs, step_s)]
    found = _most_agreed(both, views.rules, rng, to_exceed, views.rules.albl.trials)
    return (0.0, 0.0) if found is None else (found.polished(step_s), found.inlier_share)


def _secants(views: TwoViews, pairs: Pairs, step_s: float) -> list[tuple[Track, float]]:
    """Sample p2 (M, N) a step after its times and a step before, each with the signed step."""
    clock_s = views.on_clock_2(pairs.times_s, pairs.t_d_s[:, None])
    return [(views.motion2.at(clock_s + by_s), by_s) for by_s in (step_s, -step_s)]


def _most_agreed(
    both: list[_Linearised], rules: Rules, rng: np.random.Generator, to_exceed: float, trials: int
) -> _Agreement | None:
    """Run RANSAC by either secant; None if no inlier share exceeds `to_exceed`."""
    best: _Agreement | None = None
    for linearised in both:
        n = len(linearised)
        if n < max(rules.search.min_pairs, 9):
            continue
        numbers = rng.random((trials, n))
        if to_exceed < 1.0:
            found = _ransac(linearised, numbers, to_exceed, rules.albl)
            if found is not None and found.inlier_share > to_exceed:
                best, to_exceed = found, found.inlier_share
    return best


def _linearised(pairs: Pairs, ahead: Track, step_s: float, m: int) -> _Linearised:
    """Pairs of offset m, with the mean velocity of p2 from t + t_d to t + t_d + step."""
    valid = pairs.valid[m] & ahead.valid[m]
    p1_px, p2_px = pairs.p1_px[m, valid], pairs.p2_px[m, valid]
    v2 = (ahead.positions_px[m, valid] - p2_px) / step_s
    x1, x2 = (p_px - np.cumsum(p_px, axis=0)[-1:] / len(p_px) for p_px in (p1_px, p2_px))
    squares = np.stack([x1, x2]) ** 2
    unit_px = float(np.sqrt(np.mean(squares))) if squares.any() else 1.0
    x1, x2, v2 = np.stack([x1.T, x2.T, v2.T]) / unit_px
    return _Linearised(x1, x2, v2, unit_px, abs(step_s))


def _ransac(
    pairs: _Linearised, numbers: Array, share_to_exceed: float, rules: AlblRules
) -> _Agreement | None:
    """Find the shift with most inliers over random subsets of nine pairs; None if these are few."""
    n, (A, B) = len(pairs), pairs.constraints
    limit, longest_s = (rules.inlier_px / pairs.px_per_unit) ** 2, 2.0 * pairs.step_s
    subsets = np.argsort(numbers, axis=1)[:, :9]  # one per row of random numbers (T, n)
    most = max(int(share_to_exceed * n) - 1, 0)
    found: tuple[float, Array] | None = None
    for first in range(0, len(subsets), 50):
        shifts_s, Fs = _solutions(A, B, subsets[first : first + 50], longest_s)
        best, most = _most_inliers(shifts_s, Fs, pairs.x1, pairs.x2, pairs.v2, limit, most)
        if best >= 0:
            found = float(shifts_s[best]), Fs[best]
        if most == n:
            break
    if found is None:
        return None
    shift_s, F = found
    squares, _ = sampson(F, pairs.x1, pairs.x2 + shift_s * pairs.v2)
    return _Agreement(pairs, shift_s, squares < limit)


def _solutions(A: Array, B: Array, subsets: Indices, longest_s: float) -> tuple[Array, Array]:
    """All real solutions of (A + b B) f = 0 for subsets (T, 9): shifts b (S,) [s], F (S, 3, 3)."""
    # B's last three columns are zero. With X (9, 6) = A^-1 B of the first six, f = -b X f[:6]: six
    # of these rows are an eigenvalue problem for f[:6]; the other three give the rest of f.
    X = _quotients(A, B, subsets)
    X = X[np.isfinite(X).all(axis=(1, 2))]
    inverse_shifts, heads = np.linalg.eig(-X[:, :6])
    is_real = (np.abs(inverse_shifts.imag) < 1e-9) & (inverse_shifts.real != 0.0)
    trials, places = np.nonzero(is_real)
    shifts_s = 1.0 / inverse_shifts.real[trials, places]
    near = np.abs(shifts_s) <= longest_s
    trials, places, shifts_s = trials[near], places[near], shifts_s[near]
    heads = np.ascontiguousarray(heads.real[trials, :, places])
    tails = -shifts_s[:, None] * np.einsum("sij,sj->si", X[trials, 6:], heads)
    return shifts_s, np.concatenate([heads, tails], axis=1).reshape(-1, 3, 3)


@numba.njit(cache=True)
def _quotients(A: Array, B: Array, subsets: Indices) -> Array:
    """A^-1 B of the rows in each subset, (T, 9, 6), by Gaussian elimination with pivoting."""
    # At the true offset A is singular but for noise. A pivot near zero is replaced by a number
    # that is tiny for coordinates of order 1, and the shift b comes out as about zero.
    least_pivot = 1e-12
    found, rows = np.empty((len(subsets), 9, 6)), np.empty((9, 15))
    for trial in range(len(subsets)):
        subset, X = subsets[trial], found[trial]
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
            if abs(rows[k, k]) < least_pivot:
                rows[k, k] = least_pivot
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
    return found


@numba.njit(cache=True)
def _most_inliers(
    shifts_s: Array, F: Array, x1: Array, x2: Array, v2: Array, limit: float, most: int
) -> tuple[int, int]:
    """Index of the first solution with most inliers, and their number; -1 if none has > `most`."""
    best, n = -1, x1.shape[1]
    for s in range(len(shifts_s)):
        blocks = in_blocks(x1, x2 + shifts_s[s] * v2)
        count = count_near(limit, F[s].ravel(), n, blocks, most)
        if count > most:
            best, most = s, count
    return best, most
