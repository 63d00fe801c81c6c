"""Both views, an offset and a pose in, pairs of points where epipolar planes touch the object out.

The two tangent epipolar planes of each view, at even times, and the points where they touch: those
of one side in both views are a pair, as `ssac.methods.tangency` explains.
"""

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from ssac.errors import SsacError
from ssac.fit.problem import Parameters, WeighedPairs
from ssac.geometry.pencil import pencils
from ssac.search.two_views import TwoViews
from ssac.track.motion import ObjectMotion
from ssac.track.outline import OutlineConfig, OutlineEvents, Tangents, near_outline, tangents

Array = NDArray[np.float64]


@dataclass(frozen=True)
class TangencyConfig:
    """How tangents are used; `docs/tangency.md` has what other values give."""

    outline: OutlineConfig = field(default_factory=OutlineConfig)
    step_s: float = 0.020  # between samples, each with two tangents, whatever `n_samples` is
    cauchy: float = 0.5  # where the loss turns, in robust standard deviations
    wider_cauchy: float = 1.2  # the same, as long as a round still moves the estimate far
    sharp_px: float = 0.05  # error of a tangent that is not blurred at all
    apart: bool = True  # each tangent is a pair; else the point midway between the two is


def for_blind(config: TangencyConfig, views: TwoViews) -> TangencyConfig:
    """Look for the outline in a way that bears a camera that is blind now and then, if one is.

    The mean of a window's events then has another time than the window's middle, and the course
    about which tangents are found would go to and fro. A rough window would be blind on one side.
    """
    if not any(len(blind.spans_us) for blind in views.blind):
        return config
    longest_s = max(config.outline.rough_half_window_s, config.outline.half_window_s)
    outline = replace(config.outline, centred=True, rough_half_window_s=longest_s)
    return replace(config, outline=outline)


def tangent_times(views: TwoViews, t_d_s: float, config: TangencyConfig) -> Array:
    """Even times [s] of camera 1's clock that both recordings cover."""
    (start,), (end,) = views.overlap_s(np.array([t_d_s]))
    n = max(int((end - start) / config.step_s), 2)
    return np.asarray(start + config.step_s * np.arange(n))


def tangents_under(
    parameters: Parameters,
    views: TwoViews,
    times_s: Array,
    config: TangencyConfig,
    near: list[list[OutlineEvents]] | None = None,
) -> tuple[WeighedPairs, list[list[OutlineEvents]]]:
    """Find and pair the tangents of both views under an offset and a pose.

    Parameters
    ----------
    parameters
        The offset and the pose.
    views, config
        As for `refine_tangents`.
    times_s
        Shape (n,) [s], even, in camera 1's clock.
    near
        The events near each view's outline, from an earlier call with parameters like these; found
        anew when None.

    Returns
    -------
    tuple
        The pairs, and the events near the outlines.
    """
    rig = views.rig
    sides = list(
        zip(
            _of_events(views),
            pencils(parameters.R, parameters.t, rig.cam1.K, rig.cam2.K),
            (times_s, views.on_clock_2(times_s, parameters.t_d_s)),
            strict=True,
        )
    )
    if near is None:
        near = [near_outline(*side, config.outline) for side in sides]
    found = [
        tangents(motion, events, pencil, clock_s, config.outline)
        for (motion, pencil, clock_s), events in zip(sides, near, strict=True)
    ]
    return tangent_pairs(times_s, found[0], found[1], parameters.t_d_s, config), near


def _of_events(views: TwoViews) -> tuple[ObjectMotion, ObjectMotion]:
    """Give both motions, without a line that holds the object; SsacError for a track of points.

    A track has no outline. That of the object is not the line's, whose end has no place.
    """
    one, other = views.motion1, views.motion2
    if not (isinstance(one, ObjectMotion) and isinstance(other, ObjectMotion)):
        raise SsacError(
            "tangents are found among events, and a camera gave a track of points: use joint"
        )
    return one.bare or one, other.bare or other


def tangent_pairs(
    times_s: Array,
    view1: list[Tangents],
    view2: list[Tangents],
    t_d_s: float,
    config: TangencyConfig,
) -> WeighedPairs:
    """Pair the tangents of each side, sampled `t_d_s` apart at n instants, where both are valid.

    Their weights are the inverse of the error that the blur of both outlines lets one expect.
    """
    if not config.apart:
        view1, view2 = [_midway(*view1)], [_midway(*view2)]
    sides = list(zip(view1, view2, strict=True))
    both = [one.valid & two.valid for one, two in sides]
    errors_px = np.concatenate(
        [
            np.sqrt(config.sharp_px**2 + one.spreads_px[k] ** 2 + two.spreads_px[k] ** 2)
            for (one, two), k in zip(sides, both, strict=True)
        ]
    )
    return WeighedPairs(
        np.concatenate([times_s[k] for k in both]),
        np.concatenate([one.points_px[k] for (one, _), k in zip(sides, both, strict=True)]),
        np.concatenate([two.points_px[k] for (_, two), k in zip(sides, both, strict=True)]),
        np.concatenate([two.velocities_px_s[k] for (_, two), k in zip(sides, both, strict=True)]),
        np.median(errors_px) / errors_px if len(errors_px) else errors_px,
        t_d_s,
    )


def _midway(upper: Tangents, lower: Tangents) -> Tangents:
    return Tangents(
        0.5 * (upper.points_px + lower.points_px),
        0.5 * (upper.velocities_px_s + lower.velocities_px_s),
        np.hypot(upper.spreads_px, lower.spreads_px),
        upper.valid & lower.valid,
    )
