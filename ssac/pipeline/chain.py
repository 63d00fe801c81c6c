"""The chain of stages from recordings to an estimate, in their order.

    clean x N > one object > views > unusable? > start > search > refinements > pieces if refused
    > camera 2's own clock > rounding > jump if no offset matches > Answer

Each stage is a function of the results of the stages before it, and calls none of them. The command
line, a Python call, every study and the network all use this chain, so that their results agree.
What methods, offsets, pairs and parameters have in common is computed once, and cached.
"""

import sys
from collections.abc import Callable, Hashable, Sequence
from contextlib import AbstractContextManager
from copy import copy
from dataclasses import dataclass, replace
from functools import cache, partial
from itertools import combinations
from typing import Any, TypeVar

import numpy as np
from threadpoolctl import ThreadpoolController

from ssac.camera import Rig, with_usual_centres
from ssac.config import Config, Interval, validated
from ssac.errors import SsacError
from ssac.estimate import SETTLED_BY, Estimate, Refusal, Status
from ssac.events import rounding_variance_s2
from ssac.methods.method import Input, Method
from ssac.methods.verdict import as_certain_as, jumped, quantum_s, widened, with_sure_offset
from ssac.pipeline import retries
from ssac.pipeline.answer import Answer, Log, Stopwatch, held_words, in_fifths, objects_seen, quiet
from ssac.pipeline.opened import (
    IMAGES,
    MEANS,
    CameraInput,
    RigInput,
    Source,
    check_two,
    kind_of,
    opened,
    opened_rig,
)
from ssac.pipeline.registry import choose_method, load
from ssac.search.offset_search import has_common_time, overlapping, unusable
from ssac.search.one_object import one_object
from ssac.search.start import Start, large_jump, start_of
from ssac.search.two_views import TwoViews, views_of
from ssac.track.clean import Clean, clean, followed
from ssac.track.observation import Observation, check_seen

Found = TypeVar("Found")


@dataclass(frozen=True)
class _Pair:
    """The state that the stages hand on, of two cameras under one configuration."""

    method: Method
    places: tuple[int, int]
    cleans: tuple[Clean, Clean]
    seen: tuple[Clean, Clean]  # the same, without the rate of camera 2's clock that a search found
    rig: Rig  # as the method may see it
    config: Config  # with nothing left open
    tries_all: bool  # offsets that leave enough common time; False: those of `config`
    start: Start | None = None


