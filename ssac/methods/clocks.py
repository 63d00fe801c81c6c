"""Estimation of camera 2's clock beside its offset: a skew, strays between knots, a jump.

The offset is the solver's own parameter. Beside it camera 2's clock may have a skew and, as pieces,
strays: differences from the affine clock that are linear between knots some 5 s apart. Their
roughness is the change of the skew from piece to piece. Strays are a sum of modes that have neither
an offset nor a skew, and whose priors are independent: so each mode is one column with a prior.

Readouts of rolling shutters, where they are to be estimated, are the next columns: like a clock,
they determine when a camera saw an image point.
"""

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ssac.arrays import Array
from ssac.clock import PPM, Clock
from ssac.estimate import SETTLED_BY, ClockJump, Estimate, Refusal, Status
from ssac.fit.least_squares import (
    FIRST_COLUMN,
    T_D,
    Column,
    Parameters,
    Prior,
    Problem,
    Residuals,
    Solution,
    linearise,
    solve,
)
from ssac.geometry.epipolar import CAUCHY, robust_deviation
from ssac.methods.algorithms import algorithm_1, algorithm_2
from ssac.methods.verdict import jumped, refused
from ssac.rules import ClockRules
from ssac.search.two_views import Shutters, TwoViews, shutters_of


@dataclass(frozen=True, eq=False)
class ClockModel:
    """Parameters beside the offset: skew [s/s], modes of strays [s], readouts [s]; or none."""

    t_ref_s: float  # camera 1's clock
    half_s: float  # half the length of the common time
    deviations: Array  # (m,) of the priors of skew and modes; empty: no skew is estimated
    rules: ClockRules
    shutters: Shutters
    knots_s: Array = field(default_factory=lambda: np.empty(0))  # (k,)
    modes: Array = field(default_factory=lambda: np.empty((0, 0)))  # (k, m - 1) strays per unit

    @property
    def has_priors(self) -> bool:
        """Whether a skew, strays or readouts are to be estimated."""
        return len(self.deviations) > 0 or len(self.shutters.cameras) > 0

    @property
    def first_readout(self) -> int:
        """Place of the first readout among the parameters."""
        return FIRST_COLUMN + len(self.deviations)

    def clock(self, parameters: Parameters) -> Clock:
        """Return the clock that these parameters describe."""
        values = self.values(parameters)
        if not len(values):
            return Clock(parameters.t_d_s)
        strays_s = self.modes @ values[1:] if len(self.knots_s) else np.empty(0)
        skew_ppm = float(values[0]) / PPM
        return Clock(parameters.t_d_s, skew_ppm, self.t_ref_s, self.knots_s, strays_s)

    def values(self, parameters: Parameters) -> Array:
        """Values (m,) of the clock's columns: the skew and the modes."""
        return parameters.columns[: len(self.deviations)]

    def readouts_s(self, parameters: Parameters) -> Array:
        """Values (k,) [s] of the columns of readouts that are estimated."""
        first = len(self.deviations)
        return parameters.columns[first : first + len(self.shutters.cameras)]

    def views(self, views: TwoViews, parameters: Parameters) -> TwoViews:
        """Return both views under the clock, and with the readouts, of these parameters."""
        read_out = self.shutters.views(views, self.readouts_s(parameters))
        return read_out.under(self.clock(parameters))

    def start(self, estimate: Estimate) -> Array:
        """Values (m + k,) of the columns to start from, taken from an estimate."""
        values = np.zeros(len(self.deviations))
        if len(values) and np.isfinite(estimate.skew_ppm):
            values[0] = PPM * estimate.skew_ppm
        if len(self.knots_s) and len(estimate.knots_s):
            strays_s = np.interp(self.knots_s, estimate.knots_s, estimate.strays_s)
            values[1:] = np.linalg.lstsq(self.modes, strays_s)[0]
        return np.append(values, self.shutters.readouts_s(estimate))

    def problem(self, problem: Problem, parameters: Parameters, views: TwoViews) -> Problem:
        """Add columns and priors of clock and readouts; `parameters` are those of the sampling."""
        pairs, shutters, first = problem.pairs, self.shutters, self.first_readout
        nothing = np.zeros_like(pairs.p1_px)
        changes = zip(self._functions(pairs.times_s), self.values(parameters), strict=True)
        columns = [
            Column(nothing, by[:, None] * pairs.v2_px_s, float(value), True)
            for by, value in changes
        ]
        priors = [Prior(k, 0.0, float(one)) for k, one in enumerate(self.deviations, FIRST_COLUMN)]
        if shutters.cameras:
            times_s = pairs.times_s, self.clock(parameters).cam2_from_cam1(pairs.times_s)
            values = self.readouts_s(parameters).tolist()
            moves = zip(shutters.moves(views, times_s), values, strict=True)
            columns += [Column(*both_px, value) for both_px, value in moves]
            known = zip(shutters.expected_s.tolist(), shutters.deviations_s.tolist(), strict=True)
            priors += [Prior(first + k, *beforehand) for k, beforehand in enumerate(known)]
        return replace(problem, columns=tuple(columns), priors=tuple(priors))

    def solve(self, problem: Problem, start: Parameters, **how: Any) -> Solution:
        """Solve a problem; a readout that would leave its bounds is held at the bound."""
        found, held, held_s = solve(problem, start, **how), problem, 1e-6
        for _ in self.shutters.cameras:
            values_s = self.readouts_s(found.parameters)
            bounds_s = self.shutters.within(values_s)
            at = np.flatnonzero(values_s != bounds_s)
            beyond = {self.first_readout + k: float(bounds_s[k]) for k in at}
            if not beyond:
                break
            priors = [
                Prior(one.place, beyond[one.place], held_s) if one.place in beyond else one
                for one in held.priors
            ]
            held = replace(held, priors=tuple(priors))
            found = solve(held, start, **how)
        return found

    def moved_s(self, one: Parameters, other: Parameters) -> float:
        """Rms change [s] of the clock but for its offset, over the common time, and of readouts."""
        change = np.abs(self.values(one) - self.values(other))
        read_out = float(np.linalg.norm(self.readouts_s(one) - self.readouts_s(other)))
        if not len(change):
            return read_out
        strayed = np.hypot(change[0] * self.half_s / np.sqrt(3.0), np.linalg.norm(change[1:]))
        return float(np.hypot(strayed, read_out))

    def told(self, estimate: Estimate, residuals: Residuals, covariance: Array) -> Estimate:
        """Add to an estimate the clock found, and the readouts stated or found."""
        problem, parameters = residuals.problem, residuals.parameters
        said = problem.rig.cam1.readout_s, problem.rig.cam2.readout_s
        readouts_s = np.array(said, np.float64)  # NaN: unknown
        stds_s, chosen = 0.0 * readouts_s, list(self.shutters.cameras)
        free = np.searchsorted(problem.free, self.first_readout + np.arange(len(chosen)))
        readouts_s[chosen] = self.shutters.within(self.readouts_s(parameters))
        stds_s[chosen] = np.sqrt(np.diag(covariance)[free])
        clock = self.clock(parameters)
        told = replace(
            estimate,
            readouts_s=readouts_s,
            readouts_std_s=stds_s,
            t_ref_s=self.t_ref_s,
            skew_ppm=clock.skew_ppm,
            skew_std_ppm=0.0,
        )
        if not len(self.deviations):  # both clocks are taken to run alike
            return told
        free = np.searchsorted(problem.free, [T_D, *range(FIRST_COLUMN, self.first_readout)])
        covariance = covariance[np.ix_(free, free)]
        by = np.vstack([np.ones_like(self.knots_s), *self._functions(self.knots_s)])
        return replace(
            told,
            skew_std_ppm=float(np.sqrt(covariance[1, 1])) / PPM,
            clock_covariance=covariance[:2, :2],
            knots_s=clock.knots_s,
            strays_s=clock.strays_s,
            strays_std_s=np.sqrt(np.einsum("ik,ij,jk->k", by, covariance, by)),
        )

    def against(self, residuals: Residuals, hidden_px: Array) -> float:
        """Return by how many deviations the views contradict the prior of the skew.

        The skew that fits best without the prior is divided by the deviation of prior and fit
        together, as a prior that is far too narrow keeps the estimated skew near zero.
        """
        if len(self.deviations) != 1:
            return 0.0
        alone = _with_open_skew(residuals.problem, residuals.parameters, max_steps=5)
        covariance = alone.covariance() + alone.hidden_covariance(hidden_px)
        place = int(np.searchsorted(alone.problem.free, FIRST_COLUMN))
        std = np.hypot(self.deviations[0], np.sqrt(covariance[place, place]))
        return float(abs(alone.parameters.columns[0]) / std)

    def _functions(self, times_s: Array) -> list[Array]:
        """Return the clock's changes (n,) at times (n,) [s], per unit of skew and of each mode."""
        if not len(self.deviations):
            return []
        modes = [np.interp(times_s, self.knots_s, mode) for mode in self.modes.T]
        return [times_s - self.t_ref_s, *modes]


