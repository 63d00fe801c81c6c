"""What is found of camera 2's clock beside its offset: a skew, strays between knots, a jump.

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
from ssac.estimate import SETTLED_BY, ClockJump, Estimate, Refusal, Status
from ssac.fit.least_squares import (
    FIRST_COLUMN,
    T_D,
    Column,
    Parameters,
    Prior,
    Problem,
    Solution,
    WeighedPairs,
    covariance_of,
    linearise,
    solve,
    weighed_system,
)
from ssac.geometry.epipolar import CAUCHY, robust_deviation
from ssac.methods.algorithms import algorithm_1, algorithm_2
from ssac.methods.verdict import refused
from ssac.rules import ClockRules
from ssac.search.two_views import Shutters, TwoViews, shutters_of

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ClockModel:
    """Parameters beside the offset: the skew [s/s], strays by mode [s], readouts [s]; or none."""

    t_ref_s: float  # camera 1's clock
    half_s: float  # length of half the common time
    deviations: Array  # (m,) of what is known of each beforehand
    rules: ClockRules
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

        The views are those that `views` gives for the parameters.
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
        found, held, held_s = solve(problem, start), problem, 1e-6
        for _ in self.shutters.cameras:
            values_s = self.readouts_s(found.parameters)
            bounds_s = self.shutters.within(values_s)
            first = FIRST_COLUMN + len(self.deviations)
            beyond = {first + k: bounds_s[k] for k in np.flatnonzero(values_s != bounds_s)}
            if not beyond:
                break
            priors = [
                Prior(one.place, float(beyond[one.place]), held_s) if one.place in beyond else one
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

    The start's offset gives the common time, and so t_ref, unless it has one.
    """
    (first_s,), (last_s,) = views.overlap_s(np.array([start.t_d_s]))
    half_s = 0.5 * float(last_s - first_s)
    t_ref_s = float(start.t_ref_s if np.isfinite(start.t_ref_s) else 0.5 * (first_s + last_s))
    config, rules = views.config, views.config.rules.clock
    skew = np.array([PPM * config.prior_ppm] if config.prior_ppm > 0.0 else [])
    n_pieces = int(min(np.rint(2.0 * half_s / rules.piece_s), rules.max_pieces))
    if config.clock != "pieces" or n_pieces < 2 or not len(skew):
        return ClockModel(t_ref_s, half_s, skew, rules, shutters=shutters_of(views))
    knots_s: Array = np.linspace(t_ref_s - half_s, t_ref_s + half_s, n_pieces + 1, dtype=np.float64)
    modes, deviations = _modes(knots_s, config.roughness_ppm)
    deviations = np.append(skew, deviations)
    return ClockModel(t_ref_s, half_s, deviations, rules, knots_s, modes, shutters_of(views))


def _modes(knots_s: Array, roughness_ppm: float) -> tuple[Array, Array]:
    """Give modes (k, k - 2) of rms 1 without offset and skew, and their deviations (k - 2,) [s]."""
    k = len(knots_s)
    step_s = float(knots_s[1] - knots_s[0])
    roughness = np.diff(np.eye(k), 2, axis=0) / step_s  # (k - 2, k) changes of the skew
    affine = np.column_stack([np.ones(k), knots_s - np.mean(knots_s)])
    rest = np.linalg.qr(affine, mode="complete")[0][:, 2:]
    amounts, axes = np.linalg.eigh(rest.T @ roughness.T @ roughness @ rest)
    return rest @ axes * np.sqrt(k), PPM * roughness_ppm / np.sqrt(k * amounts)


def checked_clock(
    estimate: Estimate, model: ClockModel, problem: Problem, parameters: Parameters
) -> Estimate:
    """Refuse a refined estimate where camera 2's clock jumps, by its last problem and solution.

    A step of the offset is tried at every second: one more column of the same least squares, so
    that neither the pose nor the skew, which a jump bends as well, hides it. Where the best one is
    beyond chance it is solved for, and moved to the instant from which on the later offset fits
    better.
    """
    rules = model.rules
    problem = replace(problem, turn=CAUCHY)  # a jump is no outlier
    at_s = _likely(problem, parameters, rules)
    if at_s is None:
        return estimate
    with_step, start = problem, parameters
    for _ in range(3):
        with_step = _stepped(problem, at_s)
        found = solve(with_step, start).parameters
        start = replace(found, columns=np.append(found.columns[:-1], 0.0))
        moved_to_s = _instant(with_step, found, at_s, rules)
        if moved_to_s == at_s:
            break
        at_s = moved_to_s
    size_s = float(found.columns[-1])
    covariance = covariance_of(with_step, linearise(with_step, found))
    std_s = float(np.sqrt(covariance[-1, -1]))
    far = rules.far_sigmas * np.min(model.deviations[:1], initial=np.inf)
    is_far = abs(estimate.skew_ppm) * PPM >= far
    least = rules.fewer_sigmas if is_far else rules.jump_sigmas
    if abs(size_s) < max(rules.min_jump_s, least * std_s):
        return estimate
    before_s = float(model.clock(found).cam2_from_cam1(at_s)) - at_s
    jump = ClockJump(at_s, size_s, std_s, before_s, before_s + size_s)
    reason = (
        f"camera 2's clock jumps by {1e3 * size_s:+.1f} ms (1 sigma {1e3 * std_s:.1f} ms) at"
        f" {at_s:.2f} s of camera 1's clock: t_d is {1e3 * jump.before_s:.1f} ms before and"
        f" {1e3 * jump.after_s:.1f} ms after; cut the recordings there,"
        " or give --clock pieces if it rather wanders"
    )
    return replace(refused(estimate, Refusal(Status.CLOCK_JUMP, reason)), jump=jump)


