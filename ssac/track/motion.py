"""The object's image position and velocity at any times, from one camera's events or track.

The paper's Sec. IV-A: the object's position at a time is the mean of the undistorted coordinates
of the events in a short window around it. Cumulative sums over the events make each such mean two
binary searches and one difference, so that a search over thousands of offsets stays cheap.

A track of points is sampled alike, so that no method need know which of the two it uses: local
parabolas replace means over windows, and noise and image width set the object's size.
"""

from dataclasses import dataclass, field, fields, replace

import numpy as np

from ssac.arrays import Array, Events, Indices, Int32Array, IntArray, Mask
from ssac.camera import Camera, undistort_points, undistortion_map
from ssac.config import Windows
from ssac.errors import SsacError
from ssac.events import first_from, no_gaps
from ssac.geometry.epipolar import robust_deviation
from ssac.points import PointTrack
from ssac.rules import PointRules
from ssac.track.clean import Clean
from ssac.track.denoise import of_pixels
from ssac.track.motion_kernels import local_parabolas_at, mean_times_us, sharp_centres, sum_up

TIE_US = 1e-3
"""A tolerance far above rounding errors of times in seconds, far below the step of even samples:
to which microsecond or event a time half-way is rounded must not depend on the clock's zero."""

HALF_US = 0.5 + TIE_US
"""Added to a time [us] before it is rounded down, so that times half-way are rounded up."""


@dataclass(frozen=True)
class Track:
    """The object's image positions at sample times of one camera's clock."""

    times_s: Array  # (...,) [s]
    positions_px: Array  # (..., 2) undistorted; NaN without events
    counts: IntArray  # (...,) events in the window
    valid: Mask  # (...,) passes N_min and the margin rule


@dataclass(frozen=True)
class SharpTrack(Track):
    """A `Track` from event images that are sharpened by the object's velocity (`sharp_at`)."""

    velocities_px_s: Array  # (..., 2)
    sizes_px: Array  # (...,) root mean square distance of the image from its position

    def of(self, chosen: Mask) -> "SharpTrack":
        """Return only the chosen samples."""
        return SharpTrack(**{one.name: getattr(self, one.name)[chosen] for one in fields(self)})


def motion_of(clean: Clean, how: Windows) -> "Motion":
    """Prepare a camera's object for sampling at any time (Sec. IV-A).

    Sums over its events are cached in `clean`, as only the border's width changes them.
    """
    if clean.track is not None:
        of_events = replace(clean.camera, readout_s=None)  # which no rows delay
        camera = of_events if clean.n_followed else clean.camera
        return point_motion(clean.track, camera, how.points, how.half_window_s)
    if how.border_px not in clean.kept:
        clean.kept[how.border_px] = _summed_up(clean, how.border_px)
    motion: ObjectMotion = clean.kept[how.border_px]
    return motion.sampled_by(how, clean.n_min(how.n_min))


def _summed_up(clean: Clean, border_px: int) -> "ObjectMotion":
    """Sum up all events; also those off the thin line that holds the object, if there is one."""
    events = [clean.events]
    if clean.on_line is not None:
        events.append(clean.events[~clean.on_line])
    whole, *bare = (
        replace(object_motion(some, clean.camera, border_px=border_px), gaps_us=clean.gaps_us)
        for some in events
    )
    return replace(whole, bare=bare[0]) if bare else whole


