"""The alignment of one path with another: the shift and rate of its clock, and a similarity.

Both paths may have clocks and frames of their own. Correlations give, for all shifts on an even
grid at once, how much of the truth's motion the best similarity leaves unexplained. A hover fits
anything: at a wrong shift a scale near 0, or most of the samples at rest, make small distances. So
the score of a shift is a likelihood: of the unexplained share of the variance, to which rest adds
nothing, and of the number of common samples. For the few best shifts, shift, rate and similarity
are refined together by robust least squares; the one that explains most of the motion is returned.

Deviation: the paper does not align times; it registers both paths as sets of points (ICP).
"""

from dataclasses import dataclass

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft
from scipy.interpolate import Akima1DInterpolator, BSpline, PPoly, make_lsq_spline
from scipy.spatial.transform import Rotation

from ssac.arrays import Array, Mask
from ssac.clock import PPM, Clock
from ssac.errors import SsacError
from ssac.geometry.epipolar import cauchy_weights, robust_deviation
from ssac.network.tum import Path

RATE_STD_PPM = 50.0
"""Prior deviation of the rate between two oscillators; phones and camcorders need 1000."""


@dataclass(frozen=True)
class PathRules:
    """How paths are interpolated, and which shifts between two are tried."""

    # Between points further apart than both `gap_s` and `gap_steps` median steps there is a gap.
    gap_s: float = 0.5
    gap_steps: float = 4.0
    points_per_knot: tuple[int, ...] = (2, 4, 8, 16)  # tried for a smooth curve
    ordinary_percent: float = 95.0  # of squared residuals, the least, that tell the noise
    least_points: int = 16  # of a smooth curve; fewer are interpolated
    least_samples: int = 20  # in common
    least_common_share: float = 0.2  # of the shorter path
    most_shifts: int = 8  # that are refined
    rival: float = 0.5  # share of the best score, below which a shift is no rival
    steps_per_spread: float = 50.0  # of the grid, in which the object crosses its path's spread
    steps_s: tuple[float, float] = (0.01, 0.5)  # least and largest
    moving_percent: float = 90.0  # percentile of the speeds taken as that in motion, despite hovers
    few_percent: float = 1.0  # of the points that may be outliers at either end of each axis
    at_rest: float = 1e-6  # variance, in squares of the spread, below which the object is at rest
    most_growth: float = 3.0  # of the scale in the refinement; at a wrong shift it goes to 0


RULES = PathRules()


@dataclass(frozen=True, eq=False)
class Similarity:
    """A similarity from the source's frame to the target's: x -> scale R x + t."""

    scale: float
    R: Array  # (3, 3)
    t: Array  # (3,) in the target's unit

    def apply(self, points: Array) -> Array:
        """Give points (..., 3) in the target's frame."""
        return np.asarray(self.scale * points @ self.R.T + self.t)

    def after(self, first: "Similarity") -> "Similarity":
        """Give the similarity that applies `first`, and then this one."""
        return Similarity(self.scale * first.scale, self.R @ first.R, self.apply(first.t))


def similarity(source: Array, target: Array, with_scale: bool = True) -> Similarity:
    """Fit scale R x + t to points (n, 3) by least squares (Umeyama, PAMI 1991, Eqs. 34 to 43)."""
    shares: Array = np.full(len(source), 1.0 / max(len(source), 1))
    middle, middle_target = shares @ source, shares @ target
    centred, centred_target = source - middle, target - middle_target
    for points, name in ((centred, "source"), (centred_target, "target")):
        spread = np.linalg.svd(np.sqrt(shares)[:, None] * points, compute_uv=False)
        if len(spread) < 3 or spread[1] <= 1e-6 * spread[0]:
            raise SsacError(
                f"the {name}'s {len(points)} points lie on a line or in one place, and do not tell "
                "how it is turned: give a path with a curve in it"
            )
    covariance = centred_target.T @ (shares[:, None] * centred)
    U, d, Vt = np.linalg.svd(covariance)
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(U) * np.linalg.det(Vt))])  # no reflection
    R = (U * signs) @ Vt
    scale = float(d @ signs / (shares @ np.sum(centred**2, axis=1))) if with_scale else 1.0
    return Similarity(scale, R, middle_target - scale * R @ middle)


