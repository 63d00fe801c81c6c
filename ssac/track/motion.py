"""Events of one camera in, the object's image position and velocity at any array of times out.

The paper's Sec. IV-A: the object's position at a time is the mean of the undistorted coordinates
of the events in a short window around it. Cumulative sums over the events make each such mean two
binary searches and one difference, so that a search over thousands of offsets stays cheap.
"""

from dataclasses import dataclass, replace

import numba
import numpy as np
from numpy.typing import NDArray

from ssac.camera import Camera, undistortion_map
from ssac.track.denoise import chosen_events, of_pixels

TIE_US = 1e-3
"""Far more than times in seconds lose by rounding, far less than lies between even samples.

Even samples often fall half-way between two microseconds, or on an event. Which one they are taken
for must not depend on the clock's zero.
"""

_EVENTS_PER_SLICE = 16


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

    @property
    def span_s(self) -> tuple[float, float]:
        """Times of the first and last event [s]; the empty interval (inf, -inf) without events."""
        if len(self.times_us) == 0:
            return np.inf, -np.inf
        return float(self.times_us[0]) * 1e-6, float(self.times_us[-1]) * 1e-6

    def delayed(self, shift_us: int) -> "ObjectMotion":
        """As if the camera's clock had shown `shift_us` [us] more."""
        return replace(self, times_us=self.times_us + shift_us)

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
            `max_border_fraction` lie on the border: the two rules of the paper's Sec. IV-A.
        """
        positions_px, counts, on_border = _window_sums(
            self.times_us,
            self.slice_bits,
            self.slice_starts,
            self.position_sums_px,
            self.border_sums,
            times_s.ravel(),
            self.half_window_s,
        )
        valid = (counts >= self.n_min) & (on_border <= self.max_border_fraction * counts)
        shape = times_s.shape
        return Track(
            times_s,
            positions_px.reshape(*shape, 2),
            counts.reshape(shape),
            valid.reshape(shape),
        )

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
        positions[moving], sizes[moving] = _sharp_centres(
            self.times_us,
            self.position_sums_px,
            first,
            last,
            times_s[moving] * 1e6,
            velocities[moving] * 1e-6,
        )
        return SharpTrack(times_s, positions, track.counts, track.valid & moving, velocities, sizes)

    def _indices(self, times_s: NDArray[np.float64], side: int) -> NDArray[np.intp]:
        """Index of the first event at or after each time, moved by -1, 0 or +1 half-windows."""
        wanted_s = (times_s + side * self.half_window_s).ravel()
        indices = _first_from_each(wanted_s, self.times_us, self.slice_bits, self.slice_starts)
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
        means_us = _mean_times_us(self.times_us, first.ravel(), last.ravel())
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
    times_us = np.ascontiguousarray(events["t"])
    position_sums_px, border_sums = _sums(
        events["x"], events["y"], ideal, camera.width, camera.height, border_px
    )
    slice_bits, slice_starts = _slices(times_us)
    return ObjectMotion(
        times_us,
        position_sums_px,
        border_sums,
        slice_bits,
        slice_starts,
        half_window_s,
        n_min,
        max_border_fraction,
    )


def _slices(times_us: NDArray[np.int64]) -> tuple[int, NDArray[np.int32]]:
    """Cut sorted times into slices of 2**bits us, of 16 events or more on average."""
    n = len(times_us)
    if n == 0:
        return 0, np.zeros(1, np.int32)
    length_us = int(times_us[-1]) - int(times_us[0])
    bits = 0
    while (length_us >> bits) * _EVENTS_PER_SLICE > n:
        bits += 1
    bounds_us = times_us[0] + (np.arange(1, (length_us >> bits) + 1, dtype=np.int64) << bits)
    return bits, np.concatenate([[0], np.searchsorted(times_us, bounds_us), [n]]).astype(np.int32)


@numba.njit(cache=True)
def _sums(
    x: NDArray[np.uint16],
    y: NDArray[np.uint16],
    ideal: NDArray[np.float64] | None,
    width: int,
    height: int,
    border_px: int,
) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Sum up positions (n + 1, 2) [px], and the events on the border (n + 1,), before each event.

    The last sums are of all. Where each pixel is imaged without distortion is in `ideal` (height,
    width, 2); None: where it is. One pass, without other arrays as long as the events.
    """
    n = len(x)
    position_sums_px, border_sums = np.zeros((n + 1, 2)), np.zeros(n + 1, np.int32)
    for i in range(n):
        column, row = np.int64(x[i]), np.int64(y[i])
        if ideal is None:
            position_sums_px[i + 1, 0] = position_sums_px[i, 0] + column
            position_sums_px[i + 1, 1] = position_sums_px[i, 1] + row
        else:
            for axis in range(2):
                position_sums_px[i + 1, axis] = position_sums_px[i, axis] + ideal[row, column, axis]
        is_inside = (border_px <= column < width - border_px) and (
            border_px <= row < height - border_px
        )
        border_sums[i + 1] = border_sums[i] + (not is_inside)
    return position_sums_px, border_sums


@numba.njit(cache=True)
def _whole_us(time_s: float) -> np.int64:
    """Round a time to whole microseconds; up, where it is half-way."""
    return np.int64(np.floor(1e6 * time_s + (0.5 + TIE_US)))


