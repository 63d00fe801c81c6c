"""Retries with other assumptions, for recordings that give no answer, or a doubtful one.

Nobody should need an option for what can be found out: clocks that are far apart, fast or
wandering; objects that give few events, or several objects; a rig whose intrinsics are less certain
than it says. What the config asks for is kept, and nothing is tried where the default gives an
answer, except for a skew or a rig that is in doubt.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from ssac.camera import Camera, Rig, same_camera, with_deviations
from ssac.config import N_MIN, Config, Interval
from ssac.estimate import POSE_IS_OPEN, SETTLED_BY, Estimate, Refusal, Status
from ssac.methods.method import Method
from ssac.methods.verdict import scaled, with_sure_offset
from ssac.pipeline.answer import Answer
from ssac.rules import DEFAULT_RULES, RetryRules, Rules, VerdictRules
from ssac.track.clean import Clean
from ssac.track.observation import Observation

TINY = "the object is too small for an outline that says more than the mean of its events"

FAST, WANDERING = "fast", "pieces"
"""Clocks of one skew far beyond that of oscillators, and of a changing skew, as of phones."""


def lies_elsewhere(asked: Config, found: Estimate) -> bool:
    """Whether the default interval gave nothing, so that offsets outside it may explain all."""
    return _is_unasked(asked) and found.status in SETTLED_BY["all offsets"]


def needs_fewer_swings(asked: Config, found: Estimate) -> bool:
    """Whether the motion is too little for the interval, but may be enough to search all offsets.

    That comes last: over a short common time chance matches more than over longer windows.
    """
    return _is_unasked(asked) and found.status == Status.TOO_LITTLE_MOTION


def _is_unasked(asked: Config) -> bool:
    return asked.interval_s is None and asked.rates is None and asked.search == "auto"


def narrows(asked: Config, found: Estimate) -> bool:
    """Whether the interval that was asked for may be the reason of a refusal."""
    is_asked = asked.interval_s is not None or asked.search == "interval"
    may_be = Status.SEARCH_BOUND, Status.TOO_LITTLE_MOTION, Status.NO_MATCH, Status.POOR_FIT
    return is_asked and found.status in (*may_be, Status.AMBIGUOUS_OFFSET)


def is_truer(wider: Estimate, found: Estimate) -> bool:
    """Whether the refusal of a search of all offsets says more than that of an interval."""
    is_narrow = found.status in (Status.NO_COMMON_TIME, Status.SEARCH_BOUND)
    says_more = found.status in (Status.NO_MATCH, Status.TOO_LITTLE_MOTION)
    return is_narrow or (says_more and found.status == wider.status)


def other_clocks(
    asked: Config, config: Config, of_track: bool, found: Estimate
) -> Iterator[tuple[str, Config]]:
    """Yield the name and config of each clock to try where the usual one fits poorly."""
    rules = config.rules.retry
    if not config.prior_ppm > 0.0:
        return
    # Tangents may settle at a skew near zero although their start contradicts it: both count. After
    # a search over rates, `skew_ppm` is the whole skew, not only the part that was fitted.
    against = [one.against_skew for one in (found, found.start) if one is not None]
    is_far = max(*against, abs(found.skew_ppm) / config.prior_ppm) > rules.far_skew
    if asked.skew_prior_ppm is None and not of_track:
        if is_far or is_vague(found, rules) or found.status in SETTLED_BY[FAST]:
            yield FAST, replace(config, skew_prior_ppm=rules.fast_ppm)
    elif asked.clock == "auto" and of_track and found.status in SETTLED_BY[WANDERING]:
        rougher = (one for one in rules.roughnesses_ppm if one > config.roughness_ppm)
        for roughness_ppm in (config.roughness_ppm, *rougher):
            yield WANDERING, replace(config, clock=WANDERING, roughness_ppm=roughness_ppm)


def other_rates(asked: Config, cleans: Sequence[Clean], found: Estimate) -> Interval | None:
    """Return the rates of a fast clock to search with all offsets, if events match at none."""
    is_asked = asked.skew_prior_ppm is not None or asked.rates is not None
    is_asked |= asked.interval_s is not None or any(one.has_track for one in cleans)
    is_open = not is_asked and found.status in SETTLED_BY["rates"]
    return asked.rules.retry.fast_rates if is_open else None


def is_settled_by(by_other: Estimate, found: Estimate, clock: str, rules: RetryRules) -> bool:
    """Whether another clock's estimate holds; a fast one must exceed the skew of a mere jump."""
    may_jump = found.status in (Status.CLOCK_JUMP, Status.AMBIGUOUS_OFFSET)
    if clock == FAST and may_jump and abs(by_other.skew_ppm) < rules.least_fast_ppm:
        return False
    return by_other.has_offset and not (is_vague(found, rules) and is_vague(by_other, rules))