def by_similarity(arms: Array) -> Array:
    """Return derivatives (..., 3, 7) of points by turn, shift and log of scale about their middle.

    `arms` (..., 3) lead to the points from their middle.
    """
    turns = np.swapaxes(np.cross(np.eye(3), arms[..., None, :]), -1, -2)
    shifts = np.broadcast_to(np.eye(3), turns.shape)
    return np.concatenate([turns, shifts, arms[..., None]], axis=-1)


class InTime:
    """A path as a function of time: a curve and its gaps."""

    def __init__(self, times_s: Array, curve: PPoly | BSpline) -> None:
        self.times_s = times_s  # (n,) of the points from which the curve was made
        self._curve, self._velocity = curve, curve.derivative()
        steps_s = np.diff(times_s)
        self._is_gap = steps_s > max(RULES.gap_s, RULES.gap_steps * float(np.median(steps_s)))

    def at(self, times_s: Array) -> Array:
        """Give positions (n, 3); NaN before the first point, after the last one and in gaps."""
        return np.where(self.covers(times_s)[:, None], self._curve(times_s), np.nan)

    def velocity(self, times_s: Array) -> Array:
        """Give velocities (n, 3) [1/s]; NaN where there are no positions."""
        return np.where(self.covers(times_s)[:, None], self._velocity(times_s), np.nan)

    def covers(self, times_s: Array) -> Mask:
        """Whether there is a position at times (n,); at the points' own times there always is."""
        inside = (times_s >= self.times_s[0]) & (times_s <= self.times_s[-1])
        piece = np.searchsorted(self.times_s, times_s, side="right") - 1
        piece = np.clip(piece, 0, len(self._is_gap) - 1)
        is_own = (times_s == self.times_s[piece]) | (times_s == self.times_s[-1])
        return np.asarray(inside & (~self._is_gap[piece] | is_own))


def interpolated(path: Path) -> InTime:
    """Interpolate by Akima's cubics: gaps and outliers affect slopes two points away at most."""
    return InTime(path.times_s, Akima1DInterpolator(path.times_s, path.positions_m, axis=0))


def smoothed(path: Path) -> InTime:
    """Fit the robust least-squares cubic spline whose knot spacing cross-validation prefers.

    Without it, the best shift would be drawn half-way between noisy points, by 10 ms at 50 Hz, as
    interpolation takes the mean of two there, which halves the noise variance.
    """
    best, least = None, np.inf
    for n in RULES.points_per_knot:
        if len(path) < max(RULES.least_points, 2 * n):
            break
        spline, missed = _spline(path, n)
        freedom = 1.0 - len(spline.c) / len(path)
        squares = np.sum(missed**2, axis=1)
        ordinary = squares <= np.percentile(squares, RULES.ordinary_percent)
        score = float(np.mean(squares[ordinary])) / freedom**2  # generalised cross-validation
        if score < least:
            best, least = spline, score
    return interpolated(path) if best is None else InTime(path.times_s, best)


def _spline(path: Path, points_per_knot: int) -> tuple[BSpline, Array]:
    """Fit a robust spline with so many points per knot; return it and its residuals (n, 3)."""
    times_s = path.times_s
    inner = times_s[points_per_knot:-points_per_knot:points_per_knot]
    knots_s = np.r_[[times_s[0]] * 4, inner, [times_s[-1]] * 4]
    weights: Array = np.ones(len(path))
    for _ in range(4):
        fitted = make_lsq_spline(
            times_s, path.positions_m, knots_s, w=np.sqrt(weights), method="norm-eq"
        )
        spline = BSpline(knots_s, np.asarray(fitted.c, np.float64), fitted.k)
        missed: Array = path.positions_m - spline(times_s)
        weights = np.maximum(cauchy_weights(np.linalg.norm(missed, axis=1))[0], 1e-9)
    return spline, missed


