"""Events of one camera in, the object's image position and velocity at any array of times out.

The paper's Sec. IV-A: the object's position at a time is the mean of the undistorted coordinates
of the events in a short window around it. Cumulative sums over the events make each such mean two
binary searches and one difference, so that a search over thousands of offsets stays cheap.
"""

from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ssac.camera import Camera, undistortion_map
from ssac.events import no_gaps
from ssac.track.clutter import chosen_events, of_pixels
from ssac.track.motion_kernels import (
    first_from_each,
    mean_times_us,
    sharp_centres,
    sum_up,
    window_sums,
)

_EVENTS_PER_SLICE = 4


@dataclass(frozen=True)
class Track:
    """The object's image positions at sample times of one camera's clock."""

    times_s: NDArray[np.float64]  # (...,) [s]
    positions_px: NDArray[np.float64]  # (..., 2) undistorted; NaN without events
    counts: NDArray[np.int64]  # (...,) events in the window
    valid: NDArray[np.bool_]  # (...,) passes N_min and the margin rule


@dataclass(frozen=True)
class SharpTrack(Track):
    """As a Track, from event images sharpened by the object's velocity (`sharp_at`)."""

    velocities_px_s: NDArray[np.float64]  # (..., 2)
    sizes_px: NDArray[np.float64]  # (...,) root mean square distance of the image from its position