class Chain:
    """Runs methods on the recordings of a rig; its only state is a cache of results."""

    def __init__(
        self,
        cameras: Sequence[CameraInput | Source],
        rig: RigInput,
        config: Config | None = None,
        log: Log = quiet,
    ) -> None:
        """Take the recordings of two or more cameras, in the order of their rig, as `sync` does.

        Of two recordings in files, the noise is not kept in memory. `log` is called with a line of
        progress after each part. SsacError if a parameter makes no sense, or there are more or
        fewer recordings than cameras in the rig.
        """
        if not isinstance(cameras, Sequence):
            raise SsacError(f"cameras: expected a list of recordings, got {kind_of(cameras)}")
        if len(cameras) < 2:
            raise SsacError(f"cameras: expected two recordings or more, got {len(cameras)}")
        self.rig = with_usual_centres(opened_rig(rig, len(cameras)))
        self.sources = opened(cameras, self.rig)
        self.config = validated(config)
        self.watch = Stopwatch(log)
        self._kept: dict[Hashable, Any] = {}
        self._undelayed: tuple[Chain, float] | None = None

    def __len__(self) -> int:
        return len(self.sources)

    def under(self, config: Config | None) -> "Chain":
        """Return a chain of the same recordings under other parameters, which shares the cache."""
        other = copy(self)
        other.config = validated(config)
        return other

    def delayed(self, t_d_s: float) -> "Chain":
        """Return a chain of two cameras as if camera 2's clock had shown `t_d_s` [s] more."""
        if t_d_s == 0.0:
            return self
        at_s, kept = self._kept.get("delayed", (None, {}))
        if at_s != t_d_s:
            kept = {}
            self._kept["delayed"] = t_d_s, kept  # of the last delay only
        other = copy(self)
        other._undelayed, other._kept = (self, t_d_s), kept
        return other

    def name(self, k: int) -> str:
        """Return the name of camera k, counted from 0: its file, or else its number from 1."""
        return self.sources[k].name or f"camera {k + 1}"

    def clean(self, k: int) -> Clean:
        """Return camera k's recording, checked, and denoised if the config asks for it."""
        how = self.config.cleaning
        return self._once(("clean", k, how), lambda: self._clean(k))

    def recorded(self, k: int, frames: str = "") -> Observation:
        """Return camera k's recording as it is, with intensity frames if they are asked for."""
        if self._undelayed is not None:
            chain, t_d_s = self._undelayed
            seen = chain.recorded(k, frames)
            return seen.delayed(t_d_s) if k else seen

        def read() -> Observation:
            seen = self.sources[k].read(frames)
            check_seen(seen, self.name(k))
            return seen

        if frames or len(self) == 2:
            return read()
        return self._once(("recorded", k), read)  # for the network's silhouettes too

    def views(self, i: int = 0, j: int = 1) -> TwoViews:
        """Return both views of two whole recordings, no object chosen, with their rig as given."""
        rig, cleans = self.rig.pair(i, j), (self.clean(i), self.clean(j))
        return replace(self._views(cleans, rig.unposed, self._resolved(i, j)), rig=rig)

    def lacks(self, method: Method, i: int = 0, j: int = 1) -> str:
        """Say what two cameras lack for a method; empty when it can run."""
        seen = [(self.name(k), self.sources[k].has_track) for k in (i, j)]
        said = method.lacks(seen, self.rig.pair(i, j), self.rig.name, self.config)
        if said or method.input is not Input.FRAMES:
            return said
        for k in (i, j):
            frames = self._framed(k, method).frames
            if frames is None or len(frames) == 0:
                return method.without_frames(self.name(k))
        return ""

    def estimate(self, method: str | Method, i: int = 0, j: int = 1) -> Estimate:
        """Give the estimate of `answer`."""
        return self.answer(method, i, j).estimate

    def answer(self, method: str | Method | None = None, i: int = 0, j: int = 1) -> Answer:
        """Find the offset and pose of two cameras, i < j counted from 0, by all stages.

        The method is one of the registry, or its name; None for the best one that both allow. The
        estimate's `status` and `reason` say when and why it is not reliable. SsacError if a
        recording cannot be used, or the method lacks an input that it needs.
        """
        if not 0 <= i < j < len(self):
            raise SsacError(f"cameras {i} and {j}: there are {len(self)}, numbered from 0 on")
        if not isinstance(method, Method):
            method = choose_method(method, has_track=self._has_track(i, j))
        lacks = self.lacks(method, i, j)
        if lacks:
            raise SsacError(lacks)
        load(method)
        with one_thread():
            key = "answer", method, i, j, self.config
            return self._once(key, partial(self._answered, method, (i, j)))

    def _answered(self, method: Method, places: tuple[int, int]) -> Answer:
        """Answer as asked; where the status is not OK, try the other explanations of `retries`."""
        answer = self._asked(method, places)
        if answer.estimate.status == Status.OK or method.input is not Input.TRACKS:
            return answer
        if retries.is_faint(self.config, answer.cleans, answer.estimate) and method.runs:
            answer = self._of_faint(method, places, answer)
            if answer.estimate.has_offset:
                return answer
        seen = [self.clean(k) for k in places]  # before any object was chosen
        for ways in retries.WAYS:
            for way in ways(self.config, seen, answer):
                other = self.under(way)._asked(method, places)
                if other.estimate.status == Status.OK:
                    return other
                if answer.estimate.status in SETTLED_BY["closer"] and other.sees_several:
                    answer = other
        if retries.needs_fewer_swings(self.config, answer.estimate):
            other = self.under(replace(self.config, search="all"))._answered(method, places)
            if other.estimate.status == Status.OK:
                return other
        if retries.may_give_start(method, answer.estimate):
            start = self._answered(choose_method(method.starts_from), places)
            if start.estimate.status == Status.OK:
                given = retries.by_start(start, method, self.config.rules)
                if given.estimate.has_offset:
                    return given
        estimate = answer.estimate
        if estimate.status in SETTLED_BY["jump"]:
            config = self._resolved(*places)
            jump = large_jump(self._views(answer.cleans, answer.rig.unposed, config))
            estimate = estimate if jump is None else jumped(estimate, jump)
        return replace(answer, estimate=retries.by_several(answer.cleans, estimate))

    def _of_faint(self, method: Method, places: tuple[int, int], answer: Answer) -> Answer:
        """Answer from the tracks of a faint object; if that fails, keep or explain the refusal."""
        key = self.config.cleaning, self.config.rules.retry
        both = [self._once(("followed", k, *key), partial(self._followed, k)) for k in places]
        refusals = [(n, refusal) for n, (_, refusal) in enumerate(both, start=1) if refusal]
        if refusals and answer.estimate.status in SETTLED_BY["few events"]:
            number, refusal = refusals[0]
            reason = refusal.reason.format(number)  # of two, or of a network's pair
            estimate = replace(answer.estimate, status=refusal.status, reason=reason)
            answer = replace(answer, estimate=estimate)
        (one, _), (other, _) = both
        if one is None or other is None:
            return answer
        if method.without_tracks:
            method = choose_method(None, method.needs_extrinsics, has_track=True)
        chain = self.under(replace(self.config, choose_object=False))
        found = chain._asked(method, places, (one, other))
        return found if found.estimate.status == Status.OK else answer

    def _followed(self, k: int) -> tuple[Clean | None, Refusal | None]:
        """Track a faint object in one camera's events, with a refusal where noise hides it."""
        rules, cleaned = self.config.rules, self.clean(k)
        with self.watch.part("follow"):
            seen = self.recorded(k)
            found = followed(seen, cleaned, rules.noise, rules.retry.followed)
            return found, retries.hidden(seen, cleaned, found, rules.retry)

    def _asked(
        self, method: Method, places: tuple[int, int], cleans: tuple[Clean, Clean] | None = None
    ) -> Answer:
        """Search the offsets asked for; if none were and the default interval fails, search all."""
        of_tracks, rig = method.input is Input.TRACKS, self.rig.pair(*places)
        cleans = cleans or (self._given(method, places[0]), self._given(method, places[1]))
        check_two(self.name(places[0]), self.name(places[1]), *cleans)
        rig = rig if method.needs_extrinsics else rig.unposed
        tries_all = of_tracks and self._searches_all(*cleans)
        pair = _Pair(method, places, cleans, cleans, rig, self._resolved(*places), tries_all)
        answer = widest = self._of_one(pair)
        if not of_tracks:
            return answer
        wide = replace(pair, tries_all=True)
        if not tries_all and retries.lies_elsewhere(self.config, answer.estimate):
            widest = self._of_one(wide)
            if widest.estimate.has_offset:
                return self._hinted(wide, widest)
            answer = widest if retries.is_truer(widest.estimate, answer.estimate) else answer
        rates = retries.other_rates(self.config, cleans, widest.estimate)
        if rates is not None:
            rated = self._of_one(replace(wide, config=replace(pair.config, rates=rates)))
            rate = 1.0 + 1e-6 * rated.estimate.skew_ppm  # a jump may look faster
            if rated.estimate.has_offset and rates[0] <= rate <= rates[1]:
                return replace(rated, clock=retries.FAST)
        if not tries_all and retries.narrows(self.config, answer.estimate):
            outside = "or the offset lies outside the search: leave out --search, and all are tried"
            answer = answer.because(outside)
        return self._hinted(pair, answer)

    def _hinted(self, pair: _Pair, answer: Answer) -> Answer:
        """Add the usual mistake in a rig to the answer's reason, where mending it explains all."""
        if answer.estimate.has_offset and not answer.misfit:
            return answer
        mistake = retries.usual_mistake(pair.rig, answer.cleans, answer.estimate)
        if mistake is None:
            return answer
        hint, rig, cleans = mistake
        mended = self._compared(replace(pair, rig=rig, cleans=cleans, seen=cleans))
        fits = mended.estimate.against <= pair.config.rules.verdict.in_doubt
        if mended.estimate.status == Status.OK and fits and not mended.misfit:
            return answer.because(f"all agrees if {hint}")
        return answer

    def _of_one(self, pair: _Pair) -> Answer:
        """Answer from the one object that all cameras saw, if the method looks at one object."""
        method, config = pair.method, pair.config
        if method.of_one_object and config.choose_object and method.input is not Input.FRAMES:
            interval_s = None if pair.tries_all else config.offsets_s
            cleans, refusal = self._one_object(pair.places, interval_s)
            pair = replace(pair, cleans=cleans, seen=cleans)
            if refusal is not None:
                return self._refused(pair, refusal)
        if method.input is not Input.TRACKS:
            return self._answer(pair, self._run(pair))
        return self._compared(pair)

    def _compared(self, pair: _Pair) -> Answer:
        """Search the offsets between two views of one object, and refine the best one."""
        cleans, config = pair.cleans, pair.config
        views = self._views(cleans, pair.rig.unposed, config)
        refusal = unusable(views, cleans, None if pair.tries_all else config.offsets_s)
        if refusal is None and pair.tries_all:
            # For straight paths some F fits at any offset: only the speed along them tells it.
            start = None if views.alone.are_straight else self._start(pair, views)
            needs_none = pair.method.needs_extrinsics and config.rates is None
            if start is None or (start.refusal is not None and needs_none):
                whole = overlapping(cleans)
                near = replace(config, interval_s=whole, search="interval", rates=None)
                pair = replace(pair, config=near)
            else:
                pair, refusal = self._from(start, pair), start.refusal
        return self._refined(pair) if refusal is None else self._refused(pair, refusal)

    def _from(self, start: Start, pair: _Pair) -> _Pair:
        """Let a pair be searched about the offsets that a start has found."""
        cleans, config = pair.cleans, pair.config
        pair = replace(pair, start=start)
        if not start.found.guesses:
            return pair
        key = "seen", id(cleans[1]), start.guess.rate, start.anchor_s
        other = self._once(key, partial(start.as_seen, cleans[1]), cleans)
        near = start.config(config)
        if not self._searches_all(*cleans):  # a retry: chance may match a short time
            near = replace(near, min_swings=config.min_swings)
        return replace(pair, seen=(cleans[0], other), config=near)

    def _refined(self, pair: _Pair) -> Answer:
        """Run the method; where it fits poorly, also with other clocks and a less certain rig."""
        found, clock, misfit, tried = self._run(pair), "", "", None
        of_track = self._has_track(*pair.places)
        for name, config in retries.other_clocks(self.config, pair.config, of_track, found):
            other = replace(pair, config=config)
            by_other = self._run(other)
            if retries.is_settled_by(by_other, found, name, config.rules.retry):
                pair, found, clock = other, by_other, name
                break
        for rig, most in retries.less_certain(pair.rig, found, pair.config.rules.verdict):
            other = replace(pair, rig=rig)
            by_other = self._run(other)
            if by_other.has_offset and by_other.against <= most:
                is_slight = found.against <= pair.config.rules.verdict.in_doubt
                is_slight &= found.status == Status.OK
                unlike = "" if is_slight else "as stated, nothing fits"
                misfit, tried = found.misfit or unlike, rig
                is_alike = bool(by_other.without_body) == bool(found.without_body)
                if not misfit and by_other.status == Status.OK and is_alike:
                    found = as_certain_as(by_other, found)  # in slight doubt nothing is moved
                else:
                    pair, found = other, by_other
                break
        views = self._views(pair.seen, pair.rig.unposed, pair.config)
        of_start = retries.TINY if pair.method.keeps(views) else ""
        answer = self._answer(pair, found)
        return replace(answer, clock=clock, misfit=misfit, less_certain=tried, of_start=of_start)

    def _run(self, pair: _Pair) -> Estimate:
        """Run a method, after those it starts from; put the estimate on camera 2's own clock."""
        with self.watch.part("estimate") as say:
            estimate = self._by(pair.method, pair)
            wanders = len(estimate.knots_s) > 0
            say(pair.method.name + (", with a clock that wanders" if wanders else ""))
        return estimate if pair.start is None else pair.start.as_recorded(estimate)

    def _by(self, method: Method, pair: _Pair) -> Estimate:
        """Return the estimate of a method for two cameras, from the cache if it is there."""
        config = pair.config
        if method.input is Input.TRACKS and not method.starts_from and method.runs:
            config = config.searching
        key = "estimate", method, _ids(pair.seen), _of_rig(pair.rig), config
        return self._once(key, lambda: self._found(method, pair), pair.seen)

    def _found(self, method: Method, pair: _Pair) -> Estimate:
        if method.estimate is not None:
            return method.estimate(*pair.seen, pair.rig, pair.config)
        if method.input is not Input.TRACKS:
            return method.function(*pair.seen, pair.config)
        views = self._views(pair.seen, pair.rig.unposed, pair.config)
        # The pair's intrinsics may be less certain, and its pose holds where there is one. A
        # network follows a body in all of its cameras together.
        posed, cleans = method.needs_extrinsics, None if len(self) > 2 else views.cleans
        views = self._once(
            ("given", _ids(pair.seen), _of_rig(pair.rig), pair.config, posed),
            lambda: replace(views, rig=pair.rig, pose_is_known=posed, cleans=cleans),
            pair.seen,
        )
        if not method.starts_from:
            return method.function(views)
        return method.function(self._by(choose_method(method.starts_from), pair), views)

    def _answer(self, pair: _Pair, estimate: Estimate) -> Answer:
        """Make an answer of an estimate, with a wider deviation where times were rounded."""
        hidden_s2 = rounding_variance_s2(*map(quantum_s, pair.cleans))
        rig, seconds = self.rig.pair(*pair.places), dict(self.watch.seconds)
        made_from = pair.method, pair.cleans, rig, pair.config, self.rig.name, pair.start
        found = with_sure_offset(widened(estimate, hidden_s2), pair.config.rules.verdict)
        return Answer(found, *made_from, seconds=seconds, asked_clock=self.config.clock)

    def _refused(self, pair: _Pair, refusal: Refusal) -> Answer:
        said = vars(refusal) | {"alternatives_s": np.array(refusal.alternatives_s)}
        if pair.start is not None:
            found = pair.start.found
            said |= {"candidates_s": found.candidates_s, "costs": found.costs}
        return self._answer(pair, Estimate(pair.method.name, **said))

    def _given(self, method: Method, k: int) -> Clean:
        """Return a camera's recording for a method: cleaned, unless the method takes frames."""
        if method.input is not Input.FRAMES:
            return self.clean(k)
        seen, camera = self._framed(k, method), self.rig.cameras[k]
        if isinstance(seen, Clean):
            return seen
        return Clean(**vars(seen), camera=camera, n_recorded=len(seen.events))

    def _clean(self, k: int) -> Clean:
        if self._undelayed is not None:
            chain, t_d_s = self._undelayed
            there = chain.under(self.config).clean(k)
            return there.delayed(t_d_s) if k else there
        how, name = self.config.cleaning, self.name(k)
        with self.watch.part("read") as say:
            seen = self.recorded(k)
            if isinstance(seen, Clean) and (seen.denoised or not how.denoise):
                return clean(seen, self.rig.cameras[k], how, name)
            say(held_words(seen, name))
        with self.watch.part("denoise") as say:
            found = clean(seen, self.rig.cameras[k], how, name)
            if found.clutter is not None:
                say(f"{name}: {len(found.events)} of {found.n_recorded} events left")
        if len(self) > 2:
            return found  # with all events, which silhouettes need too
        source = self.sources[k]  # a file can be read again; no circle leads through the chain
        return replace(found, recorded=lambda: source.read().events)

    def _framed(self, k: int, method: Method) -> Observation:
        frames = MEANS if method.takes_means else IMAGES

        def framed() -> Observation:
            with self.watch.part("read") as say:
                seen = self.recorded(k, frames)
                say(held_words(seen, self.name(k)))
            return seen

        return self._once(("frames", k, frames), framed)

    def _one_object(
        self, places: tuple[int, int], interval_s: Interval | None
    ) -> tuple[tuple[Clean, Clean], Refusal | None]:
        """Return two recordings of the one object that is chosen for the whole rig, or refuse."""
        config, cleans = self.config, [self.clean(k) for k in range(len(self))]
        if any(self._searches_all(*two) for two in combinations(cleans, 2)):
            interval_s = None

        def chosen() -> tuple[tuple[Clean, ...], Refusal | None]:
            with self.watch.part("objects") as say:
                found = one_object(cleans, config.rules, interval_s)
                if any(len(one.events) for one in cleans):
                    say(objects_seen(*found))
            return found

        every, refusal = self._once(("object", config.cleaning, config.rules, interval_s), chosen)
        two = every[places[0]], every[places[1]]
        lost = [k for k in places if every[k].used.seen > 1 and every[k].used.share == 0.0]
        if refusal is None and lost:
            refusal = Refusal(
                Status.SEVERAL_OBJECTS,
                f"none of the {every[lost[0]].used.seen} things that camera"
                f" {places.index(lost[0]) + 1} sees is the one that the other cameras see: record"
                " one object, or mask the others",
            )
        return two, refusal

    def _searches_all(self, one: Clean, other: Clean) -> bool:
        """Whether all offsets are searched: where asked for, and by default where it is needed."""
        config = self.config
        if config.rates is not None or config.search == "all":
            return True
        if config.interval_s is not None or config.search == "interval":
            return False
        has_track = one.has_track or other.has_track
        return has_track or not has_common_time((one, other), config.offsets_s)

    def _start(self, pair: _Pair, views: TwoViews) -> Start:
        """Search all offsets; of tracks also other rates, if none fits where clocks run alike."""

        def found_at(rates: Interval | None) -> Start:
            with self.watch.part("search") as say:
                start = start_of(views, rates, in_fifths(self.watch.log))
                say(start.words)
            return start

        def found() -> Start:
            start = found_at(pair.config.rates)
            is_open = pair.config.rates is None and pair.config.prior_ppm > 0.0
            is_open &= self._has_track(*pair.places)
            # A repeated path tells no rate either.
            if start.refusal is None or not is_open or views.alone.repeats:
                return start
            other = found_at(pair.config.rules.retry.any_rate)
            return start if other.refusal is not None else other

        return self._once(("start", _ids(pair.cleans), pair.config), found, pair.cleans)

    def _views(self, cleans: tuple[Clean, Clean], rig: Rig, config: Config) -> TwoViews:
        key = "views", _ids(cleans), config.windows, config.offsets_s
        views = self._once(key, lambda: views_of(*cleans, rig, config), cleans)
        return views if views.config == config else replace(views, config=config)

    def _once(self, key: Hashable, make: Callable[[], Found], of: object = None) -> Found:
        """Return the cached value of a key, or make it; `of` keeps what the key names by `id`."""
        if key not in self._kept:
            self._kept[key] = make(), of
        found: Found = self._kept[key][0]
        return found

    def _has_track(self, i: int, j: int) -> bool:
        return self.sources[i].has_track or self.sources[j].has_track

    def _resolved(self, i: int, j: int) -> Config:
        return self.config.resolved(self._has_track(i, j))


def _ids(cleans: tuple[Clean, Clean]) -> tuple[int, int]:
    return id(cleans[0]), id(cleans[1])


def _of_rig(rig: Rig) -> Hashable:
    """Return what may differ between a chain's rigs of two of its cameras."""
    stds_px = rig.cam1.intrinsics_std_px, rig.cam2.intrinsics_std_px
    return stds_px, None if rig.T_2_1 is None else rig.T_2_1.tobytes()


def one_thread() -> AbstractContextManager[Any]:
    """Limit BLAS to one thread: the matrices are so small that more threads only wait."""
    limited: AbstractContextManager[Any] = _blas("scipy.linalg" in sys.modules).limit(limits=1)
    return limited


@cache
def _blas(has_scipy: bool) -> ThreadpoolController:
    """Find the BLAS libraries, which takes milliseconds; again once SciPy has loaded its own."""
    return ThreadpoolController()