def _best_shifts_s(
    estimate: InTime, truth: InTime, max_shift_s: float | None, with_scale: bool
) -> tuple[list[float], float]:
    """Give the shifts [s] of the best few peaks of the score over even shifts, best first.

    Also gives the largest shift [s] to which one may be refined: a step beyond the bound.
    """
    common_s = float(np.ptp(estimate.times_s) + np.ptp(truth.times_s))
    step_s = min(_step_s(estimate), _step_s(truth))
    step_s = max(step_s, common_s / 2**20)  # the memory's limit
    unit = None if with_scale else _spread(truth)
    one, other = (_at_even_times(path, step_s, unit) for path in (estimate, truth))
    lags, score = _scores(one, other, with_scale)
    shifts_s = truth.times_s[0] - estimate.times_s[0] + step_s * lags
    most_s = np.inf if max_shift_s is None else max_shift_s + step_s
    score = np.where(np.abs(shifts_s) <= most_s, score, -np.inf)
    around = np.maximum(np.append(score[1:], -np.inf), np.insert(score[:-1], 0, -np.inf))
    peaks = np.flatnonzero((score >= around) & np.isfinite(score))
    peaks = peaks[score[peaks] >= RULES.rival * np.max(score[peaks], initial=-np.inf)]
    best = peaks[np.argsort(-score[peaks])][: RULES.most_shifts]
    return [float(shifts_s[k]) for k in best], most_s


def _scores(estimate: Array, truth: Array, with_scale: bool) -> tuple[Array, Array]:
    """Give the lags (n,) in steps, and the score (n,) of each; -inf for too little in common."""
    # Umeyama's similarity needs means, variances and the covariance of what both even paths have in
    # common: correlations of the paths, 0 in gaps, and of the masks of their samples.
    rows_e, rows_t = _moments(estimate), _moments(truth)
    n_e, n_t = rows_e.shape[1], rows_t.shape[1]
    size = next_fast_len(n_e + n_t - 1, real=True)
    spectra_e, spectra_t = np.conj(rfft(rows_e, size)), rfft(rows_t, size)

    def correlated(k: int, m: int) -> Array:  # sum over i of e[k, i] t[m, i + lag]
        both = irfft(spectra_e[k] * spectra_t[m], size)
        return np.asarray(np.roll(both, n_e - 1)[: n_e + n_t - 1])

    seen, square = 3, 4
    n = np.rint(correlated(seen, seen))
    least = RULES.least_common_share * min(rows_e[seen].sum(), rows_t[seen].sum())
    enough = n >= max(RULES.least_samples, least)
    n = np.maximum(n, 1.0)
    mean_e = np.stack([correlated(i, seen) for i in range(3)]) / n
    mean_t = np.stack([correlated(seen, i) for i in range(3)]) / n
    var_e = correlated(square, seen) / n - np.sum(mean_e**2, axis=0)
    var_t = correlated(seen, square) / n - np.sum(mean_t**2, axis=0)
    covariance = np.empty((len(n), 3, 3))
    for i, j in np.ndindex(3, 3):
        covariance[:, i, j] = correlated(j, i) / n - mean_t[i] * mean_e[j]
    enough &= (var_e > RULES.at_rest) & (var_t > RULES.at_rest)
    var_e, var_t = np.maximum(var_e, RULES.at_rest), np.maximum(var_t, RULES.at_rest)
    # The largest trace of R' C over rotations R.
    values, mirrors = np.linalg.svd(covariance, compute_uv=False), np.linalg.det(covariance) < 0.0
    turned = values[:, 0] + values[:, 1] + np.where(mirrors, -1.0, 1.0) * values[:, 2]
    if with_scale:
        unexplained = 1.0 - np.maximum(turned, 0.0) ** 2 / (var_e * var_t)
    else:
        unexplained = (var_t + var_e - 2.0 * turned) / var_t
    score = _likelihood(n, unexplained)
    return np.arange(1 - n_e, n_t, dtype=np.float64), np.where(enough, score, -np.inf)


