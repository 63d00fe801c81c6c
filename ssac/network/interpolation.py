"""A path's points in; where the object was at any time between them, and how fast, out."""

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import Akima1DInterpolator, BSpline, PPoly, make_lsq_spline

from ssac.geometry.robust import cauchy_weights
from ssac.network.tum import Path

Array = NDArray[np.float64]

_GAP_S = 0.5
_GAP_STEPS = 4.0
"""Points further apart than these seconds and than so many usual steps have nothing between."""

_POINTS_PER_KNOT = (2, 4, 8, 16)
_N_WEIGHTINGS = 4
_ORDINARY_PERCENT = 95.0  # of squares, from which the noise is judged: gross errors stay out
_LEAST_POINTS = 16  # of a smooth curve; fewer are interpolated


class InTime:
    """A path as a function of time: a curve, and where there is nothing of it."""

    def __init__(self, times_s: Array, curve: PPoly | BSpline) -> None:
        self.times_s = times_s  # (n,) of the points that it was made of
        self._curve, self._velocity = curve, curve.derivative()
        steps_s = np.diff(times_s)
        self._is_gap = steps_s > max(_GAP_S, _GAP_STEPS * float(np.median(steps_s)))

    def at(self, times_s: Array) -> Array:
        """Give positions (n, 3); NaN before the first point, after the last one and in gaps."""
        return np.where(self.covers(times_s)[:, None], self._curve(times_s), np.nan)

    def velocity(self, times_s: Array) -> Array:
        """Give velocities (n, 3) [1/s]; NaN where there are no positions."""
        return np.where(self.covers(times_s)[:, None], self._velocity(times_s), np.nan)

    def covers(self, times_s: Array) -> NDArray[np.bool_]:
        """Say at which times (n,) there is a position; at each point itself there is."""
        inside = (times_s >= self.times_s[0]) & (times_s <= self.times_s[-1])
        piece = np.searchsorted(self.times_s, times_s, side="right") - 1
        piece = np.clip(piece, 0, len(self._is_gap) - 1)
        return np.asarray(inside & (~self._is_gap[piece] | (times_s == self.times_s[piece])))


def interpolated(path: Path) -> InTime:
    """Give the curve through all points, at least two.

    Akima's cubics: each depends on the points near by alone, so that no gap and no outlier swings
    further than two points.
    """
    return InTime(path.times_s, Akima1DInterpolator(path.times_s, path.positions_m, axis=0))


def smoothed(path: Path) -> InTime:
    """Give the cubic spline of robust least squares that cross-validation says is the smoothest.

    A shift that is sought on points with noise would go half-way between them, where interpolation
    takes the mean of two and so half of the noise: 10 ms of a path at 50 Hz.
    """
    best, least = None, np.inf
    for n in _POINTS_PER_KNOT:
        if len(path) < max(_LEAST_POINTS, 2 * n):
            break
        spline, missed = _spline(path, n)
        freedom = 1.0 - len(spline.c) / len(path)
        squares = np.sum(missed**2, axis=1)
        ordinary = squares <= np.percentile(squares, _ORDINARY_PERCENT)
        score = float(np.mean(squares[ordinary])) / freedom**2  # generalised cross-validation
        if score < least:
            best, least = spline, score
    return interpolated(path) if best is None else InTime(path.times_s, best)


def _spline(path: Path, points_per_knot: int) -> tuple[BSpline, Array]:
    """Fit a spline of so many points from knot to knot; give it, and what it misses (n, 3)."""
    times_s = path.times_s
    inner = times_s[points_per_knot:-points_per_knot:points_per_knot]
    knots_s = np.r_[[times_s[0]] * 4, inner, [times_s[-1]] * 4]
    weights: Array = np.ones(len(path))
    for _ in range(_N_WEIGHTINGS):
        fitted = make_lsq_spline(
            times_s, path.positions_m, knots_s, w=np.sqrt(weights), method="norm-eq"
        )
        spline = BSpline(knots_s, np.asarray(fitted.c, np.float64), fitted.k)
        missed: Array = path.positions_m - spline(times_s)
        weights = np.maximum(cauchy_weights(np.linalg.norm(missed, axis=1))[0], 1e-9)
    return spline, missed
