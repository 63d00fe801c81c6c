"""Two paths on clocks of their own in; the few shifts that may lay one over the other, out.

How much of the truth's motion a similarity leaves unexplained follows for all shifts at once from
correlations. A hover fits anything: at a wrong shift a scale near 0, or most of the samples at
rest, make small distances. So a shift is judged by the share of the variance that is left, which
rest has no part in, and by how many samples agree, as of a likelihood.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft, next_fast_len, rfft

from ssac.network.interpolation import InTime

Array = NDArray[np.float64]

LEAST_SAMPLES = 20
"""In common, at least."""

_LEAST_SHARE = 0.2  # of the shorter path, in common
_N_SHIFTS = 8  # that are given, at most
_RIVAL = 0.5  # share of the best score, below which a shift is no rival: the grid costs less
_STEPS_PER_SPREAD = 50.0  # of the grid, while the object crosses its path's spread
_LEAST_STEP_S, _MOST_STEP_S = 0.01, 0.5
_MOST_STEPS = 2**20
_MOVING_PERCENT = 90.0  # of the speeds, which a hover makes small: what counts as moving
_FEW_PERCENT = 1.0  # of the points, to each side of each axis, may lie anywhere
_AT_REST = 1e-6  # variance, by the whole path's, below which the object does not move
_LEAST_UNEXPLAINED = 1e-9


class ShiftGrid:
    """Both paths at even times, and how well they agree at each shift of whole steps."""

    def __init__(self, estimate: InTime, truth: InTime, with_scale: bool) -> None:
        self._with_scale = with_scale
        common_s = float(np.ptp(estimate.times_s) + np.ptp(truth.times_s))
        self._step_s = max(min(_step_s(estimate), _step_s(truth)), common_s / _MOST_STEPS)
        self._first_s = truth.times_s[0] - estimate.times_s[0]
        unit = None if with_scale else _spread(truth)
        self._estimate = _at_even_times(estimate, self._step_s, unit)
        self._truth = _at_even_times(truth, self._step_s, unit)

    def best_shifts_s(self, max_shift_s: float | None) -> list[float]:
        """Give the shifts [s] of the best few peaks of the score, best first."""
        lags, score = self.scores()
        shifts_s = self._first_s + self._step_s * lags
        if max_shift_s is not None:
            score = np.where(np.abs(shifts_s) <= max_shift_s + self._step_s, score, -np.inf)
        around = np.maximum(np.append(score[1:], -np.inf), np.insert(score[:-1], 0, -np.inf))
        peaks = np.flatnonzero((score >= around) & np.isfinite(score))
        peaks = peaks[score[peaks] >= _RIVAL * np.max(score[peaks], initial=-np.inf)]
        best = peaks[np.argsort(-score[peaks])][:_N_SHIFTS]
        return [float(shifts_s[k]) for k in best]

    def scores(self) -> tuple[Array, Array]:
        """Give the lags (n,) in steps, and the score (n,) of each; -inf for too little in common.

        Umeyama's similarity needs means, variances and the covariance of what both have in
        common: correlations of the paths, and of what is seen of them, 0 where nothing is.
        """
        rows_e, rows_t = _moments(self._estimate), _moments(self._truth)
        n_e, n_t = rows_e.shape[1], rows_t.shape[1]
        size = next_fast_len(n_e + n_t - 1, real=True)
        spectra_e, spectra_t = np.conj(rfft(rows_e, size)), rfft(rows_t, size)

        def correlated(k: int, m: int) -> Array:  # sum over i of e[k, i] t[m, i + lag]
            both = irfft(spectra_e[k] * spectra_t[m], size)
            return np.asarray(np.roll(both, n_e - 1)[: n_e + n_t - 1])

        seen, square = 3, 4
        n = np.rint(correlated(seen, seen))
        least = _LEAST_SHARE * min(rows_e[seen].sum(), rows_t[seen].sum())
        enough = n >= max(LEAST_SAMPLES, least)
        n = np.maximum(n, 1.0)
        mean_e = np.stack([correlated(i, seen) for i in range(3)]) / n
        mean_t = np.stack([correlated(seen, i) for i in range(3)]) / n
        var_e = correlated(square, seen) / n - np.sum(mean_e**2, axis=0)
        var_t = correlated(seen, square) / n - np.sum(mean_t**2, axis=0)
        covariance = np.empty((len(n), 3, 3))
        for i, j in np.ndindex(3, 3):
            covariance[:, i, j] = correlated(j, i) / n - mean_t[i] * mean_e[j]
        enough &= (var_e > _AT_REST) & (var_t > _AT_REST)
        var_e, var_t = np.maximum(var_e, _AT_REST), np.maximum(var_t, _AT_REST)
        turned = _trace_of_best_turn(covariance)
        if self._with_scale:
            unexplained = 1.0 - np.maximum(turned, 0.0) ** 2 / (var_e * var_t)
        else:
            unexplained = (var_t + var_e - 2.0 * turned) / var_t
        score = likelihood(n, unexplained)
        return np.arange(1 - n_e, n_t, dtype=np.float64), np.where(enough, score, -np.inf)


def likelihood(n: Array | float, unexplained: Array | float) -> Array:
    """Log likelihood of n samples, by the share of the truth's variance that is unexplained."""
    return np.asarray(-n * np.log(np.clip(unexplained, _LEAST_UNEXPLAINED, 1.0)))


def _moments(positions: Array) -> Array:
    """Rows (5, n): x, y, z, whether there is a position, its square; 0 where there is none."""
    seen = np.isfinite(positions[:, 0])
    filled = np.where(seen[:, None], positions, 0.0)
    return np.vstack([filled.T, seen, np.sum(filled**2, axis=1)])


def _trace_of_best_turn(covariance: Array) -> Array:
    """Largest trace of R' C (n,) over rotations R, for covariances (n, 3, 3)."""
    values = np.linalg.svd(covariance, compute_uv=False)
    mirrors = np.linalg.det(covariance) < 0.0
    return np.asarray(values[:, 0] + values[:, 1] + np.where(mirrors, -1.0, 1.0) * values[:, 2])


def _at_even_times(path: InTime, step_s: float, unit: float | None) -> Array:
    """Positions (n, 3), every `step_s` from the first one on; NaN where there is none.

    About their middle, in units of their spread if no unit is given.
    """
    times_s = np.arange(path.times_s[0], path.times_s[-1] + step_s, step_s)
    middle = np.median(path.at(path.times_s), axis=0)
    return np.asarray((path.at(times_s) - middle) / (unit or _spread(path)))


def _spread(path: InTime) -> float:
    """Length [m] of the diagonal of what nearly all of a path lies within."""
    low, high = np.percentile(path.at(path.times_s), (_FEW_PERCENT, 100.0 - _FEW_PERCENT), axis=0)
    return float(np.linalg.norm(high - low)) or 1.0


def _step_s(path: InTime) -> float:
    """Step [s] in which a path that moves gets a small share of its spread further."""
    speeds = np.linalg.norm(path.velocity(path.times_s), axis=1)
    speed = max(float(np.percentile(speeds, _MOVING_PERCENT)), np.finfo(float).tiny)
    return float(np.clip(_spread(path) / (_STEPS_PER_SPREAD * speed), _LEAST_STEP_S, _MOST_STEP_S))