def is_vague(found: Estimate, rules: RetryRules) -> bool:
    """Whether the pose is open and the offset vague too, as where all refinements failed."""
    return found.status in POSE_IS_OPEN and not found.t_d_std_s <= rules.vague_s


def is_faint(asked: Config, cleans: tuple[Clean, Clean], found: Estimate) -> bool:
    """Whether to track one faint object in the events, as the usual windows give nothing."""
    if any(one.has_track for one in cleans) or not _has_usual_windows(asked):
        return False
    is_thin = any(one.clutter is not None and one.clutter.n_min < N_MIN for one in cleans)
    return found.status in SETTLED_BY["lost"] or (is_thin and found.status in SETTLED_BY["thin"])


def hidden(
    seen: Observation, cleaned: Clean, found: Clean | None, rules: RetryRules
) -> Refusal | None:
    """Refuse a camera's recording of a faint object, if noise hides too much of it.

    The camera's number is to be put into the reason.
    """
    noise_hz = cleaned.background_hz
    if noise_hz < rules.quiet_hz:
        return None
    reason = f"of {len(seen.events)} events of camera {{}} "
    if found is None or found.track is None:
        reason += "too few keep together to be an object's"
    else:
        start_s, end_s = seen.span_s
        known_s = 1e-6 * rules.followed.bin_us * len(found.track)
        if known_s > rules.min_followed_share * (end_s - start_s):
            return None
        reason += (
            f"{found.n_followed} are surely the object's, which tell where it is in {known_s:.1f} s"
            f" of {end_s - start_s:.1f} s"
        )
    reason += (
        f": no object moves, or noise of {noise_hz:.2g} Hz of each pixel hides it: record it"
        " nearer, with a longer lens or in more light, or lower the sensor's noise"
    )
    return Refusal(Status.NO_MOTION, reason)


def _has_usual_windows(asked: Config) -> bool:
    plain, fields = Config(), ("half_window_s", "n_min", "denoise", "n_neighbours")
    return all(getattr(asked, name) == getattr(plain, name) for name in fields)


def closer_look(asked: Config, cleans: Sequence[Clean], answer: Answer) -> Iterator[Config]:
    """Yield a config that tells apart objects which are closer to each other."""
    is_of_events = not all(one.has_track for one in cleans)
    if is_of_events and answer.estimate.status in SETTLED_BY["closer"]:
        yield from _closer(asked)


def _closer(asked: Config) -> Iterator[Config]:
    rules = asked.rules
    if asked.choose_object and rules.objects == DEFAULT_RULES.objects:
        yield replace(asked, rules=replace(rules, objects=rules.retry.closer))


def other_windows(asked: Config, cleans: Sequence[Clean], answer: Answer) -> Iterator[Config]:
    """Yield configs with longer windows, or with windows of fewer events."""
    of_events, found = [one for one in cleans if not one.has_track], answer.estimate
    if not of_events or not _has_usual_windows(asked):
        return
    rules = asked.rules
    is_noisy = max(one.background_hz for one in of_events) >= rules.retry.quiet_hz
    is_several = found.status == Status.SEVERAL_OBJECTS or answer.sees_several
    is_thin = found.status in SETTLED_BY["few events"]
    # Where the motion repeats itself, outlines tell offsets apart; mean positions may mislead.
    is_for_outlines = answer.method.needs_events and found.status in SETTLED_BY["longer"]
    if is_thin or is_for_outlines or is_vague(found, rules.retry):
        yield replace(asked, half_window_s=rules.retry.longer_s)
    is_hidden = (is_noisy or is_several) and found.status in SETTLED_BY["noise"]
    is_one_of_some = found.status == Status.AMBIGUOUS_OFFSET and len(found.alternatives_s) > 0
    if is_thin or is_hidden or is_one_of_some:
        # Fewer of the object's events are then removed as noise, and it is seen for longer.
        fewer = replace(asked, n_neighbours=rules.retry.few_neighbours, n_min=rules.retry.fewest)
        yield fewer
        is_crowded = found.status in SETTLED_BY["closer"] or answer.sees_several
        if is_crowded and (is_thin or is_hidden):
            yield from _closer(fewer)
    if (is_thin or (is_one_of_some and is_for_outlines)) and not is_noisy:
        longest_s, n_min = rules.retry.longest_s, rules.retry.fewest
        yield replace(asked, half_window_s=longest_s, n_min=n_min, denoise=False)


