"""What two views, and a search's cost curve, cannot tell, and why.

What an estimate is judged by is in units of the object's own image and motion, so that it holds for
any resolution, speed and size. `docs/refusal.md` says how each case is treated.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ssac.config import Config, Interval
from ssac.estimate import Refusal, Status, first
from ssac.events import US_PER_S
from ssac.geometry.fundamental import second_best
from ssac.rules import SearchRules
from ssac.search.two_views import TwoViews
from ssac.search.view import View
from ssac.track.clean import Clean

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Valley:
    """Neighbouring offsets of low cost."""

    first_s: float
    last_s: float
    least_s: float  # where the cost is least

    @property
    def length_s(self) -> float:
        """From end to end [s]."""
        return self.last_s - self.first_s


def unusable(
    views: TwoViews, cleans: tuple[Clean, Clean], interval_s: Interval | None
) -> Refusal | None:
    """Refuse what no search can use: an object at rest, clocks far apart, too few events.

    The interval of the offsets searched is None for any.
    """
    too_few = [
        _too_few(number, clean, views.config)
        for number, (clean, view) in enumerate(zip(cleans, views.views, strict=True), start=1)
        if view is None  # else there are windows that hold enough
    ]
    apart = None if interval_s is None else _no_common_time(cleans, interval_s)
    return first(at_rest(views.views, views.config.rules.search), apart, *too_few)


def _no_common_time(cleans: tuple[Clean, Clean], interval_s: Interval) -> Refusal | None:
    """Refuse recordings without common time at any offset searched."""
    (start1, end1), (start2, end2) = (one.span_s for one in cleans)
    if has_common_time(cleans, interval_s) or not np.isfinite([start1, start2]).all():
        return None
    low, high, shift_s = *interval_s, start2 - start1
    return Refusal(
        Status.NO_COMMON_TIME,
        f"camera 1 ({start1:.3f} to {end1:.3f} s) and camera 2 ({start2:.3f} to {end2:.3f} s) have"
        f" no common time at any offset between {low:g} and {high:g} s: search where they do, for"
        f" example --search {shift_s - 1.0:.1f} {shift_s + 1.0:.1f}",
    )


def has_common_time(cleans: tuple[Clean, Clean], interval_s: Interval) -> bool:
    """Whether two recordings have common time at any offset of an interval."""
    (start1, end1), (start2, end2) = (one.span_s for one in cleans)
    return interval_s[0] < end2 - start1 and start2 - end1 < interval_s[1]


def _too_few(number: int, clean: Clean, config: Config) -> Refusal | None:
    """Refuse events of which no window holds enough for a position."""
    if clean.has_track:
        return None
    n, n_min = len(clean.events), clean.n_min(config.n_min)
    left = f"denoising left {n} of {clean.n_recorded} events"
    if clean.clutter is not None and clean.clutter.masked_events:
        left += f", of which {clean.clutter.masked_events} were of lamps and hot pixels"
    if n == 0:
        return Refusal(
            Status.TOO_FEW_SAMPLES,
            f"camera {number}: {left}: check that an object moves in this recording and that its"
            " times are in the unit of its format, or try --no-denoise",
        )
    t_us, window_us = clean.events["t"], 2 * config.half_window_s * US_PER_S
    if n >= n_min and np.min(t_us[n_min - 1 :] - t_us[: n - n_min + 1]) <= window_us:
        return None
    return Refusal(
        Status.TOO_FEW_SAMPLES,
        f"camera {number}: no window of {window_us / 1e3:g} ms holds {n_min} events"
        f"{f' ({left})' if clean.denoised else ''}: record closer to the object, or give a smaller"
        " --n-min or a longer --half-window",
    )


def at_rest(views: tuple[View | None, View | None], rules: SearchRules) -> Refusal | None:
    """Refuse an object that hardly leaves its own outline, in either view."""
    for number, view in enumerate(views, start=1):
        if view is not None and view.extent_px <= rules.min_extent * view.size_px:
            return Refusal(
                Status.NO_MOTION,
                f"in camera {number} the object moves by {view.extent_px:.1f} px rms only, of its"
                f" own rms size of {view.size_px:.1f} px: it is at rest, or lost in noise",
            )
    return None


def coarsest_step(views: tuple[View | None, View | None], rules: SearchRules) -> int:
    """First step of the search, in fine steps: shorter for motion that turns back more often."""
    swing_hz = max((view.swing_hz for view in views if view is not None), default=0.0)
    steps = rules.coarsest_steps * rules.ordinary_swing_hz / max(swing_hz, 1e-12)
    return int(np.clip(steps, rules.least_coarse_steps, rules.coarsest_steps))


def too_little_motion(n_swings: float, least: float) -> Refusal | None:
    """Refuse a path too short to tell an offset and a pose from chance."""
    if n_swings >= least:
        return None
    return Refusal(
        Status.TOO_LITTLE_MOTION,
        f"the object goes to and fro {n_swings:.1f} times while both cameras see it, and"
        f" {least} are needed to tell offset and pose: record longer, or a livelier flight",
    )


def no_match(distance_px: float, object_px: float, rules: SearchRules) -> Refusal | None:
    """Refuse what fits the two views no better than two unrelated paths."""
    if not distance_px > rules.max_residual * object_px:
        return None
    return Refusal(
        Status.NO_MATCH,
        f"at the best offset the two paths still disagree by {distance_px:.1f} px, and the object's"
        f" rms size is {object_px:.1f} px: the cameras see different objects, or the offset lies"
        " outside the search",
    )


def open_fundamental(p1_px: Array, p2_px: Array, rules: SearchRules) -> Refusal | None:
    """Refuse the pose of pairs (n, 2) [px] that another F fits nearly as well as the best."""
    if second_best(p1_px, p2_px) >= rules.min_second_best:
        return None
    return Refusal(
        Status.DEGENERATE_POSE,
        "the path lies near a plane, or near another surface on which many fundamental matrices"
        " fit as well: F leaves the pose open",
    )


def valleys(candidates_s: Array, costs: Array, t_d_s: float, rules: SearchRules) -> list[Valley]:
    """Pieces of low cost of a curve, that of `t_d_s`, the offset of least cost, first.

    The curve (M,) has ascending offsets [s]; NaN costs are left out.
    """
    known = np.isfinite(costs)
    candidates_s, costs = candidates_s[known], costs[known]
    here = int(np.argmin(np.abs(candidates_s - t_d_s)))
    low = np.flatnonzero(costs < rules.rival * costs[here])
    if len(low) == 0:  # at a cost of zero
        return [Valley(t_d_s, t_d_s, t_d_s)]
    ends = np.flatnonzero(np.diff(candidates_s[low]) > rules.one_valley_s)
    found = [
        Valley(
            float(candidates_s[piece[0]]),
            float(candidates_s[piece[-1]]),
            float(candidates_s[piece[np.argmin(costs[piece])]]),
        )
        for piece in np.split(low, ends + 1)
    ]
    return sorted(
        found, key=lambda valley: not valley.first_s <= candidates_s[here] <= valley.last_s
    )


def ambiguous_offset(found: list[Valley], longest_s: float) -> Refusal | None:
    """Refuse a cost curve with several valleys as deep as each other, or one without an end."""
    alternatives_s = sorted(valley.least_s for valley in found[1:])
    if alternatives_s:
        return Refusal(Status.AMBIGUOUS_OFFSET, other_offsets(alternatives_s))
    if found[0].length_s > longest_s:
        return Refusal(
            Status.AMBIGUOUS_OFFSET,
            f"all offsets from {found[0].first_s:.2f} to {found[0].last_s:.2f} s fit alike: uniform"
            " motion along a line, circle or helix does not tell the offset",
        )
    return None


def other_offsets(alternatives_s: list[float]) -> str:
    """Say which other offsets fit as well."""
    named = ", ".join(f"{offset_s:.3f}" for offset_s in alternatives_s[:5])
    more = f" and {len(alternatives_s) - 5} more" if len(alternatives_s) > 5 else ""
    return (
        f"other offsets fit about as well: {named} s{more}; the motion repeats itself, or is"
        " uniform along a circle or helix"
    )
