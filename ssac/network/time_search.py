"""A path and the truth, each on its own clock and in its own frame, in; clock and frame out.

Of all shifts the few are taken that a grid finds best; shift, rate and similarity of each are
refined together by robust least squares, and the one that explains most of the motion is the
answer.

Deviation: the paper does not align times; it registers both paths as sets of points (ICP).
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ssac.clock import PPM, Clock
from ssac.errors import SsacError
from ssac.geometry.robust import cauchy_weights, robust_deviation
from ssac.network.align import Similarity, similarity
from ssac.network.interpolation import InTime, smoothed
from ssac.network.shift_grid import LEAST_SAMPLES, ShiftGrid, likelihood
from ssac.network.tum import Path

Array = NDArray[np.float64]

RATE_STD_PPM = 50.0
"""Prior deviation of the rate between two oscillators; phones and camcorders need 1000."""

_N_STEPS = 30
_DONE_S = 1e-7
_MOST_GROWTH = 3.0  # of the scale while it is refined; at a wrong shift it runs to 0


@dataclass(frozen=True, eq=False)
class _Fit:
    clock: Clock
    similarity: Similarity


def best_shift(
    estimate: Path,
    truth: Path,
    max_shift_s: float | None = None,
    rate_std_ppm: float = RATE_STD_PPM,
    with_scale: bool = True,
) -> tuple[Clock, Similarity]:
    """Find the clock and the frame of the truth as the estimate sees them.

    Parameters
    ----------
    estimate, truth
        The two paths; each may begin and end where it likes and have gaps.
    max_shift_s
        Shifts that are tried, to both sides; None: all that leave enough common time.
    rate_std_ppm
        Prior deviation of the rate between the clocks; 0: they run alike.
    with_scale
        Whether the estimate's scale is unknown.

    Returns
    -------
    tuple of Clock and Similarity
        `clock.cam2_from_cam1` takes times of the estimate to the truth's clock, t_ref being in
        the middle of the common time; the similarity takes positions of the estimate to the
        truth's frame.

    Raises
    ------
    SsacError
        If the paths share too little time at any shift, or do not move enough.
    """
    path, best, score = smoothed(estimate), None, -np.inf
    for shift_s in ShiftGrid(path, smoothed(truth), with_scale).best_shifts_s(max_shift_s):
        fit = _refined(path, truth, shift_s, rate_std_ppm, with_scale)
        if fit is not None and _score(fit, path, truth) > score:
            best, score = fit, _score(fit, path, truth)
    if best is None:
        within = "" if max_shift_s is None else f" within {max_shift_s:g} s"
        raise SsacError(
            f"the estimate and the truth have no shift{within} at which they share time and move "
            "alike: check that they are of one flight"
        )
    return best.clock, best.similarity


def _refined(
    path: InTime, truth: Path, shift_s: float, rate_std_ppm: float, with_scale: bool
) -> _Fit | None:
    """Refine shift, rate and similarity by Gauss-Newton; None where they run away."""
    common_s = truth.times_s[path.covers(truth.times_s - shift_s)] - shift_s
    if len(common_s) < LEAST_SAMPLES:
        return None
    clock = Clock(shift_s, 0.0, float(common_s[0] + common_s[-1]) / 2.0)
    seen = path.covers(clock.cam1_from_cam2(truth.times_s))
    try:
        first = similarity(path.at(common_s), truth.positions_m[seen], with_scale)
    except SsacError:
        return None  # on a line, or at rest
    fit = _Fit(clock, first)
    for _ in range(_N_STEPS):
        times_s = fit.clock.cam1_from_cam2(truth.times_s)
        seen = path.covers(times_s)
        if seen.sum() < LEAST_SAMPLES:
            return None
        before = fit.clock
        fit = _stepped(fit, path, times_s[seen], truth.positions_m[seen], rate_std_ppm, with_scale)
        if not 1.0 / _MOST_GROWTH < fit.similarity.scale / first.scale < _MOST_GROWTH:
            return None
        if abs(fit.clock.t_d_s - before.t_d_s) < _DONE_S:
            break
    return fit


def _stepped(
    fit: _Fit,
    path: InTime,
    times_s: Array,
    target: Array,
    rate_std_ppm: float,
    with_scale: bool,
) -> _Fit:
    """Make one Gauss-Newton step with Cauchy's weights, about the middle of the points.

    Parameters: shift [s], rate, turn (3) [rad], move (3), and the scale's logarithm.
    """
    laid = fit.similarity.apply(path.at(times_s))
    missed = target - laid  # (n, 3)
    weights = cauchy_weights(np.linalg.norm(missed, axis=1))[0]
    middle = weights @ laid / weights.sum()
    arm = laid - middle
    moving = fit.similarity.scale * path.velocity(times_s) @ fit.similarity.R.T
    J = np.zeros((len(times_s), 3, 9))
    J[:, :, 0] = -moving  # the truth's clock shows more: an earlier point of the estimate
    J[:, :, 1] = -moving * (times_s - fit.clock.t_ref_s)[:, None]
    for k, axis in enumerate(np.eye(3)):
        J[:, :, 2 + k] = np.cross(axis, arm)
        J[:, k, 5 + k] = 1.0
    J[:, :, 8] = arm
    free = np.ones(9, bool)
    free[1], free[8] = rate_std_ppm > 0.0, with_scale
    normal = np.einsum("n,nik,nim->km", weights, J, J)
    right = np.einsum("n,nik,ni->k", weights, J, missed)
    if rate_std_ppm > 0.0:
        prior = (robust_deviation(missed) / (PPM * rate_std_ppm)) ** 2
        normal[1, 1] += prior
        right[1] -= prior * PPM * fit.clock.skew_ppm
    unit = np.sqrt(np.maximum(np.diag(normal), np.finfo(float).tiny))  # seconds beside metres
    step = np.zeros(9)
    scaled = (normal / np.outer(unit, unit))[np.ix_(free, free)]
    step[free] = np.linalg.lstsq(scaled, (right / unit)[free], rcond=1e-12)[0] / unit[free]
    turn = Rotation.from_rotvec(step[2:5]).as_matrix()
    scale = float(np.exp(np.clip(step[8], -1.0, 1.0)))
    about_middle = Similarity(scale, turn, middle + step[5:8] - scale * turn @ middle)
    clock = replace(
        fit.clock,
        t_d_s=fit.clock.t_d_s + float(step[0]),
        skew_ppm=fit.clock.skew_ppm + float(step[1]) / PPM,
    )
    return _Fit(clock, about_middle.after(fit.similarity))


def _score(fit: _Fit, path: InTime, truth: Path) -> float:
    """Log likelihood by the share of the truth's motion that is left; a gross error counts once."""
    times_s = fit.clock.cam1_from_cam2(truth.times_s)
    seen = path.covers(times_s)
    target = truth.positions_m[seen]
    squares = np.sum((target - fit.similarity.apply(path.at(times_s[seen]))) ** 2, axis=1)
    spread = float(np.mean(np.sum((target - target.mean(axis=0)) ** 2, axis=1)))
    unexplained = float(np.mean(np.minimum(squares, spread))) / max(spread, np.finfo(float).tiny)
    return float(likelihood(float(seen.sum()), unexplained))