def clock_model(views: TwoViews, start: Estimate) -> ClockModel:
    """Choose what is estimated of the clock, as the config asks for, and of shutters."""
    first_s, last_s = views.common_s(start.t_d_s)
    half_s = 0.5 * (last_s - first_s)
    t_ref_s = float(start.t_ref_s if np.isfinite(start.t_ref_s) else 0.5 * (first_s + last_s))
    config, rules = views.config, views.rules.clock
    skew = np.array([PPM * config.prior_ppm] if config.prior_ppm > 0.0 else [])
    model = ClockModel(t_ref_s, half_s, skew, rules, shutters_of(views))
    n_pieces = int(min(np.rint(2.0 * half_s / rules.piece_s), rules.max_pieces))
    if config.clock != "pieces" or n_pieces < 2 or not len(skew):
        return model
    knots_s: Array = np.linspace(t_ref_s - half_s, t_ref_s + half_s, n_pieces + 1, dtype=np.float64)
    modes, deviations = _modes(knots_s, config.roughness_ppm)
    return replace(model, deviations=np.append(skew, deviations), knots_s=knots_s, modes=modes)


def _modes(knots_s: Array, roughness_ppm: float) -> tuple[Array, Array]:
    """Modes (k, k - 2), of rms 1, without offset and skew; their prior deviations (k - 2,) [s]."""
    k = len(knots_s)
    step_s = float(knots_s[1] - knots_s[0])
    roughness = np.diff(np.eye(k), 2, axis=0) / step_s  # (k - 2, k) changes of the skew
    affine = np.column_stack([np.ones(k), knots_s - np.mean(knots_s)])
    rest = np.linalg.qr(affine, mode="complete")[0][:, 2:]
    amounts, axes = np.linalg.eigh(rest.T @ roughness.T @ roughness @ rest)
    return rest @ axes * np.sqrt(k), PPM * roughness_ppm / np.sqrt(k * amounts)