def _likelihood(n: Array | float, unexplained: Array | float) -> Array:
    """Log likelihood of n samples, by the share of the truth's variance that is unexplained."""
    return np.asarray(-n * np.log(np.clip(unexplained, 1e-9, 1.0)))


def _moments(positions: Array) -> Array:
    """Rows (5, n): x, y, z, whether there is a position, its square; 0 where there is none."""
    seen = np.isfinite(positions[:, 0])
    filled = np.where(seen[:, None], positions, 0.0)
    return np.vstack([filled.T, seen, np.sum(filled**2, axis=1)])


def _at_even_times(path: InTime, step_s: float, unit: float | None) -> Array:
    """Positions (n, 3) on an even grid, NaN in gaps, from their median, divided by a unit."""
    times_s = np.arange(path.times_s[0], path.times_s[-1] + step_s, step_s)
    middle = np.median(path.at(path.times_s), axis=0)
    return np.asarray((path.at(times_s) - middle) / (unit or _spread(path)))


def _spread(path: InTime) -> float:
    """Diagonal [m] of the box that contains nearly all of a path."""
    ends = RULES.few_percent, 100.0 - RULES.few_percent
    low, high = np.percentile(path.at(path.times_s), ends, axis=0)
    return float(np.linalg.norm(high - low)) or 1.0


def _step_s(path: InTime) -> float:
    """Step [s] in which a moving object covers a small share of its path's spread."""
    speeds = np.linalg.norm(path.velocity(path.times_s), axis=1)
    speed = max(float(np.percentile(speeds, RULES.moving_percent)), np.finfo(float).tiny)
    return float(np.clip(_spread(path) / (RULES.steps_per_spread * speed), *RULES.steps_s))


def best_shift(
    estimate: Path,
    truth: Path,
    max_shift_s: float | None = None,
    rate_std_ppm: float = RATE_STD_PPM,
    with_scale: bool = True,
) -> tuple[Clock, Similarity]:
    """Find the truth's clock relative to the estimate's, and the similarity to the truth's frame.

    Each path may begin and end at any time and have gaps. Shifts are tried up to `max_shift_s` in
    either direction, or all that leave enough common time; `rate_std_ppm` is 0 where clocks run
    alike. SsacError if the paths share too little time at any shift, or do not move enough.
    """
    if len(truth) < RULES.least_samples:
        raise SsacError(
            f"the truth has {len(truth)} points with times, and a shift needs at least"
            f" {RULES.least_samples}: give more of it, or leave its times out to compare shapes"
        )
    path, best, score = smoothed(estimate), None, -np.inf
    shifts_s, most_s = _best_shifts_s(path, smoothed(truth), max_shift_s, with_scale)
    for shift_s in shifts_s:
        fit = _refined(path, truth, shift_s, rate_std_ppm, with_scale)
        if fit is None or abs(fit[0].t_d_s) > most_s:
            continue  # it diverged, or left the bound
        if _score(*fit, path, truth) > score:
            best, score = fit, _score(*fit, path, truth)
    if best is None:
        within = "" if max_shift_s is None else f" within {max_shift_s:g} s"
        raise SsacError(
            f"the estimate and the truth have no shift{within} at which they share time and move "
            "alike: check that they are of one flight"
        )
    return best


