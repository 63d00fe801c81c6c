"""What may be known of two clocks beforehand in; columns and priors of the least squares out.

The offset is the solver's own parameter. Beside it camera 2's clock may have a skew and, as pieces,
strays that are linear between knots some 5 s apart. Their roughness is the change of the skew from
piece to piece. Strays are written as a sum of modes, none of which has an offset or a skew of its
own, and of which what is known beforehand is independent: so each is one column with a prior.
"""

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from ssac.clock import PPM, Clock
from ssac.estimate import Estimate
from ssac.geometry.problem import (
    FIRST_COLUMN,
    T_D,
    Column,
    Parameters,
    Prior,
    Problem,
    WeighedPairs,
)
from ssac.search.two_views import TwoViews

Array = NDArray[np.float64]

PIECE_S = 5.0
"""Length of a piece of a clock."""

ROUGHNESS_PPM = 200.0
"""Deviation of the change of a phone's skew from one piece to the next, beforehand."""

_MAX_PIECES = 40


@dataclass(frozen=True, eq=False)
class ClockModel:
    """Parameters of a clock beside its offset: the skew [s/s], then strays by mode [s]; or none."""

    t_ref_s: float  # camera 1's clock
    half_s: float  # length of half the common time
    deviations: Array  # (m,) of what is known of each beforehand
    knots_s: Array = field(default_factory=lambda: np.empty(0))  # (k,)
    modes: Array = field(default_factory=lambda: np.empty((0, 0)))  # (k, m - 1) strays by one

    @property
    def has_priors(self) -> bool:
        """Whether anything but the offset is to be found."""
        return len(self.deviations) > 0

    def clock(self, parameters: Parameters) -> Clock:
        """Give the clock of some parameters."""
        values = self.values(parameters)
        if not len(values):
            return Clock(parameters.t_d_s)
        strays_s = self.modes @ values[1:] if len(self.knots_s) else np.empty(0)
        skew_ppm = float(values[0]) / PPM
        return Clock(parameters.t_d_s, skew_ppm, self.t_ref_s, self.knots_s, strays_s)

    def values(self, parameters: Parameters) -> Array:
        """Take this model's own columns of the parameters."""
        return parameters.columns[: len(self.deviations)]

    def start(self, estimate: Estimate) -> Array:
        """Give the values (m,) to start from: those of an estimate."""
        values = np.zeros(len(self.deviations))
        if len(values) and np.isfinite(estimate.skew_ppm):
            values[0] = PPM * estimate.skew_ppm
        if len(self.knots_s) and len(estimate.knots_s):
            strays_s = np.interp(self.knots_s, estimate.knots_s, estimate.strays_s)
            values[1:] = np.linalg.lstsq(self.modes, strays_s)[0]
        return values

    def problem(self, pairs: WeighedPairs, parameters: Parameters, problem: Problem) -> Problem:
        """Add the clock to a problem of pairs that were sampled with the clock of parameters."""
        values = self.values(parameters)
        columns = tuple(
            Column(np.zeros_like(pairs.p1_px), by[:, None] * pairs.v2_px_s, float(value), True)
            for by, value in zip(self._functions(pairs.times_s), values, strict=True)
        )
        priors = tuple(
            Prior(FIRST_COLUMN + k, 0.0, float(deviation))
            for k, deviation in enumerate(self.deviations)
        )
        return replace(problem, columns=columns, priors=priors)

    def moved_s(self, one: Parameters, other: Parameters) -> float:
        """Rms change [s] between two clocks over the common time, the offset apart."""
        change = np.abs(self.values(one) - self.values(other))
        if not len(change):
            return 0.0
        return float(np.hypot(change[0] * self.half_s / np.sqrt(3.0), np.linalg.norm(change[1:])))

    def told(self, estimate: Estimate, parameters: Parameters, problem: Problem, covariance: Array
    ) -> Estimate:  # fmt: skip
        """Put the clock found, and the covariance (f, f) of all that was free, into an estimate."""
        clock = self.clock(parameters)
        if not len(self.deviations):  # both run alike: that was said beforehand
            return replace(estimate, t_ref_s=self.t_ref_s, skew_ppm=0.0, skew_std_ppm=0.0)
        places = [T_D, *range(FIRST_COLUMN, FIRST_COLUMN + len(self.deviations))]
        free = np.searchsorted(problem.free, places)
        covariance = covariance[np.ix_(free, free)]
        by = np.vstack([np.ones_like(self.knots_s), *self._functions(self.knots_s)])
        return replace(
            estimate,
            t_ref_s=self.t_ref_s,
            skew_ppm=clock.skew_ppm,
            skew_std_ppm=float(np.sqrt(covariance[1, 1])) / PPM,
            clock_covariance=covariance[:2, :2],
            knots_s=clock.knots_s,
            strays_s=clock.strays_s,
            strays_std_s=np.sqrt(np.einsum("ik,ij,jk->k", by, covariance, by)),
        )

    def _functions(self, times_s: Array) -> list[Array]:
        """Give what a value of one of each parameter adds (n,) at times (n,) [s]."""
        if not len(self.deviations):
            return []
        modes = [np.interp(times_s, self.knots_s, mode) for mode in self.modes.T]
        return [times_s - self.t_ref_s, *modes]


def clock_model(views: TwoViews, start: Estimate) -> ClockModel:
    """Say what is to be found of both clocks, as the config asks for.

    Parameters
    ----------
    views
        Both views.
    start
        Its offset gives the common time, and so t_ref, unless it has one.
    """
    (first_s,), (last_s,) = views.overlap_s(np.array([start.t_d_s]))
    half_s = 0.5 * float(last_s - first_s)
    t_ref_s = float(start.t_ref_s if np.isfinite(start.t_ref_s) else 0.5 * (first_s + last_s))
    config = views.config
    skew = np.array([PPM * config.skew_prior_ppm] if config.skew_prior_ppm > 0.0 else [])
    n_pieces = int(min(np.rint(2.0 * half_s / PIECE_S), _MAX_PIECES))
    if config.clock != "pieces" or n_pieces < 2 or not len(skew):
        return ClockModel(t_ref_s, half_s, skew)
    knots_s: Array = np.linspace(t_ref_s - half_s, t_ref_s + half_s, n_pieces + 1, dtype=np.float64)
    modes, deviations = _modes(knots_s)
    return ClockModel(t_ref_s, half_s, np.append(skew, deviations), knots_s, modes)


def _modes(knots_s: Array) -> tuple[Array, Array]:
    """Give modes (k, k - 2) of rms 1 without offset and skew, and their deviations (k - 2,) [s]."""
    k = len(knots_s)
    step_s = float(knots_s[1] - knots_s[0])
    roughness = np.diff(np.eye(k), 2, axis=0) / step_s  # (k - 2, k) changes of the skew
    affine = np.column_stack([np.ones(k), knots_s - np.mean(knots_s)])
    rest = np.linalg.qr(affine, mode="complete")[0][:, 2:]
    amounts, axes = np.linalg.eigh(rest.T @ roughness.T @ roughness @ rest)
    return rest @ axes * np.sqrt(k), PPM * ROUGHNESS_PPM / np.sqrt(k * amounts)