def _likely(problem: Problem, parameters: Parameters, rules: ClockRules) -> float | None:
    """Find the instant [s] where a step tells most; None where it would be no jump in any case."""
    # Errors that are correlated in time make a step's deviation larger than it is taken for here.
    residuals = linearise(problem, parameters)
    times_s = residuals.times_s
    margin_s = rules.jump_margin_s
    first_s, last_s = float(np.min(times_s)) + margin_s, float(np.max(times_s)) - margin_s
    if not last_s > first_s:
        return None
    n = min(int((last_s - first_s) / rules.jump_step_s) + 1, rules.max_tried)
    tried_s = np.linspace(first_s, last_s, n)
    system, target = weighed_system(problem, parameters, residuals)
    left = -target
    # A step moves the later pairs as the offset, the first of the parameters, does, and no prior.
    steps: Array = np.zeros((len(system), n))
    steps[: len(times_s)] = system[: len(times_s), :1] * (times_s[:, None] >= tried_s)
    Q = np.linalg.qr(system)[0]
    steps = steps - Q @ (Q.T @ steps)
    norms = np.maximum(np.linalg.norm(steps, axis=0), 1e-9 * np.linalg.norm(left) + 1e-300)
    gains_px = np.abs(left @ steps) / norms
    best = int(np.argmax(gains_px))
    scale_px = robust_deviation(residuals.distances_px)
    is_large = gains_px[best] > rules.fewer_sigmas * scale_px
    return float(tried_s[best]) if is_large else None


def _stepped(problem: Problem, at_s: float) -> Problem:
    """Add a step of the offset from an instant on, as the last column."""
    pairs = problem.pairs
    later = (pairs.times_s >= at_s)[:, None]
    step = Column(np.zeros_like(pairs.p1_px), later * pairs.v2_px_s, is_of_clock=True)
    return replace(problem, columns=(*problem.columns, step))


def _instant(problem: Problem, found: Parameters, at_s: float, rules: ClockRules) -> float:
    """Find the time [s] from which on the offset after a step fits the pairs better."""
    others, size_s, pairs = found.columns[:-1], found.columns[-1], problem.pairs
    column = Column(np.zeros_like(pairs.p1_px), pairs.v2_px_s, is_of_clock=True)
    all_along = replace(problem, columns=(*problem.columns[:-1], column))
    without, with_it = (
        linearise(all_along, replace(found, columns=np.append(others, step_s)))
        for step_s in (0.0, size_s)
    )
    margin_s = rules.jump_margin_s
    first_s, last_s = np.min(without.times_s) + margin_s, np.max(without.times_s) - margin_s
    inside = np.abs(without.times_s - at_s) <= rules.jump_near_s
    inside &= (without.times_s >= first_s) & (without.times_s <= last_s)
    order = np.argsort(without.times_s[inside], kind="stable")
    left_px = [one.distances_px[inside][order] for one in (without, with_it)]
    scale_px = robust_deviation(linearise(problem, found).distances_px)
    losses = [np.log1p((left / max(scale_px, 1e-12)) ** 2) for left in left_px]
    total = np.concatenate([[0.0], np.cumsum(losses[0] - losses[1])])
    times_s = without.times_s[inside][order]
    return float(times_s[min(int(np.argmin(total)), len(times_s) - 1)]) if len(times_s) else at_s


def with_coarse_skew(start: Estimate, views: TwoViews) -> Estimate:
    """Search anew with other skews, where the prior allows for ones that matter.

    Where clocks may differ by far, over a long recording, no one offset fits both of its ends. So
    the search, whose start had clocks alike, is repeated with skews so near to each other that the
    ends differ by little. Of all the one that fits best is given, or the start where none does.
    """
    skews_ppm = _skews_ppm(start, views) if views.config.search_skews else np.zeros(1)
    if len(skews_ppm) < 2:
        return start
    search = algorithm_1 if views.pose_is_known else algorithm_2
    t_ref_s = _middle_s(start, views)
    found = [start]
    for skew_ppm in skews_ppm[skews_ppm != 0.0].tolist():
        one = search(views.under(Clock(0.0, skew_ppm, t_ref_s)))
        middle_s = _middle_s(one, views)
        t_d_s = one.t_d_s + PPM * skew_ppm * (middle_s - t_ref_s)
        found.append(replace(one, t_d_s=t_d_s, skew_ppm=skew_ppm, t_ref_s=middle_s))
    fitting = Status.OK, *SETTLED_BY["joint"]
    fits = [one for one in found if one.status in fitting and np.isfinite(one.d_avg_px)]
    return min(fits, key=lambda one: one.d_avg_px, default=start)


def _skews_ppm(start: Estimate, views: TwoViews) -> Array:
    """Give the skews to be tried, zero among them."""
    (first_s,), (last_s,) = views.overlap_s(np.array([_offset_s(start, views)]))
    half_s = 0.5 * float(last_s - first_s)
    rules = views.config.rules.clock
    step_s = 2.0 * rules.max_end_s
    most_s = rules.skew_sigmas * PPM * views.config.prior_ppm * half_s
    if not most_s > step_s:
        return np.zeros(1)
    n = int(min(np.ceil(most_s / step_s), rules.max_skews // 2))
    return np.asarray(np.arange(-n, n + 1) * (step_s / (PPM * half_s)), np.float64)


def _middle_s(estimate: Estimate, views: TwoViews) -> float:
    """Middle of the common time at an estimate's offset."""
    (first_s,), (last_s,) = views.overlap_s(np.array([_offset_s(estimate, views)]))
    return 0.5 * float(first_s + last_s)


def _offset_s(estimate: Estimate, views: TwoViews) -> float:
    known = np.isfinite(estimate.t_d_s)
    return float(estimate.t_d_s if known else np.mean(views.config.offsets_s))
