"""Two tracks in, offset and pose out: the eigenvalue solver of Albl et al. (CVPR 2017).

From "On the two-view geometry of unsynchronized cameras", the strongest method of frame cameras.

With p2(t + t_d + b) linearised in the time shift b, the epipolar constraint of a pair is
(p2 + b v2)' F p1 = 0, linear in F for a given b. Nine pairs give a generalised eigenvalue problem
for b and F, which is solved inside RANSAC. The linearisation holds for small shifts only, so the
solution is iterated: v2 is the secant over a time step that grows while the shift found does not
gain inliers, and starts small again when it does.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from ssac.camera import Rig
from ssac.epipolar import sampson_distance
from ssac.estimate import pairs_at, with_fit, with_pose
from ssac.fundamental import MIN_PAIRS, reweighted_fundamental
from ssac.interface import Config, Estimate, Observation, checked, object_motions
from ssac.offset_search import sample_pairs
from ssac.tracks import ObjectMotion

Array = NDArray[np.float64]

STEPS_S = (0.02, 0.04, 0.08, 0.16, 0.32, 0.64)
"""Time steps of the secants; Albl et al. use 1, 2, 4, ... frames."""

MIN_INLIER_SHARE = 0.75
"""With fewer inliers among the pairs, the iteration has stopped at a local optimum.

