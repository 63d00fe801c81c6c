"""The start of a method where no offset is known: a rough offset and clock rate, or a refusal.

The search over all offsets (`ssac.search.all_offsets`) finds a rough offset and rate of camera 2's
clock. A method is then given camera 2 on a clock without that rate, and searches near that offset;
its estimate is converted back to camera 2's own clock. If no offset matches, that clock may jump.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ssac.arrays import IntArray
from ssac.clock import PPM
from ssac.config import Config, Interval
from ssac.estimate import ClockJump, Estimate, Refusal, Status
from ssac.events import US_PER_S
from ssac.geometry.epipolar import epipolar_distance, robust_deviation
from ssac.geometry.fundamental import reweighted_fundamental
from ssac.rules import AllOffsetsRules
from ssac.search.all_offsets import AllOffsets, Guess, Progress, search_all_offsets, width_of
from ssac.search.offset_search import FINE_STEP_S, too_little_motion
from ssac.search.two_views import PairsAt, TwoViews
from ssac.track.clean import Clean
from ssac.track.motion import PointMotion


@dataclass(frozen=True)
class Start:
    """The start of a method's search, or why there is none."""

    found: AllOffsets
    refusal: Refusal | None = None
    tried_rates: bool = False  # rates were searched or refined, so the guess's is about right

    @property
    def guess(self) -> Guess:
        """The best offset of all."""
        return self.found.guesses[0]

    @property
    def anchor_s(self) -> float:
        """Camera 2's clock at the reference time of the guess."""
        return self.guess.t_ref_s + self.guess.t_d_s

    @property
    def words(self) -> str:
        """Say what the search over all offsets found."""
        if not self.found.guesses:
            return "no offset leaves enough common path"
        guess, others, n = self.guess, self.found.guesses[1:], len(self.found.candidates_s)
        said = f"{n} offsets, {self.found.step_s:.3g} s apart: {guess.t_d_s:.2f} s"
        if guess.rate != 1.0:
            said += f", camera 2's clock {guess.rate:.6g} times as fast"
        if others:
            said += f"; the next best fits {others[0].cost / guess.cost:.1f} times worse"
        return said

    def config(self, config: Config) -> Config:
        """Return the config with a search near the guess."""
        rules, t_d_s = config.rules.all_offsets, self.guess.t_d_s
        reach_s = max(rules.reach_s, rules.reach_steps * self.found.step_s)
        return replace(
            config,
            interval_s=(t_d_s - reach_s, t_d_s + reach_s),
            search="interval",
            rates=None,
            max_valley_s=max(config.max_valley_s, 2.0 * reach_s),
            min_swings=min(config.min_swings, rules.unique_swings),
            search_skews=config.search_skews and not self.tried_rates,
        )

    def as_seen(self, cam2: Clean) -> Clean:
        """Return camera 2 on a clock without the guess's rate, equal to its own at the anchor."""
        rate, anchor_s, anchor_us = self.guess.rate, self.anchor_s, self.anchor_s * US_PER_S
        if rate == 1.0:
            return cam2

        def shown_us(times_us: IntArray) -> IntArray:
            return np.asarray(np.rint(anchor_us + (times_us - anchor_us) / rate), np.int64)

        seen = cam2.on_clock(shown_us, lambda times_s: anchor_s + (times_s - anchor_s) / rate)
        if not cam2.camera.readout_s:
            return seen
        readout_s = cam2.camera.readout_s / rate
        return replace(seen, camera=replace(cam2.camera, readout_s=readout_s))

    def as_recorded(self, estimate: Estimate) -> Estimate:
        """Convert an estimate to camera 2's own clock.

        When the clock of `as_seen` shows t', camera 2's own shows anchor + rate (t' - anchor).
        """
        rate, anchor_s = self.guess.rate, self.anchor_s
        if rate == 1.0:
            return estimate
        has_skew = bool(np.isfinite(estimate.skew_ppm))
        t_ref_s = estimate.t_ref_s if has_skew else self.guess.t_ref_s
        seen_rate = 1.0 + PPM * estimate.skew_ppm if has_skew else 1.0

        def offset_s(seen_s: Any, at_s: float = t_ref_s) -> Any:
            return rate * seen_s + (rate - 1.0) * (at_s - anchor_s)

        covariance, of_clock, jump = estimate.covariance, estimate.clock_covariance, estimate.jump
        if covariance is not None:
            factors = np.array([rate, 1.0, 1.0, 1.0, 1.0, 1.0])
            covariance = covariance * np.outer(factors, factors)
        if jump is not None:
            before_s, after_s = (offset_s(at, jump.at_s) for at in (jump.before_s, jump.after_s))
            size_s, size_std_s = rate * jump.size_s, rate * jump.size_std_s
            jump = ClockJump(jump.at_s, size_s, size_std_s, before_s, after_s)
        return replace(
            estimate,
            t_d_s=offset_s(estimate.t_d_s),
            t_d_std_s=rate * estimate.t_d_std_s,
            t_ref_s=t_ref_s,
            skew_ppm=(rate * seen_rate - 1.0) / PPM,
            skew_std_ppm=rate * estimate.skew_std_ppm,
            covariance=covariance,
            clock_covariance=None if of_clock is None else rate**2 * of_clock,
            strays_s=rate * estimate.strays_s,
            strays_std_s=rate * estimate.strays_std_s,
            readouts_s=np.where(
                estimate.readouts_std_s == 0.0,  # stated, on its own clock
                estimate.readouts_s,
                estimate.readouts_s * (1.0, rate),
            ),
            readouts_std_s=estimate.readouts_std_s * (1.0, rate),
            jump=jump,
            alternatives_s=offset_s(estimate.alternatives_s),
            candidates_s=offset_s(estimate.candidates_s),
            start=None if estimate.start is None else self.as_recorded(estimate.start),
        )