def _refined(
    path: InTime, truth: Path, shift_s: float, rate_std_ppm: float, with_scale: bool
) -> tuple[Clock, Similarity] | None:
    """Refine shift, rate and similarity by Gauss-Newton; None where they diverge."""
    common_s = truth.times_s[path.covers(truth.times_s - shift_s)] - shift_s
    if len(common_s) < RULES.least_samples:
        return None
    clock = Clock(shift_s, 0.0, float(common_s[0] + common_s[-1]) / 2.0)
    seen = path.covers(clock.cam1_from_cam2(truth.times_s))
    try:
        frame = first = similarity(path.at(common_s), truth.positions_m[seen], with_scale)
    except SsacError:
        return None  # on a line, or at rest
    for _ in range(30):
        times_s, before_s = clock.cam1_from_cam2(truth.times_s), clock.t_d_s
        seen = path.covers(times_s)
        if seen.sum() < RULES.least_samples:
            return None
        target = truth.positions_m[seen]
        clock, frame = _stepped(clock, frame, path, times_s[seen], target, rate_std_ppm, with_scale)
        if not 1.0 / RULES.most_growth < frame.scale / first.scale < RULES.most_growth:
            return None
        if abs(clock.t_d_s - before_s) < 1e-7:
            break
    return clock, frame


def _stepped(
    clock: Clock,
    frame: Similarity,
    path: InTime,
    times_s: Array,
    target: Array,
    rate_std_ppm: float,
    with_scale: bool,
) -> tuple[Clock, Similarity]:
    """Take a Gauss-Newton step, robustly: of shift [s], rate, turn [rad], move, log of scale."""
    laid = frame.apply(path.at(times_s))
    missed = target - laid  # (n, 3)
    weights = cauchy_weights(np.linalg.norm(missed, axis=1))[0]
    middle = weights @ laid / weights.sum()
    arm = laid - middle
    moving = frame.scale * path.velocity(times_s) @ frame.R.T
    J = np.zeros((len(times_s), 3, 9))
    J[:, :, 0] = -moving  # the truth's clock shows more: an earlier point of the estimate
    J[:, :, 1] = -moving * (times_s - clock.t_ref_s)[:, None]
    J[:, :, 2:] = by_similarity(arm)
    free = np.ones(9, bool)
    free[1], free[8] = rate_std_ppm > 0.0, with_scale
    normal = np.einsum("n,nik,nim->km", weights, J, J)
    right = np.einsum("n,nik,ni->k", weights, J, missed)
    if rate_std_ppm > 0.0:
        prior = (robust_deviation(missed) / (PPM * rate_std_ppm)) ** 2
        normal[1, 1] += prior
        right[1] -= prior * PPM * clock.skew_ppm
    unit = np.sqrt(np.maximum(np.diag(normal), np.finfo(float).tiny))  # units differ
    step = np.zeros(9)
    scaled = (normal / np.outer(unit, unit))[np.ix_(free, free)]
    step[free] = np.linalg.lstsq(scaled, (right / unit)[free], rcond=1e-12)[0] / unit[free]
    turn = Rotation.from_rotvec(step[2:5]).as_matrix()
    scale = float(np.exp(np.clip(step[8], -1.0, 1.0)))
    about_middle = Similarity(scale, turn, middle + step[5:8] - scale * turn @ middle)
    t_d_s, skew_ppm = clock.t_d_s + float(step[0]), clock.skew_ppm + float(step[1]) / PPM
    return Clock(t_d_s, skew_ppm, clock.t_ref_s), about_middle.after(frame)


def _score(clock: Clock, frame: Similarity, path: InTime, truth: Path) -> float:
    """Log likelihood of the unexplained share of the truth's motion, with clipped gross errors."""
    times_s = clock.cam1_from_cam2(truth.times_s)
    seen = path.covers(times_s)
    target = truth.positions_m[seen]
    squares = np.sum((target - frame.apply(path.at(times_s[seen]))) ** 2, axis=1)
    spread = float(np.mean(np.sum((target - target.mean(axis=0)) ** 2, axis=1)))
    unexplained = float(np.mean(np.minimum(squares, spread))) / max(spread, np.finfo(float).tiny)
    return float(_likelihood(float(seen.sum()), unexplained))