Deviation: Albl et al. do not say when to distrust the result. In flights of 10 and 20 s the share
is above 0.95 at the true offset and below 0.55 where the iteration gets stuck.
"""

_TRIALS = 300  # of RANSAC
_INLIER_PX = 2.0  # Sampson distance
_MAX_ROUNDS = 20
_LAST_ROUNDS = 2


@dataclass(frozen=True)
class _Linearised:
    """Pairs at one offset with the secant velocity of p2, centred and scaled to order 1."""

    x1: Array  # (n, 2)
    x2: Array  # (n, 2)
    v2: Array  # (n, 2) [1/s]
    px_per_unit: float


@dataclass(frozen=True)
class _Solution:
    shift_s: float  # b, to be added to t_d
    inlier_share: float  # of all pairs, 0 to 1


def albl(cam1: Observation, cam2: Observation, rig: Rig, config: Config | None = None) -> Estimate:
    """Time offset and relative pose by the iterated eigenvalue solver of Albl et al. (2017).

    The search starts in the middle of the search interval and looks at no other offset first, so
    that it may stop at a local optimum. Parameters and errors as for `ssac.estimate.ssac`.

    Deviation from Albl et al.: their image tracks are sampled per frame, ours at any time, so the
    shift is not rounded to frames; RANSAC's solution is polished by a search in b for the least
    singular value of the same equations over all its inliers; and two more rounds of that follow
    at the end, whether they gain inliers or not, as all pairs may be inliers some milliseconds off.
    """
    config = checked(config)
    motion1, motion2 = object_motions(cam1, cam2, rig, config)
    rng = np.random.default_rng(config.seed)
    low, high = config.interval_s
    t_d_s = 0.5 * (low + high)
    best_share = 0.0
    level = 0
    for _ in range(_MAX_ROUNDS):
        if level == len(STEPS_S):
            break
        found = _best_shift(motion1, motion2, t_d_s, STEPS_S[level], config, rng)
        if found.inlier_share > best_share and low <= t_d_s + found.shift_s <= high:
            t_d_s, best_share, level = t_d_s + found.shift_s, found.inlier_share, 0
        else:
            level += 1
    for _ in range(_LAST_ROUNDS):
        last = _best_shift(motion1, motion2, t_d_s, STEPS_S[0], config, rng)
        if abs(last.shift_s) < STEPS_S[0]:
            t_d_s += last.shift_s
    p1, p2 = pairs_at(motion1, motion2, t_d_s, config)
    if best_share == 0.0 or len(p1) < MIN_PAIRS:
        reason = f"{len(p1)} valid pairs at t_d = {t_d_s:.3f} s, {MIN_PAIRS} are needed"
        return Estimate("albl", "too_few_samples", reason)
    F = reweighted_fundamental(p1, p2)
    # Once more without the linearisation, which favours large shifts: a secant bends to many F.
    share = min(best_share, float(np.mean(np.abs(sampson_distance(F, p1, p2)) < _INLIER_PX)))
    if share < MIN_INLIER_SHARE:
        reason = (
            f"only {100 * share:.0f} % of the pairs agree on t_d = {t_d_s:.3f} s, so that it is a"
            " local optimum: search a shorter interval around the true offset"
        )
        return Estimate("albl", "no_convergence", reason)
    return with_pose(with_fit(Estimate("albl", t_d_s=t_d_s), F, p1, p2), F, rig, p1, p2)


def _best_shift(
    motion1: ObjectMotion,
    motion2: ObjectMotion,
    t_d_s: float,
    step_s: float,
    config: Config,
    rng: np.random.Generator,
) -> _Solution:
    """Find the shift with most inliers, with the secants ahead and those back in time."""
    solutions = [
        _ransac(_linearised(motion1, motion2, t_d_s, signed_s, config), step_s, rng)
        for signed_s in (step_s, -step_s)
    ]
    return max(solutions, key=lambda solution: solution.inlier_share)


def _linearised(
    motion1: ObjectMotion, motion2: ObjectMotion, t_d_s: float, step_s: float, config: Config
) -> _Linearised:
    """Pairs at t_d, with the mean velocity of p2 from t + t_d to t + t_d + step."""
    pairs = sample_pairs(motion1, motion2, np.array([t_d_s]), config.n_samples)
    ahead = motion2.at(pairs.times_s[0] + t_d_s + step_s)
    valid = pairs.valid[0] & ahead.valid
    p1, p2 = pairs.p1_px[0, valid], pairs.p2_px[0, valid]
    v2 = (ahead.positions_px[valid] - p2) / step_s
    if len(p1) < MIN_PAIRS:
        return _Linearised(p1, p2, v2, 1.0)
    x1, x2 = p1 - np.mean(p1, axis=0), p2 - np.mean(p2, axis=0)
    unit_px = float(np.sqrt(np.mean([x1**2, x2**2])))
    return _Linearised(x1 / unit_px, x2 / unit_px, v2 / unit_px, unit_px)


def _ransac(pairs: _Linearised, step_s: float, rng: np.random.Generator) -> _Solution:
    """Find the shift with most inliers over random subsets of nine pairs, and polish it."""
    n = len(pairs.x1)
    if n < MIN_PAIRS:
        return _Solution(0.0, 0.0)
    A, B = _constraints(pairs)
    subsets = np.argpartition(rng.random((_TRIALS, n)), 9, axis=1)[:, :9]
    shifts_s, F = _solve_nine(A[subsets], B[subsets])
    plausible = np.abs(shifts_s) <= 2.0 * step_s
    if not plausible.any():
        return _Solution(0.0, 0.0)
    shifts_s, inliers = shifts_s[plausible], _inliers(pairs, shifts_s[plausible], F[plausible])
    best = int(np.argmax(np.count_nonzero(inliers, axis=1)))
    A, B = A[inliers[best]], B[inliers[best]]
    moments = A.T @ A, A.T @ B + B.T @ A, B.T @ B
    polished = minimize_scalar(
        lambda b: np.linalg.eigvalsh(moments[0] + b * moments[1] + b**2 * moments[2])[0],
        args=(),
        bounds=(shifts_s[best] - step_s, shifts_s[best] + step_s),
        method="bounded",
    )
    return _Solution(float(polished.x), float(np.mean(inliers[best])))


def _constraints(pairs: _Linearised) -> tuple[Array, Array]:
    """Build A and B (n, 9) with (A + b B) f = 0 for f = F row by row."""
    ones = np.ones((len(pairs.x1), 1))
    x1, x2 = np.hstack([pairs.x1, ones]), np.hstack([pairs.x2, ones])
    v2 = np.hstack([pairs.v2, 0.0 * ones])
    A, B = (np.einsum("ni,nj->nij", left, x1).reshape(-1, 9) for left in (x2, v2))
    return A, B


def _solve_nine(A: Array, B: Array) -> tuple[Array, Array]:
    """All real solutions of (A + b B) f = 0 for each subset.

    B has no entries in f's last three columns; projecting these out leaves a generalised
    eigenvalue problem of size six, with six shifts b.

    Parameters
    ----------
    A, B
        Shape (T, 9, 9).

    Returns
    -------
    tuple of NDArray[np.float64]
        Shifts b (S,) [s] and their F (S, 3, 3).
    """
    Q, upper = np.linalg.qr(A[:, :, 6:], mode="complete")
    projection = np.swapaxes(Q[:, :, 3:], 1, 2)  # rows orthogonal to the last three columns
    inverse_shifts, heads = np.linalg.eig(
        -np.linalg.pinv(projection @ A[:, :, :6]) @ (projection @ B[:, :, :6])
    )
    subset, k = np.nonzero((np.abs(inverse_shifts.imag) < 1e-9) & (inverse_shifts.real != 0.0))
    shifts_s = 1.0 / inverse_shifts.real[subset, k]
    heads = heads.real[subset, :, k]
    rest = A[subset, :, :6] + shifts_s[:, None, None] * B[subset, :, :6]
    projected = np.swapaxes(Q[subset, :, :3], 1, 2) @ (rest @ heads[:, :, None])
    tails = -np.linalg.pinv(upper[subset, :3]) @ projected
    return shifts_s, np.concatenate([heads, tails[:, :, 0]], axis=1).reshape(-1, 3, 3)


def _inliers(pairs: _Linearised, shifts_s: Array, F: Array) -> NDArray[np.bool_]:
    """Tell which pairs (S, n) have a Sampson distance below the threshold for each solution."""
    ones = np.ones(len(pairs.x1))
    x1 = np.column_stack([pairs.x1, ones])
    moved = pairs.x2 + shifts_s[:, None, None] * pairs.v2
    x2 = np.concatenate([moved, np.broadcast_to(ones[:, None], (*moved.shape[:2], 1))], axis=2)
    lines_2 = x1 @ np.swapaxes(F, 1, 2)
    lines_1 = x2 @ F
    squares = np.sum(x2 * lines_2, axis=2) ** 2
    norms = np.sum(lines_1[..., :2] ** 2, axis=2) + np.sum(lines_2[..., :2] ** 2, axis=2)
    return np.asarray(squares < (_INLIER_PX / pairs.px_per_unit) ** 2 * norms)
