"""One camera's recording, checked and without its noise.

Everything that looks for the object starts from here. Nothing of how it moves is known yet.
"""

from collections.abc import Callable, Hashable
from dataclasses import dataclass, field, replace
from typing import Any

from ssac.arrays import Events, IntArray, Mask
from ssac.camera import Camera, check_camera, same_camera
from ssac.config import N_MIN, Cleaning
from ssac.events import US_PER_S, check_events, copied, no_gaps
from ssac.points import check_track
from ssac.rules import FaintRules, NoiseRules
from ssac.track.denoise import Clutter, without_noise
from ssac.track.faint import faint_track
from ssac.track.observation import Observation
from ssac.track.thin_line import events_on_line

Recorded = Callable[[], Events]
"""Gives all events that a camera recorded, read once more where they come from a file."""


@dataclass(frozen=True)
class ObjectsUsed:
    """What became of the things that one camera saw."""

    seen: int  # at a time
    share: float  # of the events, those of the object that was used


@dataclass(frozen=True, kw_only=True)
class Clean(Observation):
    """What one camera recorded, checked against it, and without noise where that was asked for."""

    camera: Camera
    n_recorded: int = 0  # events before anything was left out
    denoised: bool = False  # the noise has left the events: it does not come back
    clutter: Clutter | None = None  # what denoising did; None: nothing, or it was done elsewhere
    n_followed: int = 0  # events of a faint object, in whose place its track stands
    gaps_us: IntArray = field(default_factory=no_gaps)
    """Times (g, 2) [us], ascending, from and up to which events of the object were taken out with
    others: windows that reach into them hold a part of what was seen."""
    on_line: Mask | None = None
    """Which events (n,) lie where a thin line holds the object; None: there is none."""
    used: ObjectsUsed = ObjectsUsed(1, 1.0)
    recorded: Recorded | None = field(default=None, repr=False, compare=False)
    """All that the camera recorded, noise among it; None where that left for good."""
    kept: dict[Hashable, Any] = field(default_factory=dict, init=False, repr=False, compare=False)
    """What was summed up of these events, by what it is: found once, and delayed with them. What
    `replace` makes of this has none."""

    def __getstate__(self) -> dict[str, Any]:
        """Leave to a copy what can be found of the events again, and no way to a file."""
        return {**vars(self), "recorded": None, "kept": {}}

    def n_min(self, asked: int | None) -> int:
        """Events that a window holds at least: as asked for, or as denoising found."""
        if asked is not None:
            return asked
        return N_MIN if self.clutter is None else self.clutter.n_min

    def all_events(self) -> Events | None:
        """Give all events (n,) that the camera recorded; None where the noise left for good."""
        if not self.denoised:
            return self.events
        return None if self.recorded is None else self.recorded()

    def delayed(self, t_d_s: float) -> "Clean":
        """As if the camera's clock had shown `t_d_s` [s] more; what was summed up stays so."""
        later, shift_us = super().delayed(t_d_s), round(t_d_s * US_PER_S)
        recorded = on_clock(self.recorded, lambda times_us: times_us + shift_us)
        later = replace(later, gaps_us=self.gaps_us + shift_us, recorded=recorded)
        later.kept.update({key: value.delayed(shift_us) for key, value in self.kept.items()})
        return later


def on_clock(
    recorded: Recorded | None, shown_us: Callable[[IntArray], IntArray]
) -> Recorded | None:
    """Give what gives events, as if the camera's clock had shown other times [us]."""
    if recorded is None:
        return None

    def shown() -> Events:
        events = copied(recorded())
        events["t"] = shown_us(events["t"])
        return events

    return shown


def clean(seen: Observation, camera: Camera, how: Cleaning, name: str = "camera") -> Clean:
    """Check what a camera recorded, and remove the noise from its events (Sec. IV-A).

    What is clean already stays as it is, but for denoising that was skipped and is asked for now.
    SsacError, of the recording's name or else of `name`, if the camera or what it gave is unusable.
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
    """Put the track of a faint object in place of a camera's events; None where there is none."""
    camera = cleaned.camera
    found = faint_track(seen.events, camera.width, camera.height, noise, rules)
    if found is None:
        return None
    none, (track, n) = cleaned.events[:0], found
    return replace(cleaned, events=none, track=track, n_followed=n, on_line=None)


def _checked(seen: Observation, camera: Camera, name: str) -> Clean:
    """Give what a camera recorded as it is, if it can be used at all."""
    check_camera(camera, name)
    if seen.track is not None:
        check_track(seen.track, camera.width, camera.height, name)
    else:
        check_events(seen.events, camera.width, camera.height, name)
    if isinstance(seen, Clean):
        return replace(seen, camera=camera)
    n, has_track = len(seen.events), seen.has_track
    return Clean(**vars(seen), camera=camera, n_recorded=n, denoised=has_track)