@dataclass(frozen=True, eq=False)
class ObjectMotion:
    """Cumulative sums over the n events of one camera, from which `at` reads window means."""

    times_us: IntArray  # (n,) [us], sorted
    position_sums_px: Array  # (n + 1, 2) of undistorted coordinates [px]
    border_sums: Int32Array  # (n + 1,) of events on the border
    half_window_s: float = 0.020  # [s] on each side of a sample time
    n_min: int = 200  # events a valid sample's window holds at least
    max_border_fraction: float = 0.05  # of a valid sample's events may lie on the border
    gaps_us: IntArray = field(default_factory=no_gaps)  # (g, 2) as in `Clean`
    bare: "ObjectMotion | None" = None  # without the events on a thin line, if any
    sharp: dict[bytes, SharpTrack] = field(default_factory=dict, init=False, repr=False)
    """Cache of what `sharp_at` found, by its times. Copies made by `replace` start with none."""

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

    def sampled_by(self, how: Windows, n_min: int) -> "ObjectMotion":
        """Return the same motion, to be sampled by other rules."""
        bare = None if self.bare is None else self.bare.sampled_by(how, n_min)
        window_s, most = how.half_window_s, how.max_border_fraction
        return replace(
            self, half_window_s=window_s, n_min=n_min, max_border_fraction=most, bare=bare
        )

    def at(self, times_s: Array) -> Track:
        """Sample the object's motion at times (...,) [s], in about constant time per sample.

        A sample is valid when its window holds at least `n_min` events, of which at most
        `max_border_fraction` lie on the border (Sec. IV-A), and does not reach into a gap.
        """
        # Column by column, as neighbouring offsets' events lie side by side in memory.
        columns_s = np.ascontiguousarray(times_s.T)
        first, last = (np.ascontiguousarray(self._indices(columns_s, k).T) for k in (-1, +1))
        counts, on_border = last - first, self.border_sums[last] - self.border_sums[first]
        valid = (counts >= self.n_min) & (on_border <= self.max_border_fraction * counts)
        if len(self.gaps_us):
            valid &= ~self._reach_into_gaps(times_s)
        return Track(times_s, self._mean_positions(first, last), counts, valid)

    def centred_at(self, times_s: Array) -> Track:
        """Sample as `at` does, times (n,) [s], and move the means to the middle of their windows.

        Mean times are off the middle where a camera was blind. Invalid where there is no velocity.
        """
        track, velocities = self.at(times_s), self.velocities_at(times_s)
        first, last = (self._indices(times_s, side) for side in (-1, +1))
        origin_s = 1e-6 * self.times_us[0] if len(self.times_us) else 0.0
        ages_s = origin_s + self._mean_times(first, last) - times_s
        positions = track.positions_px - ages_s[:, None] * velocities
        known = np.isfinite(positions[:, 0])
        return replace(track, positions_px=positions, valid=track.valid & known)

    def velocities_at(self, times_s: Array) -> Array:
        """Image velocity (n, 2) [px/s] at times (n,) [s].

        The difference between the mean positions in the two halves of the window, over the
        difference between their mean times; NaN when a half is empty.
        """
        first, middle, last = (self._indices(times_s, side) for side in (-1, 0, +1))
        shift_px = self._mean_positions(middle, last) - self._mean_positions(first, middle)
        shift_s = self._mean_times(middle, last) - self._mean_times(first, middle)
        return shift_px / shift_s[:, None]

    def sharp_at(self, times_s: Array) -> SharpTrack:
        """Sample the motion at times (n,) [s] in sharpened event images; not the paper's position.

        Parts of the object make more or fewer events as it turns, which pulls their mean to and
        fro. Here the window's events are moved to its middle with the velocity and counted in cells
        of a pixel, each weighted by the square root of its count: the result lies between the mean
        and the centre of the image's area. Valid as in `at`, but invalid and NaN without velocity.
        """
        key = times_s.tobytes()
        if key not in self.sharp:  # poses that are tried at one offset ask for the same times
            self.sharp[key] = self._sharp_at(times_s)
        return self.sharp[key]

    def _sharp_at(self, times_s: Array) -> SharpTrack:
        track, velocities = self.at(times_s), self.velocities_at(times_s)
        moving = np.isfinite(velocities[:, 0])
        positions, sizes = np.full((len(times_s), 2), np.nan), np.full(len(times_s), np.nan)
        first, last = (self._indices(times_s[moving], side) for side in (-1, +1))
        positions[moving], sizes[moving] = sharp_centres(
            self.times_us,
            self.position_sums_px,
            first,
            last,
            times_s[moving] * 1e6,
            velocities[moving] * 1e-6,
        )
        return SharpTrack(times_s, positions, track.counts, track.valid & moving, velocities, sizes)

    def _reach_into_gaps(self, times_s: Array) -> Mask:
        """Whether the windows about times (...,) [s] hold a part of a gap."""
        starts_us, ends_us = self.gaps_us.T
        half_us = 1e6 * self.half_window_s
        following = np.searchsorted(ends_us, 1e6 * times_s - half_us, side="right")
        next_us = np.append(starts_us, np.iinfo(np.int64).max)[following]
        return np.asarray(next_us < 1e6 * times_s + half_us)

    def _indices(self, times_s: Array, side: int) -> Indices:
        """Index of the first event at or after each time, moved by -1, 0 or +1 half-windows."""
        wanted_us = np.floor(1e6 * (times_s + side * self.half_window_s) + HALF_US)
        return first_from(self.times_us, wanted_us.astype(np.int64))

    def _mean_positions(self, first: Indices, last: Indices) -> Array:
        """Mean position (..., 2) [px] of the events from `first` up to, not including, `last`."""
        with np.errstate(invalid="ignore"):
            sums = self.position_sums_px[last] - self.position_sums_px[first]
            return sums / (last - first)[..., None]

    def _mean_times(self, first: Indices, last: Indices) -> Array:
        """Mean time (n,) [s], counted from the first event, of the same events."""
        return mean_times_us(self.times_us, first, last) * 1e-6