def start_of(views: TwoViews, rates: Interval | None, progress: Progress) -> Start:
    """Search all offsets, and camera 2's clock rates in a range, for the start of a method."""
    rules = views.rules.all_offsets
    has_track = any(isinstance(motion, PointMotion) for motion in views.motions)
    freedom = rules.rate_freedom if has_track and views.config.prior_ppm > 0.0 else 0.0
    found = search_all_offsets(*views.motions, rules, rates or (1.0, 1.0), freedom, progress)
    refusal = _refusal(found, views.alone.repeats, rules)
    if refusal is not None and found.guesses:
        swings = [  # upper bounds: to and fro in whole recordings, however much is common
            0.0 if view is None else view.swing_hz * float(np.ptp(motion.span_s))
            for motion, view in zip(views.motions, views.alone.views, strict=True)
        ]
        little = too_little_motion(min(swings), rules.unique_swings)
        if little is not None:
            refusal = replace(little, reason=f"{little.reason}; {refusal.reason}")
    return Start(found, refusal, freedom > 0.0 or rates is not None)


_SEEN_TWICE = "the motion repeats itself, as on a circle or helix: fly in all directions, no loop"
_LITTLE_SEEN = (
    "the motion is uniform along a circle or helix, or repeats itself (fly in all directions); the"
    " cameras see different objects, or too little of one flight (record longer; record one flight"
    " with both cameras); or a clock runs at a rate of its own (--rate-range)"
)


def _refusal(found: AllOffsets, repeats: bool, rules: AllOffsetsRules) -> Refusal | None:
    """Refuse views that no offset explains, or several do, as where the path repeats itself."""
    if not found.guesses:
        reason = (
            "at no offset do both cameras see the object move for long enough to compare its paths:"
            " record longer, and record one flight with both cameras"
        )
        return Refusal(Status.TOO_FEW_SAMPLES, reason)
    best = found.guesses[0]
    # Nearer guesses are within reach of the search that follows, which tells them from the best.
    far = [one for one in found.guesses[1:] if abs(one.t_d_s - best.t_d_s) > rules.reach_s]
    rivals = [one for one in far if one.cost < rules.rival * best.cost]
    if best.cost > rules.max_cost and not (rivals and repeats):
        return Refusal(
            Status.NO_MATCH,
            f"at the best of all offsets, {best.t_d_s:.1f} s, the two paths still disagree by"
            f" {100.0 * best.cost:.0f} % of their width: the cameras see different objects or too"
            " little of one flight, a clock jumps, or runs at a rate of its own; record one flight"
            " with both cameras, or give --rate-range",
        )
    if rivals:
        others = ", ".join(f"{guess.t_d_s:.1f}" for guess in rivals[:5])
        return Refusal(
            Status.AMBIGUOUS_OFFSET,
            f"of all offsets {best.t_d_s:.1f} s fits best, and {others} s about as well:"
            f" {_SEEN_TWICE if repeats else _LITTLE_SEEN}",
            best.t_d_s,
            tuple(guess.t_d_s for guess in rivals),
        )
    return None