def checked_clock(estimate: Estimate, model: ClockModel, last: Residuals) -> Estimate:
    """Refuse a refined estimate where camera 2's clock jumps, by the residuals of its solution.

    A step of the offset is tried every second, as one more column of the same least squares, so
    that it is not hidden by the pose and the skew, which a jump biases too. If the best step is
    beyond chance, its size is solved for, and it is moved to the instant after which the later
    offset fits better.
    """
    rules = model.rules
    problem, start = replace(last.problem, turn=CAUCHY), last.parameters  # a jump is no outlier
    at_s = _likely(linearise(problem, start), rules)
    if at_s is None:
        return estimate
    for _ in range(3):
        with_step = _with_change(problem, problem.pairs.times_s >= at_s)
        found = solve(with_step, start).parameters
        start = replace(found, columns=np.append(found.columns[:-1], 0.0))
        moved_to_s = _instant(with_step, found, at_s, rules)
        if moved_to_s == at_s:
            break
        at_s = moved_to_s
    size_s = float(found.columns[-1])
    stepped = linearise(with_step, found)
    std_s = float(np.sqrt(stepped.covariance()[-1, -1]))
    far = rules.far_sigmas * np.min(model.deviations[:1], initial=np.inf)
    is_far = abs(estimate.skew_ppm) * PPM >= far
    least = rules.fewer_sigmas if is_far else rules.jump_sigmas
    if abs(size_s) < max(rules.min_jump_s, least * std_s):
        return estimate
    is_affine = len(model.deviations) <= 1
    skew_ppm = _better_skew_ppm(model, problem, start, stepped) if is_affine else None
    if skew_ppm is not None:
        prior_ppm = float(np.sum(model.deviations)) / PPM
        reason = (
            f"camera 2's clock fits better with a skew of {skew_ppm:+.0f} ppm than with a jump, far"
            f" beyond the prior deviation of {prior_ppm:g} ppm: give a larger one (--skew-prior)"
        )
        too_fast = refused(estimate, Refusal(Status.POOR_FIT, reason))
        return too_fast if prior_ppm > 0.0 else replace(too_fast, against_skew=np.inf)
    before_s = float(model.clock(found).cam2_from_cam1(at_s)) - at_s
    return jumped(estimate, ClockJump(at_s, size_s, std_s, before_s, before_s + size_s))