class Motion(Protocol):
    """One camera's view of the object, to be sampled at any times: of events or of points."""

    @property
    def span_s(self) -> tuple[float, float]:
        """Times of the first and last event or point [s]."""

    def at(self, times_s: NDArray[np.float64]) -> Track:
        """Positions at times (...,) [s]."""

    def velocities_at(self, times_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """Image velocities (..., 2) [px/s] at times (...,) [s]."""

    def sharp_at(self, times_s: NDArray[np.float64]) -> SharpTrack:
        """Sharp positions, velocities and sizes at times (n,) [s]."""


@dataclass(frozen=True)
class ObjectMotion:
    """Cumulative sums over the n events of one camera, from which `at` reads window means."""

    times_us: NDArray[np.int64]  # (n,) [us], sorted
    position_sums_px: NDArray[np.float64]  # (n + 1, 2) of undistorted coordinates [px]
    border_sums: NDArray[np.int32]  # (n + 1,) of events on the border
    slice_bits: int  # the recording is cut into slices of 2**slice_bits us
    slice_starts: NDArray[np.int32]  # (s + 1,) index of the first event in each slice, then n
    half_window_s: float  # [s] on each side of a sample time
    n_min: int  # events a valid sample's window holds at least
    max_border_fraction: float  # of a valid sample's events may lie on the border
    gaps_us: NDArray[np.int64] = field(default_factory=no_gaps)  # (g, 2) as of `Clean`
    bare: "ObjectMotion | None" = None  # without the events where a line holds the object, if so

    @property
    def span_s(self) -> tuple[float, float]:
        """Times of the first and last event [s]; the empty interval (inf, -inf) without events."""
        if len(self.times_us) == 0:
            return np.inf, -np.inf
        return float(self.times_us[0]) * 1e-6, float(self.times_us[-1]) * 1e-6

    def delayed(self, shift_us: int) -> "ObjectMotion":
        """As if the camera's clock had shown `shift_us` [us] more."""
        bare = None if self.bare is None else self.bare.delayed(shift_us)
        times_us, gaps_us = self.times_us + shift_us, self.gaps_us + shift_us
        return replace(self, times_us=times_us, gaps_us=gaps_us, bare=bare)

    def sampled_by(
        self, half_window_s: float, n_min: int, max_border_fraction: float
    ) -> "ObjectMotion":
        """Return the same motion, to be sampled by other rules."""
        rules = half_window_s, n_min, max_border_fraction
        return replace(
            self,
            half_window_s=half_window_s,
            n_min=n_min,
            max_border_fraction=max_border_fraction,
            bare=None if self.bare is None else self.bare.sampled_by(*rules),
        )

    def at(self, times_s: NDArray[np.float64]) -> Track:
        """Sample the object's motion, in about constant time per sample.

        Parameters
        ----------
        times_s
            Shape (...,) [s]: any times of this camera's clock, inside or outside the recording.

        Returns
        -------
        Track
            A sample is valid when its window holds at least `n_min` events, of which at most
            `max_border_fraction` lie on the border: the two rules of the paper's Sec. IV-A. It also
            must not reach into a gap.
        """
        positions_px, counts, on_border = window_sums(
            self.times_us,
            self.slice_bits,
            self.slice_starts,
            self.position_sums_px,
            self.border_sums,
            times_s.ravel(),
            self.half_window_s,
            times_s.shape[-1] if times_s.ndim else 1,
        )
        valid = (counts >= self.n_min) & (on_border <= self.max_border_fraction * counts)
        if len(self.gaps_us):
            valid &= ~self._reach_into_gaps(times_s.ravel())
        shape = times_s.shape
        return Track(
            times_s,
            positions_px.reshape(*shape, 2),
            counts.reshape(shape),
            valid.reshape(shape),
        )

    def centred_at(self, times_s: NDArray[np.float64]) -> Track:
        """Sample as `at` does, times (n,) [s], and move the means to the middle of their windows.

        Where a camera was blind for a part of a window, the mean time of its events is another than
        its middle. Invalid where there is no velocity.
        """
        track, velocities = self.at(times_s), self.velocities_at(times_s)
        first, last = self._indices(times_s, -1), self._indices(times_s, +1)
        origin_s = 1e-6 * self.times_us[0] if len(self.times_us) else 0.0
        ages_s = origin_s + self._mean_times(first, last) - times_s
        positions = track.positions_px - ages_s[:, None] * velocities
        known = np.isfinite(positions[:, 0])
        return replace(track, positions_px=positions, valid=track.valid & known)

    def velocities_at(self, times_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """Image velocity (..., 2) [px/s] at times (...,) [s].

        The difference between the mean positions in the two halves of the window, over the
        difference between their mean times; NaN when a half is empty.
        """
        first, middle, last = (self._indices(times_s, side) for side in (-1, 0, +1))
        shift_px = self._mean_positions(middle, last) - self._mean_positions(first, middle)
        shift_s = self._mean_times(middle, last) - self._mean_times(first, middle)
        return shift_px / shift_s[..., None]

    def sharp_at(self, times_s: NDArray[np.float64]) -> SharpTrack:
        """Sample the object's motion where its image is sharp; not the paper's position.

        How many events a part of the object makes depends on its contrast and on which way it
        moves, and pulls the mean of the events to and fro as the object turns. Here the window's
        events are moved to its middle with the velocity, counted in cells of one pixel, and each
        cell counts by the square root of its events: between the mean of the events and the centre
        of the image's area.

        Parameters
        ----------
        times_s
            Shape (n,) [s].

        Returns
        -------
        SharpTrack
            Validity as in `at`, but invalid and NaN where there is no velocity.
        """
        track, velocities = self.at(times_s), self.velocities_at(times_s)
        moving = np.isfinite(velocities[:, 0])
        positions, sizes = np.full((len(times_s), 2), np.nan), np.full(len(times_s), np.nan)
        first, last = self._indices(times_s, -1)[moving], self._indices(times_s, +1)[moving]
        positions[moving], sizes[moving] = sharp_centres(
            self.times_us,
            self.position_sums_px,
            first,
            last,
            times_s[moving] * 1e6,
            velocities[moving] * 1e-6,
        )
        return SharpTrack(times_s, positions, track.counts, track.valid & moving, velocities, sizes)

    def _reach_into_gaps(self, times_s: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Whether the windows about times (n,) [s] hold a part of a gap."""
        starts_us, ends_us = self.gaps_us.T
        half_us = 1e6 * self.half_window_s
        following = np.searchsorted(ends_us, 1e6 * times_s - half_us, side="right")
        next_us = np.append(starts_us, np.iinfo(np.int64).max)[following]
        return np.asarray(next_us < 1e6 * times_s + half_us)

    def _indices(self, times_s: NDArray[np.float64], side: int) -> NDArray[np.intp]:
        """Index of the first event at or after each time, moved by -1, 0 or +1 half-windows."""
        wanted_s = (times_s + side * self.half_window_s).ravel()
        indices = first_from_each(wanted_s, self.times_us, self.slice_bits, self.slice_starts)
        return indices.reshape(times_s.shape)

    def _mean_positions(
        self, first: NDArray[np.intp], last: NDArray[np.intp]
    ) -> NDArray[np.float64]:
        """Mean position (..., 2) [px] of the events from `first` up to, not including, `last`."""
        with np.errstate(invalid="ignore"):
            sums = self.position_sums_px[last] - self.position_sums_px[first]
            return sums / (last - first)[..., None]

    def _mean_times(self, first: NDArray[np.intp], last: NDArray[np.intp]) -> NDArray[np.float64]:
        """Mean time (...,) [s], counted from the first event, of the same events."""
        means_us = mean_times_us(self.times_us, first.ravel(), last.ravel())
        return means_us.reshape(first.shape) * 1e-6


def object_motion(
    events: NDArray[np.void],
    camera: Camera,
    half_window_s: float = 0.020,
    n_min: int = 200,
    border_px: int = 5,
    max_border_fraction: float = 0.05,
) -> ObjectMotion:
    """Prepare the events of one camera for sampling (the paper's Sec. IV-A).

    Parameters
    ----------
    events
        Events, dtype EVENT_DTYPE, shape (n,), sorted by time and denoised. May be empty: every
        sample is then invalid.
    camera
        Its distortion is removed from the coordinates before they are averaged; events at pixels
        that its lens model cannot undistort are left out.
    half_window_s
        Half the length of the window around a sample time [s].
    n_min
        Events that a valid sample's window holds at least (the paper's N_min).
    border_px
        Width of the border, in raw pixels.
        Deviation: the paper drops what lies "on the image boundary" and gives no width. With 1 px,
        an object 40 px wide loses half of itself before 5 % of its events lie on the border, and
        its mean shifts by pixels; with 5 px it is dropped before it is cut.
    max_border_fraction
        A sample with more of its events on the border is dropped.

    Returns
    -------
    ObjectMotion
        To be sampled with `at`.
    """
    ideal = None
    if camera.distortion_model != "none":
        ideal = undistortion_map(camera)
        known = of_pixels(np.isfinite(ideal[..., 0]), events["x"], events["y"])
        events = events if known.all() else chosen_events(events, known)
    n, (slice_bits, n_slices) = len(events), _slices(events["t"])
    times_us, position_sums_px = np.empty(n, np.int64), np.empty((n + 1, 2))
    border_sums, slice_starts = np.empty(n + 1, np.int32), np.zeros(n_slices + 1, np.int32)
    border = camera.width, camera.height, border_px
    sums = times_us, position_sums_px, border_sums
    sum_up(events["t"], events["x"], events["y"], ideal, border, slice_bits, *sums, slice_starts)
    rules = half_window_s, n_min, max_border_fraction
    return ObjectMotion(*sums, slice_bits, slice_starts, *rules)


def _slices(times_us: NDArray[np.int64]) -> tuple[int, int]:
    """Cut sorted times into slices of 2**bits us, of 4 events or more on average: bits, number."""
    n = len(times_us)
    if n == 0:
        return 0, 0
    length_us = int(times_us[-1]) - int(times_us[0])
    bits = 0
    while (length_us >> bits) * _EVENTS_PER_SLICE > n:
        bits += 1
    return bits, (length_us >> bits) + 1