WAYS = closer_look, other_windows
"""Generators of other configs to try, each called with the answer that the one before left."""


def may_give_start(method: Method, found: Estimate) -> bool:
    """Whether the estimate that a method starts from may replace the method's own refusal."""
    # With a known pose the deviations of joint are less reliable: one of two was 18 of them off.
    is_open = bool(method.keeps_start) and not method.needs_extrinsics
    # Clocks that do not run alike, as they were to, are no fault of the outline's.
    return is_open and found.status in SETTLED_BY["start"] and np.isfinite(found.against_skew)


def by_start(start: Answer, method: Method, rules: Rules) -> Answer:
    """Return the answer that a method starts from, in place of the method's own refusal.

    A branch or another object that touches the outline spoils tangents, and moves the mean of the
    events a little, but by more than its deviations say. These are therefore widened.
    """
    times = rules.retry.start_widened
    estimate = with_sure_offset(scaled(start.estimate, times), rules.verdict)
    estimate = replace(estimate, method=method.name, start=start.estimate)
    why = f"the outline fits poorly, and deviations are {times:g} times as wide"
    return replace(start, method=method, estimate=estimate, of_start=why)


def by_several(seen: Sequence[Clean], found: Estimate) -> Estimate:
    """Turn a refusal of what is left of several objects into one for several objects."""
    counts = [one.used.seen for one in seen]
    if max(counts) == 1 or found.status not in SETTLED_BY["one object"]:
        return found
    things = " and ".join(str(count) for count in counts)
    reason = (
        f"the cameras see {things} things at a time, and what is left of one of them does not"
        f" do ({found.reason}): record one object, or mask the others"
    )
    return replace(found, status=Status.SEVERAL_OBJECTS, reason=reason)


def less_certain(rig: Rig, found: Estimate, rules: VerdictRules) -> Iterator[tuple[Rig, float]]:
    """Yield a doubtful rig with larger deviations, and the limit of `against` for each."""
    states = rig.cam1.states_intrinsics or rig.cam2.states_intrinsics
    is_in_doubt = found.against > (rules.max_against if states else rules.in_doubt)
    is_in_doubt |= found.status == Status.POOR_FIT and not states
    is_slight = not (states or is_in_doubt) and found.against > rules.in_slight_doubt
    if found.status not in (Status.OK, Status.POOR_FIT) or not np.isfinite(found.against_skew):
        return  # the latter: the clock is in doubt
    if is_slight:
        slight = rules.slight_focal, rules.slight_centre_px
        yield _known_to(rig, *slight), rules.max_against_careless[0]
    if is_slight or is_in_doubt:
        for times, most in zip(rules.times_careless, rules.max_against_careless, strict=True):
            yield (
                _known_to(rig, times * rules.careless_focal, times * rules.careless_centre_px),
                most,
            )


def _known_to(rig: Rig, focal: float, centre_px: float) -> Rig:
    def known_to(camera: Camera) -> Camera:
        least_px = with_deviations(camera, focal, centre_px).intrinsics_std_px
        stds_px = np.maximum(camera.intrinsics_std_px, least_px)
        return replace(camera, intrinsics_std_px=tuple(stds_px.tolist()))

    return replace(rig, cam1=known_to(rig.cam1), cam2=known_to(rig.cam2))


def usual_mistake(
    rig: Rig, cleans: tuple[Clean, Clean], found: Estimate
) -> tuple[str, Rig, tuple[Clean, Clean]] | None:
    """Return a mistake in a rig that may explain a refusal, and rig and data without it."""
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