@numba.njit(cache=True)
def _first_from(
    time_us: np.int64,
    times_us: NDArray[np.int64],
    slice_bits: int,
    slice_starts: NDArray[np.int32],
) -> int:
    """Index of the first of the sorted times at or after `time_us`.

    As np.searchsorted, but four times as fast: the slice is known at once, and its few times stand
    side by side in memory.
    """
    n_slices = len(slice_starts) - 1
    if n_slices == 0 or time_us <= times_us[0]:
        return 0
    k = (time_us - times_us[0]) >> slice_bits
    if k >= n_slices:
        return len(times_us)
    low, high = slice_starts[k], slice_starts[k + 1]
    while low < high:
        middle = (low + high) >> 1
        if times_us[middle] < time_us:
            low = middle + 1
        else:
            high = middle
    return int(low)


@numba.njit(cache=True)
def _first_from_each(
    wanted_s: NDArray[np.float64],
    times_us: NDArray[np.int64],
    slice_bits: int,
    slice_starts: NDArray[np.int32],
) -> NDArray[np.intp]:
    indices = np.empty(len(wanted_s), np.intp)
    for i in range(len(wanted_s)):
        indices[i] = _first_from(_whole_us(wanted_s[i]), times_us, slice_bits, slice_starts)
    return indices


@numba.njit(cache=True)
def _window_sums(
    times_us: NDArray[np.int64],
    slice_bits: int,
    slice_starts: NDArray[np.int32],
    position_sums_px: NDArray[np.float64],
    border_sums: NDArray[np.int32],
    middles_s: NDArray[np.float64],
    half_window_s: float,
) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.int64]]:
    """Mean positions (n, 2) [px], NaN of none; numbers of events (n,), and of those on the border.

    One pass over the windows: it waits for memory, not for arithmetic.
    """
    n = len(middles_s)
    means = np.empty((n, 2))
    counts, on_border = np.empty(n, np.int64), np.empty(n, np.int64)
    for i in range(n):
        start_us = _whole_us(middles_s[i] - half_window_s)
        end_us = _whole_us(middles_s[i] + half_window_s)
        first = _first_from(start_us, times_us, slice_bits, slice_starts)
        last = _first_from(end_us, times_us, slice_bits, slice_starts)
        counts[i] = last - first
        on_border[i] = border_sums[last] - border_sums[first]
        for axis in range(2):
            total = position_sums_px[last, axis] - position_sums_px[first, axis]
            means[i, axis] = total / counts[i] if counts[i] > 0 else np.nan
    return means, counts, on_border


@numba.njit(cache=True)
def _mean_times_us(
    times_us: NDArray[np.int64], first: NDArray[np.intp], last: NDArray[np.intp]
) -> NDArray[np.float64]:
    """Mean (n,) of the times from `first` up to `last`, since the first of all; NaN of none.

    Not by cumulative sums, as positions are: these means are few, and the sums would take half as
    much memory as the events.
    """
    means = np.full(len(first), np.nan)
    for i in range(len(first)):
        if last[i] > first[i]:
            total = 0
            for k in range(first[i], last[i]):
                total += times_us[k] - times_us[0]
            means[i] = total / (last[i] - first[i])
    return means


@numba.njit(cache=True)
def _sharp_centres(
    times_us: NDArray[np.int64],
    position_sums_px: NDArray[np.float64],
    first: NDArray[np.intp],
    last: NDArray[np.intp],
    middles_us: NDArray[np.float64],
    velocities: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Centres (n, 2) [px] and sizes (n,) [px] of windows' event images; velocities in [px/us]."""
    n = len(first)
    centres, sizes = np.empty((n, 2)), np.empty(n)
    columns = np.empty(np.max(last - first) if n else 0, np.int32)  # each event's cell
    rows = np.empty_like(columns)
    counts = np.zeros(0, np.int32)  # events in each cell; all zero between windows
    for i in range(n):
        n_events = last[i] - first[i]
        times, sums = times_us[first[i] : last[i]], position_sums_px[first[i] : last[i] + 1]
        origin_x = (sums[n_events, 0] - sums[0, 0]) / n_events
        origin_y = (sums[n_events, 1] - sums[0, 1]) / n_events
        left = top = np.int32(1 << 30)
        right = bottom = np.int32(-(1 << 30))
        for j in range(n_events):
            age_us = times[j] - middles_us[i]
            x = sums[j + 1, 0] - sums[j, 0] - velocities[i, 0] * age_us
            y = sums[j + 1, 1] - sums[j, 1] - velocities[i, 1] * age_us
            column, row = np.int32(np.rint(x - origin_x)), np.int32(np.rint(y - origin_y))
            columns[j], rows[j] = column, row
            left, right = min(left, column), max(right, column)
            top, bottom = min(top, row), max(bottom, row)
        width = right - left + 1
        if width * (bottom - top + 1) > len(counts):
            counts = np.zeros(width * (bottom - top + 1), np.int32)
        for j in range(n_events):
            counts[(rows[j] - top) * width + columns[j] - left] += 1
        total, sum_x, sum_y, sum_squares = 0.0, 0.0, 0.0, 0.0
        for j in range(n_events):  # the first event of a cell stands for all of it
            cell = (rows[j] - top) * width + columns[j] - left
            if counts[cell] > 0:
                weight = np.sqrt(counts[cell])
                counts[cell] = 0
                total += weight
                sum_x, sum_y = sum_x + weight * columns[j], sum_y + weight * rows[j]
                sum_squares += weight * (columns[j] ** 2 + rows[j] ** 2)
        x, y = sum_x / total, sum_y / total
        centres[i, 0], centres[i, 1] = origin_x + x, origin_y + y
        sizes[i] = np.sqrt(max(sum_squares / total - x**2 - y**2, 0.0))
    return centres, sizes