def _likely(residuals: Residuals, rules: ClockRules) -> float | None:
    """Find the instant [s] of the most significant step; None where no step can be a jump."""
    # Errors correlated in time make a step's true deviation larger than the one assumed here.
    times_s = residuals.problem.pairs.times_s
    margin_s = rules.jump_margin_s
    first_s, last_s = float(np.min(times_s)) + margin_s, float(np.max(times_s)) - margin_s
    if not last_s > first_s:
        return None
    n = min(int((last_s - first_s) / rules.jump_step_s) + 1, rules.max_tried)
    tried_s = np.linspace(first_s, last_s, n)
    system, target = residuals.system()
    left = -target
    # A step moves later pairs as the offset, the first parameter, does; priors' rows stay zero.
    steps: Array = np.zeros((len(system), n))
    steps[: len(times_s)] = system[: len(times_s), :1] * (times_s[:, None] >= tried_s)
    Q = np.linalg.qr(system)[0]
    steps = steps - Q @ (Q.T @ steps)
    norms = np.maximum(np.linalg.norm(steps, axis=0), 1e-9 * np.linalg.norm(left) + 1e-300)
    gains_px = np.abs(left @ steps) / norms
    best = int(np.argmax(gains_px))
    scale_px = robust_deviation(residuals.distances_px)
    return float(tried_s[best]) if gains_px[best] > rules.fewer_sigmas * scale_px else None


def _with_change(problem: Problem, by: Any) -> Problem:
    """Add, as the last column, a change of camera 2's clock by `by` (n,) times the column's value.

    A mask of the later pairs is a step of the offset; the time since t_ref is a skew.
    """
    pairs = problem.pairs
    moves_px = by[:, None] * pairs.v2_px_s
    change = Column(np.zeros_like(pairs.p1_px), moves_px, is_of_clock=True)
    return replace(problem, columns=(*problem.columns, change))


def _better_skew_ppm(
    model: ClockModel, problem: Problem, start: Parameters, stepped: Residuals
) -> float | None:
    """Return the skew [ppm] that fits best without a prior, if better than a step; else None."""
    if len(model.deviations):
        place, skewed = 0, _with_open_skew(problem, start)
    else:  # the start's last column, of the step, is zero
        place, by_skew_too = -1, _with_change(problem, problem.pairs.times_s - model.t_ref_s)
        skewed = linearise(by_skew_too, solve(by_skew_too, start).parameters)
    scale_px = max(robust_deviation(stepped.distances_px), 1e-12)
    by_skew, by_step = (
        np.sum(np.log1p((one.distances_px / scale_px) ** 2)) for one in (skewed, stepped)
    )
    return float(skewed.parameters.columns[place]) / PPM if by_skew < by_step else None


