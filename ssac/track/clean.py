"""Check one camera's recording, and remove its noise.

Every search for the object starts from here. Nothing is known yet of the object's motion.
"""

from collections.abc import Callable, Hashable
from dataclasses import dataclass, field, replace
from typing import Any

from ssac.arrays import Array, Events, IntArray, Mask
from ssac.camera import Camera, check_camera, same_camera
from ssac.config import N_MIN, Cleaning
from ssac.events import US_PER_S, check_events, no_gaps
from ssac.points import check_track
from ssac.rules import FaintRules, NoiseRules
from ssac.track.denoise import Clutter, without_noise
from ssac.track.faint import faint_track
from ssac.track.observation import Observation
from ssac.track.thin_line import events_on_line

Recorded = Callable[[], Events]
"""Function that returns all events of a camera; it reads them again if they are in a file."""


@dataclass(frozen=True)
class ObjectsUsed:
    """How many objects one camera saw, and what share of its events is of the one used."""

    seen: int  # number of objects at a time
    share: float  # of the events that belong to the object used


@dataclass(frozen=True, kw_only=True)
class Clean(Observation):
    """One camera's recording, checked against the camera, and denoised if that was asked for."""

    camera: Camera
    n_recorded: int = 0  # events before anything was left out
    denoised: bool = False  # noise is removed from `events`, and is not put back
    clutter: Clutter | None = None  # what denoising did; None: not done, or done elsewhere
    n_followed: int = 0  # events of a faint object, which its track replaces
    gaps_us: IntArray = field(default_factory=no_gaps)
    """Intervals (g, 2) [us], start and end, ascending, in which events of the object were taken out
    with others: a window that reaches into one holds only a part of the object's events."""
    on_line: Mask | None = None
    """Mask (n,) of the events on a thin line that holds the object; None: there is no line."""
    used: ObjectsUsed = ObjectsUsed(1, 1.0)
    recorded: Recorded | None = field(default=None, repr=False, compare=False)
    """Returns all recorded events, with noise; None where the noise was removed for good."""
    kept: dict[Hashable, Any] = field(default_factory=dict, init=False, repr=False, compare=False)
    """Cache of results from these events: each is computed once, and delayed with the events.
    Copies made by `replace` start with an empty cache."""

    def __getstate__(self) -> dict[str, Any]:
        """Leave out of copies the cache, which can be filled again, and the way to a file."""
        return {**vars(self), "recorded": None, "kept": {}}

    def n_min(self, asked: int | None) -> int:
        """Least number of events in a valid window: as asked for, or as denoising found."""
        if asked is not None:
            return asked
        return N_MIN if self.clutter is None else self.clutter.n_min

    @property
    def background_hz(self) -> float:
        """Noise of an ordinary pixel; 0 where none was looked for."""
        return 0.0 if self.clutter is None else self.clutter.background_hz

    def all_events(self) -> Events | None:
        """Return all events (n,) that were recorded; None where the noise was removed for good."""
        if not self.denoised:
            return self.events
        return None if self.recorded is None else self.recorded()

    def on_clock(
        self, shown_us: Callable[[IntArray], IntArray], shown_s: Callable[[Array], Array]
    ) -> "Clean":
        """Return the same on another clock, as of any observation, with an empty cache."""
        read = self.recorded
        return replace(
            super().on_clock(shown_us, shown_s),
            gaps_us=shown_us(self.gaps_us),
            recorded=read and (lambda: Observation(read()).on_clock(shown_us, shown_s).events),
        )

    def delayed(self, t_d_s: float) -> "Clean":
        """Return the same as if the clock had shown `t_d_s` [s] more; the cache is delayed too."""
        later, shift_us = super().delayed(t_d_s), round(t_d_s * US_PER_S)
        later.kept.update({key: value.delayed(shift_us) for key, value in self.kept.items()})
        return later


def clean(seen: Observation, camera: Camera, how: Cleaning, name: str = "camera") -> Clean:
    """Check what a camera recorded, and remove the noise from its events (Sec. IV-A).

    A `Clean` recording is checked again only for another camera, and denoised only if it was not.
    SsacError, with the recording's name or else `name`, if the camera or recording is unusable.
    """
    if not isinstance(seen, Clean):
        seen = _checked(seen, camera, seen.name or name)
    elif not same_camera(seen.camera, camera):
        seen = replace(_checked(seen, camera, seen.name or name), denoised=seen.denoised)
    if seen.denoised or not how.denoise or seen.has_track:
        return seen
    events, size = seen.events, (camera.width, camera.height)
    left, clutter = without_noise(events, *size, how.n_neighbours, how.noise)
    on_line = events_on_line(events, left, *size, how.line)
    left_by = replace(seen, events=left, denoised=True, clutter=clutter, on_line=on_line)
    return replace(left_by, recorded=lambda: events)


def followed(
    seen: Observation, cleaned: Clean, noise: NoiseRules, rules: FaintRules
) -> Clean | None:
    """Replace a camera's events by the track of a faint object; None if there is no such track."""
    camera = cleaned.camera
    found = faint_track(seen.events, camera.width, camera.height, noise, rules)
    if found is None:
        return None
    none, (track, n) = cleaned.events[:0], found
    return replace(cleaned, events=none, track=track, n_followed=n, on_line=None)


def _checked(seen: Observation, camera: Camera, name: str) -> Clean:
    """Check that a recording is usable, and return it as `Clean` with its events unchanged."""
    check_camera(camera, name)
    if seen.track is not None:
        check_track(seen.track, camera.width, camera.height, name)
    else:
        check_events(seen.events, camera.width, camera.height, name)
    if isinstance(seen, Clean):
        return replace(seen, camera=camera)
    n, has_track = len(seen.events), seen.has_track
    return Clean(**vars(seen), camera=camera, n_recorded=n, denoised=has_track)
