"""One camera's recording in the camera's own clock, before any processing."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from ssac.arrays import Array, Events, IntArray
from ssac.errors import SsacError
from ssac.events import EVENT_DTYPE, US_PER_S, check_event_array, copied
from ssac.points import PointTrack

Seen = TypeVar("Seen", bound="Observation")


@dataclass(frozen=True)
class Observation:
    """One camera's events, or a track of points in their place, with intensity frames if any."""

    events: Events  # (n,) of EVENT_DTYPE, sorted by time
    frames: NDArray[np.generic] | None = None  # (m, height, width) intensities, for ZNCC_F
    frame_times_s: Array | None = None  # (m,) [s], ascending
    track: PointTrack | None = None  # in place of events: `events` is then empty
    name: str = ""  # for messages: a file's path; empty: they number the camera

    @property
    def has_track(self) -> bool:
        """Whether the camera gave a track of points."""
        return self.track is not None

    @property
    def span_s(self) -> tuple[float, float]:
        """Times [s] of the first and the last event or point; (inf, -inf) of none."""
        if self.track is not None:
            times_s = self.track.times_s
            return (float(times_s[0]), float(times_s[-1])) if len(times_s) else (np.inf, -np.inf)
        if len(self.events) == 0:
            return np.inf, -np.inf
        start_us, end_us = self.events["t"][[0, -1]]
        return float(start_us) / US_PER_S, float(end_us) / US_PER_S

    def on_clock(
        self: Seen, shown_us: Callable[[IntArray], IntArray], shown_s: Callable[[Array], Array]
    ) -> Seen:
        """Return the observation on another clock, by what it shows at times [us] and [s]."""
        events = copied(self.events)
        events["t"] = shown_us(events["t"])
        times_s, track = self.frame_times_s, self.track
        if times_s is not None:
            times_s = shown_s(times_s)
        if track is not None:
            track = replace(track, times_s=shown_s(track.times_s))
        return replace(self, events=events, frame_times_s=times_s, track=track)

    def delayed(self: Seen, t_d_s: float) -> Seen:
        """Return the observation as if the camera's clock had shown `t_d_s` [s] more.

        Events have times in whole microseconds. The delay is rounded to these for all data alike.
        """
        shift_us = round(t_d_s * US_PER_S)
        return self.on_clock(lambda t_us: t_us + shift_us, lambda t_s: t_s + shift_us / US_PER_S)

    def read(self, frames: str = "") -> "Observation":
        """Return the observation itself: it is in memory, with its frames if there are any."""
        return self


def check_seen(seen: Observation, name: str) -> None:
    """Raise SsacError, starting with `name`, unless all parts of an observation have their type.

    The values of events and points are checked by `clean`.
    """
    track, images, times_s = seen.track, seen.frames, seen.frame_times_s
    check_event_array(seen.events, name)
    if track is not None and not isinstance(track, PointTrack):
        raise SsacError(f"{name}: expected a ssac.PointTrack, got {type(track).__name__}")
    if track is not None and not (
        _is_numeric(track.times_s, 1)
        and _is_numeric(track.points_px, 2)
        and (track.sigmas_px is None or _is_numeric(track.sigmas_px, 1))
    ):
        raise SsacError(
            f"{name}: a track must have times_s (n,), points_px (n, 2) and sigmas_px (n,), or None,"
            " as arrays of numbers: convert them with numpy.asarray"
        )
    if images is None:
        return
    is_stack = isinstance(images, np.ndarray) and images.ndim == 3
    times_shape = () if times_s is None else np.shape(times_s)
    if not is_stack or times_shape != (len(images),):
        raise SsacError(
            f"{name}: frames must be an array (m, height, width), and frame_times_s one of (m,)"
            f" seconds, got {np.shape(images)} and {times_shape}"
        )


def _is_numeric(part: object, n_axes: int) -> bool:
    return isinstance(part, np.ndarray) and part.ndim == n_axes and part.dtype.kind in "fiu"


def tracked(track: PointTrack, name: str = "") -> Observation:
    """Return the observation of a camera of any kind that gave a track in place of events."""
    return Observation(np.empty(0, EVENT_DTYPE), track=track, name=name)