def object_motion(
    events: Events, camera: Camera, n_min: int = 200, border_px: int = 5
) -> ObjectMotion:
    """Prepare the events (n,) of one camera, sorted and denoised, for sampling (Sec. IV-A).

    Distortion is removed from their coordinates before these are averaged; events at pixels that
    the lens model cannot undistort are left out. The border is `border_px` raw pixels wide.
    Deviation: the paper drops what lies "on the image boundary" and gives no width. With 1 px, an
    object 40 px wide loses half of itself before 5 % of its events lie on the border, and its mean
    shifts by pixels; with 5 px it is dropped before it is cut.
    """
    ideal = None
    if camera.distortion_model != "none":
        ideal = undistortion_map(camera)
        known = of_pixels(np.isfinite(ideal[..., 0]), events["x"], events["y"])
        events = events if known.all() else events.compress(known)
    n, border = len(events), (camera.width, camera.height, border_px)
    sums = np.empty((n + 1, 2)), np.empty(n + 1, np.int32)
    sum_up(events["x"], events["y"], ideal, border, *sums)
    return ObjectMotion(np.ascontiguousarray(events["t"]), *sums, n_min=n_min)


@dataclass(frozen=True, eq=False)
class PointMotion:
    """The n points of one camera, to be sampled as `ObjectMotion` is."""

    times_s: Array  # (n,) [s], ascending; with a rolling shutter, of each point's own row
    points_px: Array  # (n, 2) undistorted
    sigmas_px: Array  # (n,) deviation of each coordinate
    size_px: float  # stands for the object's size
    half_window_s: float
    max_gap_s: float
    rows: Array  # (n,) of a rolling shutter: 0 for the image's first row, 1 for its last
    readout_s: float = 0.0  # [s] from first to last row, included in `times_s`

    @property
    def interval_s(self) -> float:
        """Least time [s] from one frame to the next; infinite for a single one."""
        frames_s = self.times_s - self.readout_s * self.rows
        return float(np.min(np.diff(frames_s), initial=np.inf))

    @property
    def span_s(self) -> tuple[float, float]:
        """Times of the first and last point [s]; the empty interval (inf, -inf) of none."""
        if len(self.times_s) == 0:
            return np.inf, -np.inf
        return float(self.times_s[0]), float(self.times_s[-1])

    def read_out(self, readout_s: float) -> "PointMotion":
        """As if the rolling shutter took `readout_s` [s] from the first row to the last."""
        later_s = (readout_s - self.readout_s) * self.rows
        return replace(self, times_s=self.times_s + later_s, readout_s=readout_s)

    def at(self, times_s: Array) -> Track:
        """Sample the track at times (...,) [s]; invalid in gaps and beyond the ends."""
        return self.sharp_at(times_s)

    def velocities_at(self, times_s: Array) -> Array:
        """Image velocity (..., 2) [px/s] at times (...,) [s]; NaN where it is not known."""
        return self.sharp_at(times_s).velocities_px_s

    def sharp_at(self, times_s: Array) -> SharpTrack:
        """Sample the track and its velocity at times (...,) [s].

        The sizes are proportional to the deviations of the points there, so that methods, which
        weight by the inverse of the size, weight the points rightly.
        """
        positions, velocities, sigmas, counts = local_parabolas_at(
            self.times_s,
            self.points_px,
            self.sigmas_px,
            np.ascontiguousarray(times_s, dtype=np.float64).ravel(),
            self.half_window_s,
            self.max_gap_s,
        )
        shape = times_s.shape
        sizes = self.size_px * sigmas / float(np.median(self.sigmas_px)) if len(sigmas) else sigmas
        return SharpTrack(
            times_s,
            positions.reshape(*shape, 2),
            counts.reshape(shape),
            (counts > 0).reshape(shape),
            velocities.reshape(*shape, 2),
            sizes.reshape(shape),
        )


