"""What else may explain recordings that give nothing, or little, as they were asked about.

Nobody should need an option for what can be found out: clocks far apart, fast ones and those that
wander; objects that give few events, or are several; a rig whose intrinsics are less certain than
it says. What the config asks for is kept, and nothing is tried where the default gives an answer,
but for a skew or a rig that is in doubt.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from ssac.camera import Rig, same_camera
from ssac.config import Config
from ssac.estimate import SETTLED_BY, Estimate, Status
from ssac.rules import RetryRules, VerdictRules
from ssac.track.clean import Clean

FAST, WANDERING = "fast", "pieces"
"""Clocks of one skew far beyond that of oscillators; and of phones, whose skew changes."""


def lies_elsewhere(asked: Config, found: Estimate) -> bool:
    """Whether an interval that nobody asked for gave nothing, and other offsets may."""
    is_asked = asked.interval_s is not None or asked.rates is not None or asked.search != "auto"
    return not is_asked and found.status in SETTLED_BY["all offsets"]


def is_truer(wider: Estimate, found: Estimate) -> bool:
    """Whether a search of all offsets says more than that an interval held none."""
    of_interval = (Status.NO_COMMON_TIME, Status.SEARCH_BOUND, Status.NO_MATCH)
    return found.status in of_interval and wider.status == Status.NO_MATCH


def other_clocks(
    asked: Config, config: Config, of_track: bool, found: Estimate
) -> Iterator[tuple[str, Config]]:
    """Name the clocks to be tried where the usual one fits ill, with the config of each."""
    rules = config.rules.retry
    if not config.prior_ppm > 0.0:
        return
    is_far = abs(found.skew_ppm) > rules.far_skew * config.prior_ppm
    if asked.skew_prior_ppm is None and not of_track:
        if is_far or found.status in SETTLED_BY[FAST]:
            yield FAST, replace(config, skew_prior_ppm=rules.fast_ppm)
    elif asked.clock == "auto" and of_track and found.status in SETTLED_BY[WANDERING]:
        rougher = (one for one in rules.roughnesses_ppm if one > config.roughness_ppm)
        for roughness_ppm in (config.roughness_ppm, *rougher):
            yield WANDERING, replace(config, clock=WANDERING, roughness_ppm=roughness_ppm)


def is_settled_by(by_other: Estimate, found: Estimate, clock: str, rules: RetryRules) -> bool:
    """Whether another clock's answer holds; a fast one must be faster than a jump looks."""
    is_slow = abs(by_other.skew_ppm) < rules.least_fast_ppm
    return by_other.has_offset and not (
        clock == FAST and found.status == Status.CLOCK_JUMP and is_slow
    )


def other_ways(asked: Config, cleans: tuple[Clean, Clean], found: Estimate) -> Iterator[Config]:
    """Give other ways to see the object: closer, over longer windows, of fewer events."""
    of_events, plain, rules = [one for one in cleans if not one.has_track], Config(), asked.rules
    if not of_events:
        return
    if (
        asked.choose_object
        and rules.objects == plain.rules.objects
        and found.status in SETTLED_BY["closer"]
    ):
        yield replace(asked, rules=replace(rules, objects=rules.retry.closer))
    fields = ("half_window_s", "n_min", "denoise", "n_neighbours")
    is_plain = all(getattr(asked, name) == getattr(plain, name) for name in fields)
    if not is_plain or found.status not in SETTLED_BY["few events"]:
        return
    yield replace(asked, half_window_s=rules.retry.longer_s)
    yield replace(asked, n_neighbours=rules.retry.few_neighbours, n_min=rules.retry.fewest)
    backgrounds_hz = [
        0.0 if one.clutter is None else one.clutter.background_hz for one in of_events
    ]
    if max(backgrounds_hz) < rules.retry.quiet_hz:
        longest_s, n_min = rules.retry.longest_s, rules.retry.fewest
        yield replace(asked, half_window_s=longest_s, n_min=n_min, denoise=False)


def by_several(seen: Sequence[Clean], found: Estimate) -> Estimate:
    """Give a refusal of what was left of several things as what it comes from."""
    counts = [one.used.seen for one in seen]
    if max(counts) == 1 or found.status not in SETTLED_BY["one object"]:
        return found
    things = " and ".join(str(count) for count in counts)
    reason = (
        f"the cameras see {things} things at a time, and what is left of one of them does not"
        f" do ({found.reason}): record one object, or mask the others"
    )
    return replace(found, status=Status.SEVERAL_OBJECTS, reason=reason)


def doubt_from(rig: Rig, rules: VerdictRules) -> float:
    """How much must speak against a rig that it counts as less certain; more if it states that."""
    states = rig.cam1.states_intrinsics or rig.cam2.states_intrinsics
    return rules.max_against if states else rules.in_doubt


def less_certain(rig: Rig, found: Estimate, rules: VerdictRules) -> Rig:
    """Give a rig that is as uncertain as an estimate says, as far as that is ordinary.

    What hardly speaks against a rig may be of far other intrinsics, too; what speaks clearly is
    refused where these are not as near as those of a careless calibration.
    """
    is_clear, cameras = found.against > rules.max_against, []
    for camera in (rig.cam1, rig.cam2):
        focals_px = np.diag(camera.K)[:2]
        most_px = np.array([*rules.least_focal * focals_px, *2 * [rules.least_centre_px]])
        stds_px = np.array(camera.intrinsics_std_px)
        wider_px = max(found.shift, 1.0) * stds_px
        if is_clear:
            wider_px = np.maximum(stds_px, np.minimum(wider_px, most_px))
        cameras.append(replace(camera, intrinsics_std_px=tuple(wider_px.tolist())))
    return Rig(cameras[0], cameras[1], rig.T_2_1)


def usual_mistake(
    rig: Rig, cleans: tuple[Clean, Clean], found: Estimate
) -> tuple[str, Rig, tuple[Clean, Clean]] | None:
    """Give the mistake in a rig that may explain a refusal, and all as if it were mended."""
    one, other = cleans
    if found.status not in SETTLED_BY["rig"]:
        return None
    if rig.T_2_1 is not None:
        inverse = np.linalg.inv(rig.T_2_1).astype(np.float64)
        hint = "the rig's transform leads the other way: give its inverse, x2 = T x1"
        return hint, replace(rig, T_2_1=inverse), cleans
    sizes = {(clean.camera.width, clean.camera.height) for clean in cleans}
    if same_camera(one.camera, other.camera) or len(sizes) > 1:
        return None
    hint = "the intrinsics of the cameras are exchanged in the rig: exchange them"
    exchanged = replace(one, camera=other.camera), replace(other, camera=one.camera)
    return hint, Rig(rig.cam2, rig.cam1), exchanged
