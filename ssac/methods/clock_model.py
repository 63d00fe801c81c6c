"""What may be known of two clocks and shutters beforehand in; columns and priors of the fit out.

The offset is the solver's own parameter. Beside it camera 2's clock may have a skew and, as pieces,
strays that are linear between knots some 5 s apart. Their roughness is the change of the skew from
piece to piece. Strays are written as a sum of modes, none of which has an offset or a skew of its
own, and of which what is known beforehand is independent: so each is one column with a prior.

Readouts of rolling shutters, where they are to be estimated, are the last columns: they say when a
camera saw what it saw, as clocks do.
"""

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from ssac.clock import PPM, Clock
from ssac.estimate import Estimate
from ssac.fit.least_squares import Solution, solve
from ssac.fit.problem import (
    FIRST_COLUMN,
    T_D,
    Column,
    Parameters,
    Prior,
    Problem,
    WeighedPairs,
)
from ssac.search.shutters import Shutters, shutters_of
from ssac.search.two_views import TwoViews

Array = NDArray[np.float64]

PIECE_S = 5.0
"""Length of a piece of a clock."""

_MAX_PIECES = 40
_HELD_S = 1e-6  # deviation of a readout that is held at a bound


@dataclass(frozen=True, eq=False)
class ClockModel:
    """Parameters beside the offset: the skew [s/s], strays by mode [s], readouts [s]; or none."""

    t_ref_s: float  # camera 1's clock
    half_s: float  # length of half the common time
    deviations: Array  # (m,) of what is known of each beforehand
    knots_s: Array = field(default_factory=lambda: np.empty(0))  # (k,)
    modes: Array = field(default_factory=lambda: np.empty((0, 0)))  # (k, m - 1) strays by one
    shutters: Shutters = field(default_factory=Shutters)

    @property
    def has_priors(self) -> bool:
        """Whether anything but the offset is to be found."""
        return len(self.deviations) > 0 or len(self.shutters.cameras) > 0

    def clock(self, parameters: Parameters) -> Clock:
        """Give the clock of some parameters."""
        values = self.values(parameters)
        if not len(values):
            return Clock(parameters.t_d_s)
        strays_s = self.modes @ values[1:] if len(self.knots_s) else np.empty(0)
        skew_ppm = float(values[0]) / PPM
        return Clock(parameters.t_d_s, skew_ppm, self.t_ref_s, self.knots_s, strays_s)

    def values(self, parameters: Parameters) -> Array:
        """Take the clock's columns of the parameters."""
        return parameters.columns[: len(self.deviations)]

    def readouts_s(self, parameters: Parameters) -> Array:
        """Take the columns (k,) [s] of shutters that are estimated."""
        first = len(self.deviations)
        return parameters.columns[first : first + len(self.shutters.cameras)]

    def views(self, views: TwoViews, parameters: Parameters) -> TwoViews:
        """Give both views under the clock, and with the readouts, of some parameters."""
        read_out = self.shutters.views(views, self.readouts_s(parameters))
        return read_out.under(self.clock(parameters))

    def start(self, estimate: Estimate) -> Array:
        """Give the values (m + k,) to start from: those of an estimate."""
        values = np.zeros(len(self.deviations))
        if len(values) and np.isfinite(estimate.skew_ppm):
            values[0] = PPM * estimate.skew_ppm
        if len(self.knots_s) and len(estimate.knots_s):
            strays_s = np.interp(self.knots_s, estimate.knots_s, estimate.strays_s)
            values[1:] = np.linalg.lstsq(self.modes, strays_s)[0]
        found_s = estimate.readouts_s[list(self.shutters.cameras)]
        return np.append(values, np.where(np.isnan(found_s), self.shutters.expected_s, found_s))

    def problem(
        self, pairs: WeighedPairs, parameters: Parameters, problem: Problem, views: TwoViews
    ) -> Problem:
        """Add clock and shutters to a problem of pairs that were sampled with those of parameters.

        Parameters
        ----------
        pairs, parameters, problem
            The pairs, with what they were sampled, and what they are part of.
        views
            As `views` gives them for the parameters.
        """
        values = self.values(parameters)
        columns = tuple(
            Column(np.zeros_like(pairs.p1_px), by[:, None] * pairs.v2_px_s, float(value), True)
            for by, value in zip(self._functions(pairs.times_s), values, strict=True)
        )
        priors = tuple(
            Prior(FIRST_COLUMN + k, 0.0, float(deviation))
            for k, deviation in enumerate(self.deviations)
        )
        more, known = self._of_shutters(pairs, parameters, views)
        return replace(problem, columns=columns + more, priors=priors + known)

    def solve(self, problem: Problem, start: Parameters) -> Solution:
        """Solve a problem with readouts that are not beyond their bounds, but held at these."""
        found, held = solve(problem, start), problem
        for _ in self.shutters.cameras:
            values_s = self.readouts_s(found.parameters)
            bounds_s = self.shutters.within(values_s)
            first = FIRST_COLUMN + len(self.deviations)
            beyond = {first + k: bounds_s[k] for k in np.flatnonzero(values_s != bounds_s)}
            if not beyond:
                break
            priors = [
                Prior(one.place, float(beyond[one.place]), _HELD_S) if one.place in beyond else one
                for one in held.priors
            ]
            held = replace(held, priors=tuple(priors))
            found = solve(held, start)
        return found

    def moved_s(self, one: Parameters, other: Parameters) -> float:
        """Rms change [s] of clocks, the offset apart, over the common time, and of shutters."""
        change = np.abs(self.values(one) - self.values(other))
        read_out = float(np.linalg.norm(self.readouts_s(one) - self.readouts_s(other)))
        if not len(change):
            return read_out
        strayed = np.hypot(change[0] * self.half_s / np.sqrt(3.0), np.linalg.norm(change[1:]))
        return float(np.hypot(strayed, read_out))

    def told(
        self, estimate: Estimate, parameters: Parameters, problem: Problem, covariance: Array
    ) -> Estimate:
        """Put the clock found, and the covariance (f, f) of all that was free, into an estimate."""
        estimate = self._with_readouts(estimate, parameters, problem, covariance)
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

    def _of_shutters(
        self, pairs: WeighedPairs, parameters: Parameters, views: TwoViews
    ) -> tuple[tuple[Column, ...], tuple[Prior, ...]]:
        """Give columns and priors (k,) of readouts that are to be estimated."""
        shutters, first = self.shutters, FIRST_COLUMN + len(self.deviations)
        if not shutters.cameras:
            return (), ()
        times_s = pairs.times_s, self.clock(parameters).cam2_from_cam1(pairs.times_s)
        moves = zip(
            shutters.moves(views, times_s), self.readouts_s(parameters).tolist(), strict=True
        )
        beforehand = zip(shutters.expected_s.tolist(), shutters.deviations_s.tolist(), strict=True)
        columns = tuple(Column(*both_px, value) for both_px, value in moves)
        return columns, tuple(Prior(first + k, *known) for k, known in enumerate(beforehand))

    def _with_readouts(
        self, estimate: Estimate, parameters: Parameters, problem: Problem, covariance: Array
    ) -> Estimate:
        """Put the readouts that the rig says, and those found, into an estimate."""
        said = [camera.readout_s for camera in (problem.rig.cam1, problem.rig.cam2)]
        readouts_s = np.array([np.nan if one is None else one for one in said])
        stds_s, chosen = 0.0 * readouts_s, list(self.shutters.cameras)
        first = FIRST_COLUMN + len(self.deviations)
        free = np.searchsorted(problem.free, [first + k for k in range(len(chosen))])
        readouts_s[chosen] = self.shutters.within(self.readouts_s(parameters))
        stds_s[chosen] = np.sqrt(np.diag(covariance)[free])
        return replace(estimate, readouts_s=readouts_s, readouts_std_s=stds_s)

    def _functions(self, times_s: Array) -> list[Array]:
        """Give what a value of one of each parameter adds (n,) at times (n,) [s]."""
        if not len(self.deviations):
            return []
        modes = [np.interp(times_s, self.knots_s, mode) for mode in self.modes.T]
        return [times_s - self.t_ref_s, *modes]