Motion = ObjectMotion | PointMotion
"""One camera's view of the object, to be sampled at any times: of events or of points."""


def point_motion(
    track: PointTrack,
    camera: Camera,
    rules: PointRules,
    half_window_s: float = 0.020,
    name: str = "track",
) -> PointMotion:
    """Prepare the points of one camera, in time order, for sampling.

    Distortion is removed; points that the lens model cannot undistort are left out. With a rolling
    shutter, each point was seen `readout_s` times its row's share of the height later. Windows of
    local parabolas are longer where `half_window_s` [s] holds fewer than five points. SsacError,
    which starts with `name`, if the readout is longer than the time from one frame to the next.
    """
    times_s = track.times_s
    interval_s = float(np.median(np.diff(times_s))) if len(times_s) > 1 else 0.0
    readout_s = camera.readout_s or 0.0
    check_readout(times_s, readout_s, name)
    rows = track.points_px[:, 1] / max(camera.height - 1, 1)
    if readout_s:
        times_s = times_s + readout_s * rows
    points = undistort_points(camera, track.points_px)
    known = np.isfinite(points[:, 0])
    times_s, points, rows = times_s[known], points[known], rows[known]
    half_window_s = max(half_window_s, rules.window_intervals * interval_s)
    max_gap_s = rules.max_gap_intervals * max(interval_s, half_window_s / rules.window_intervals)
    sigmas = np.ones(len(times_s)) if track.sigmas_px is None else track.sigmas_px[known]
    if track.sigmas_px is None:
        sigmas = sigmas * _noise_px(times_s, points, max_gap_s, rules.least_sigma_px)
    typical_px = float(np.median(sigmas)) if len(sigmas) else rules.least_sigma_px
    size_px = max(rules.size_sigmas * typical_px, rules.size_widths * camera.width)
    return PointMotion(times_s, points, sigmas, size_px, half_window_s, max_gap_s, rows, readout_s)


def check_readout(times_s: Array, readout_s: float, name: str) -> None:
    """Raise SsacError if a rolling shutter is still reading a frame out when the next begins."""
    if not readout_s:
        return
    frame_s = float(np.min(np.diff(times_s), initial=np.inf))
    if readout_s > frame_s * (1.0 + 1e-6):
        raise SsacError(
            f"{name}: readout_s is {1e3 * readout_s:g} ms, but frames follow each other in "
            f"{1e3 * frame_s:.3g} ms: give the time from the first row to the last, in seconds"
        )


def _noise_px(times_s: Array, points: Array, max_gap_s: float, least_px: float) -> float:
    """Deviation [px] of white noise on a coordinate, by residuals to cubics through neighbours."""
    if len(times_s) <= 4:
        return 1.0
    gaps_s = np.diff(times_s)
    ages = np.stack([times_s[i : len(times_s) - 4 + i] for i in (0, 1, 3, 4)]) - times_s[2:-2]
    whole = np.stack([gaps_s[i : len(gaps_s) - 3 + i] for i in range(4)]).max(axis=0) <= max_gap_s
    left = points[2:-2].copy()
    square = np.ones(len(left))
    for i, j in enumerate((0, 1, 3, 4)):  # Lagrange's weights of the four neighbours
        weight = np.ones(len(left))
        for other in range(4):
            if other != i:
                weight = weight * ages[other] / (ages[other] - ages[i])
        left -= weight[:, None] * points[j : len(points) - 4 + j]
        square += weight**2
    if not whole.any():
        return 1.0
    scaled = left[whole] / np.sqrt(square[whole])[:, None]
    return max(robust_deviation(scaled.ravel()), least_px)
