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

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from ssac.estimate import Estimate, Status
from ssac.geometry.epipolar import sampson_distance
from ssac.geometry.fundamental import MIN_PAIRS, reweighted_fundamental
from ssac.methods.albl_eigen import solve_nine
from ssac.methods.albl_kernels import (
    centred,
    constraints,
    inliers_of,
    most_inliers,
    next_better,
    nine_least,
)
from ssac.methods.algorithms import with_fit, with_pose
from ssac.search.offset_search import candidate_offsets
from ssac.search.two_views import Pairs, TwoViews
from ssac.track.motion import Track

Array = NDArray[np.float64]

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