def clock_model(views: TwoViews, start: Estimate) -> ClockModel:
    """Say what is to be found of both clocks, as the config asks for, and of shutters.

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
    skew = np.array([PPM * config.prior_ppm] if config.prior_ppm > 0.0 else [])
    n_pieces = int(min(np.rint(2.0 * half_s / PIECE_S), _MAX_PIECES))
    if config.clock != "pieces" or n_pieces < 2 or not len(skew):
        return ClockModel(t_ref_s, half_s, skew, shutters=shutters_of(views))
    knots_s: Array = np.linspace(t_ref_s - half_s, t_ref_s + half_s, n_pieces + 1, dtype=np.float64)
    modes, deviations = _modes(knots_s, config.roughness_ppm)
    deviations = np.append(skew, deviations)
    return ClockModel(t_ref_s, half_s, deviations, knots_s, modes, shutters_of(views))


def _modes(knots_s: Array, roughness_ppm: float) -> tuple[Array, Array]:
    """Give modes (k, k - 2) of rms 1 without offset and skew, and their deviations (k - 2,) [s]."""
    k = len(knots_s)
    step_s = float(knots_s[1] - knots_s[0])
    roughness = np.diff(np.eye(k), 2, axis=0) / step_s  # (k - 2, k) changes of the skew
    affine = np.column_stack([np.ones(k), knots_s - np.mean(knots_s)])
    rest = np.linalg.qr(affine, mode="complete")[0][:, 2:]
    amounts, axes = np.linalg.eigh(rest.T @ roughness.T @ roughness @ rest)
    return rest @ axes * np.sqrt(k), PPM * roughness_ppm / np.sqrt(k * amounts)