def large_jump(views: TwoViews) -> ClockJump | None:
    """Find a jump of camera 2's clock that is too large for any one offset to match the views.

    A jump spares one half of the shorter recording. Offset and F of that half are found first; then
    the instant, and the offsets before and after it, that fit best with this F; then the same with
    F of the longer part. A jump is accepted if the shorter part, to which F was not fitted, agrees
    with F as the path of one object does, at one offset of its own only.
    """
    if views.alone.repeats or views.alone.are_straight:
        return None
    half, rules = _half_without_jump(views), views.rules
    if half is None:
        return None
    t_d_s, span_s = half
    jump, cost = ClockJump(np.nan, 0.0, np.nan, t_d_s, t_d_s), np.inf
    for _ in range(rules.clock.large_rounds):
        pairs = views.pairs_at(t_d_s).between(*span_s)
        if len(pairs) < rules.search.min_pairs_of_pose:
            return None
        jump, cost, is_first = _best_jump(views, pairs, jump)
        parts = (jump.before_s, (-np.inf, jump.at_s)), (jump.after_s, (jump.at_s, np.inf))
        t_d_s, span_s = parts[0 if is_first else 1]
    n_swings = min(views.swings(views.pairs_at(at_s).between(*part_s)) for at_s, part_s in parts)
    is_sure = cost <= rules.all_offsets.max_cost and n_swings >= views.config.min_swings
    return jump if is_sure else None


def _half_without_jump(views: TwoViews) -> tuple[float, Interval] | None:
    """Return the offset [s] of the half that matches better, and its span on camera 1's clock."""
    spans_s, rules = [motion.span_s for motion in views.motions], views.rules.all_offsets
    shorter = int(np.ptp(spans_s[1]) < np.ptp(spans_s[0]))
    first_s, last_s = spans_s[shorter]
    middle_s, halves = 0.5 * (first_s + last_s), []
    for start_s, end_s in ((first_s, middle_s), (middle_s, last_s)):
        spans_s[shorter] = start_s, end_s
        found = search_all_offsets(*views.motions, rules, spans_s=(spans_s[0], spans_s[1]))
        if _refusal(found, False, rules) is None:
            best = found.guesses[0]
            late_s = shorter * best.t_d_s
            halves.append((best.cost, best.t_d_s, (start_s - late_s, end_s - late_s)))
    return min(halves)[1:] if halves else None


def _best_jump(views: TwoViews, own: PairsAt, last: ClockJump) -> tuple[ClockJump, float, bool]:
    """Find the jump that best fits F of one part's pairs, near the last one and in a wide range."""
    # Also returned are the cost of the shorter part, infinite if another offset fits it about as
    # well, and whether the longer part is the first.
    rules, (p1_px, p2_px) = views.rules.clock, own.points_px
    F = reweighted_fundamental(p1_px, p2_px)
    width_px = min(width_of(p1_px), width_of(p2_px))
    scale_px = robust_deviation(epipolar_distance(F, p1_px, p2_px)) + 1e-12
    wide_s = np.arange(-rules.large_jump_s, rules.large_jump_s, rules.large_step_s)
    near_s = np.arange(-rules.large_step_s, rules.large_step_s, FINE_STEP_S)
    offsets_s = np.concatenate([own.t_d_s + wide_s, last.before_s + near_s, last.after_s + near_s])
    times_s = views.sample_times(np.array([own.t_d_s]))[0]
    track1 = views.motion1.at(times_s)
    times_s = times_s[track1.valid]
    track2 = views.motion2.at(views.on_clock_2(times_s, offsets_s[:, None]))
    distances_px = epipolar_distance(F, track1.positions_px[track1.valid], track2.positions_px)
    distances_px = np.where(track2.valid, distances_px, width_px)
    losses = np.cumsum(np.log1p((distances_px / scale_px) ** 2), axis=1)
    before, after = losses[:, :-1], losses[:, -1:] - losses[:, :-1]
    k = int(np.argmin(np.min(before, axis=0) + np.min(after, axis=0)))  # last sample before it
    is_first = 2 * k > len(times_s)
    costs = np.median(distances_px[:, k + 1 :] if is_first else distances_px[:, : k + 1], axis=1)
    before_s, after_s = (float(offsets_s[np.argmin(sums[:, k])]) for sums in (before, after))
    size_s, other_s = after_s - before_s, after_s if is_first else before_s
    jump = ClockJump(float(np.mean(times_s[k : k + 2])), size_s, np.nan, before_s, after_s)
    is_other = np.abs(offsets_s - other_s) > 0.5 * abs(size_s)
    is_rivalled = np.any(costs[is_other] < rules.large_rival * np.min(costs))
    return jump, np.inf if is_rivalled else float(np.min(costs)) / width_px, is_first