def _with_open_skew(problem: Problem, start: Parameters, **how: Any) -> Residuals:
    """Fit a problem without the prior of the skew."""
    priors = tuple(prior for prior in problem.priors if prior.place != FIRST_COLUMN)
    open_one = replace(problem, priors=priors)
    return linearise(open_one, solve(open_one, start, **how).parameters)


def _instant(with_step: Problem, found: Parameters, at_s: float, rules: ClockRules) -> float:
    """Find the time [s] from which on the offset after a step fits the pairs better."""
    times_s, (*_, size_s) = with_step.pairs.times_s, found.columns
    plain = replace(with_step, columns=with_step.columns[:-1])
    all_along = _with_change(plain, np.ones(len(times_s)))
    margin_s = rules.jump_margin_s
    first_s, last_s = np.min(times_s) + margin_s, np.max(times_s) - margin_s
    inside = np.abs(times_s - at_s) <= rules.jump_near_s
    inside &= (times_s >= first_s) & (times_s <= last_s)
    order = np.flatnonzero(inside)[np.argsort(times_s[inside], kind="stable")]
    scale_px = robust_deviation(linearise(with_step, found).distances_px)
    losses = []
    for step_s in (0.0, size_s):
        columns = np.append(found.columns[:-1], step_s)
        left_px = linearise(all_along, replace(found, columns=columns)).distances_px[order]
        losses.append(np.log1p((left_px / max(scale_px, 1e-12)) ** 2))
    total = np.concatenate([[0.0], np.cumsum(losses[0] - losses[1])])
    return float(times_s[order][min(int(np.argmin(total)), len(order) - 1)]) if len(order) else at_s


def with_coarse_skew(start: Estimate, views: TwoViews) -> Estimate:
    """Repeat the search with other skews, where the prior allows skews that matter.

    Where clocks may differ much, no single offset fits both ends of a long recording. So the
    search, which gave the start with clocks alike, is repeated with skews so close together that
    the ends hardly differ. The estimate that fits best is returned, or the start where none fits.
    """
    first_s, last_s = _common_s(start, views)
    half_s, t_ref_s = 0.5 * (last_s - first_s), 0.5 * (first_s + last_s)
    rules, found = views.rules.clock, [start]
    step_s = 2.0 * rules.max_end_s
    most_s = rules.skew_sigmas * PPM * views.config.prior_ppm * half_s
    if not (views.config.search_skews and most_s > step_s):
        return start
    search = algorithm_1 if views.pose_is_known else algorithm_2
    n = int(min(np.ceil(most_s / step_s), rules.max_skews // 2))
    skews_ppm = np.arange(-n, n + 1) * (step_s / (PPM * half_s))
    for skew_ppm in skews_ppm[skews_ppm != 0.0].tolist():
        one = search(views.under(Clock(0.0, skew_ppm, t_ref_s)))
        middle_s = 0.5 * sum(_common_s(one, views))
        t_d_s = one.t_d_s + PPM * skew_ppm * (middle_s - t_ref_s)
        found.append(replace(one, t_d_s=t_d_s, skew_ppm=skew_ppm, t_ref_s=middle_s))
    fitting = Status.OK, *SETTLED_BY["joint"]
    fits = [one for one in found if one.status in fitting and np.isfinite(one.d_avg_px)]
    return min(fits, key=lambda one: one.d_avg_px, default=start)


def _common_s(estimate: Estimate, views: TwoViews) -> tuple[float, float]:
    """Start and end [s] of the common time at an estimate's offset, else at mid-interval."""
    known = np.isfinite(estimate.t_d_s)
    return views.common_s(float(estimate.t_d_s if known else np.mean(views.config.offsets_s)))
