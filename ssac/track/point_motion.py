"""A track of points in, the object's image position and velocity at any array of times out.

The counterpart of `ssac.track.motion` for a camera that gave no events: it samples alike, so that
no method need know which of the two it looks at. Local parabolas stand for the means over windows
of events. A track does not show how large the object is, by which methods judge what they find; a
size that its noise and the image's width suggest stands for it.
"""

from dataclasses import dataclass, replace

import numba
import numpy as np
from numpy.typing import NDArray

from ssac.camera import Camera, undistort_points
from ssac.errors import SsacError
from ssac.geometry.robust import robust_deviation
from ssac.points import PointTrack
from ssac.track.motion import SharpTrack, Track

Array = NDArray[np.float64]

SIZE_SIGMAS, SIZE_WIDTHS = 10.0, 0.01
"""Size that stands for the object's: so many deviations of a point, or shares of the image's width,
whichever is more."""

WINDOW_INTERVALS = 2.6
"""Least half of the window of a local parabola, in median intervals: five points."""

MAX_GAP_INTERVALS = 2.5
"""Median intervals between two points that are the ends of a gap: one may be missing."""

_LEAST_SIGMA_PX = 0.02  # of points without noise
_MIN_POINTS = 4  # of a local fit: one more than a parabola has coefficients
_MIN_SIDE = 2  # of them before the sample time and after it: nothing is told beyond an end
_SAME_S = 1e-9
_SINGULAR = 1e-9  # of a scaled determinant


@dataclass(frozen=True)
class PointMotion:
    """The n points of one camera, to be sampled as `ssac.track.motion.ObjectMotion` is."""

    times_s: Array  # (n,) [s], ascending; of the points' own rows of a rolling shutter
    points_px: Array  # (n, 2) undistorted
    sigmas_px: Array  # (n,) of each coordinate
    size_px: float  # that stands for the object's
    half_window_s: float
    max_gap_s: float
    rows: Array  # (n,) of a rolling shutter: 0 for the image's first row, 1 for its last
    readout_s: float = 0.0  # with which the times are of these rows

    @property
    def interval_s(self) -> float:
        """Least time [s] from one frame to the next; infinite of one."""
        frames_s = self.times_s - self.readout_s * self.rows
        return float(np.min(np.diff(frames_s), initial=np.inf))

    @property
    def span_s(self) -> tuple[float, float]:
        """Times of the first and last point [s]; the empty interval (inf, -inf) of none."""
        if len(self.times_s) == 0:
            return np.inf, -np.inf
        return float(self.times_s[0]), float(self.times_s[-1])

    def delayed(self, shift_us: int) -> "PointMotion":
        """As if the camera's clock had shown `shift_us` [us] more."""
        return replace(self, times_s=self.times_s + 1e-6 * shift_us)

    def read_out(self, readout_s: float) -> "PointMotion":
        """As if the rolling shutter took `readout_s` [s] from the first row to the last."""
        later_s = (readout_s - self.readout_s) * self.rows
        return replace(self, times_s=self.times_s + later_s, readout_s=readout_s)

    def at(self, times_s: Array) -> Track:
        """Sample the track at times (...,) [s]; invalid in gaps and beyond the ends."""
        sharp = self.sharp_at(times_s)
        return Track(sharp.times_s, sharp.positions_px, sharp.counts, sharp.valid)

    def velocities_at(self, times_s: Array) -> Array:
        """Image velocity (..., 2) [px/s] at times (...,) [s]; NaN where it is not known."""
        return self.sharp_at(times_s).velocities_px_s

    def sharp_at(self, times_s: Array) -> SharpTrack:
        """Sample the track and its velocity at times (...,) [s].

        The sizes are in proportion to the deviations of the points there, so that methods, which
        weigh by the inverse of the size, weigh well.
        """
        positions, velocities, sigmas, counts = _local_parabolas(
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


def point_motion(
    track: PointTrack, camera: Camera, half_window_s: float = 0.020, name: str = "track"
) -> PointMotion:
    """Prepare the points of one camera for sampling.

    Parameters
    ----------
    track
        Points in time order.
    camera
        Its distortion is removed; points that its lens model cannot undistort are left out. With a
        rolling shutter, each point was seen `readout_s` times its row's share of the height later.
    half_window_s
        Half of the window of a local parabola [s]; longer where that holds fewer than five points.
    name
        What the track is; starts error messages.

    Raises
    ------
    SsacError
        If the readout is longer than from one frame to the next.
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
    half_window_s = max(half_window_s, WINDOW_INTERVALS * interval_s)
    max_gap_s = MAX_GAP_INTERVALS * max(interval_s, half_window_s / WINDOW_INTERVALS)
    sigmas = np.ones(len(times_s)) if track.sigmas_px is None else track.sigmas_px[known]
    if track.sigmas_px is None:
        sigmas = sigmas * _noise_px(times_s, points, max_gap_s)
    typical_px = float(np.median(sigmas)) if len(sigmas) else _LEAST_SIGMA_PX
    size_px = max(SIZE_SIGMAS * typical_px, SIZE_WIDTHS * camera.width)
    return PointMotion(times_s, points, sigmas, size_px, half_window_s, max_gap_s, rows, readout_s)


def check_readout(times_s: Array, readout_s: float, name: str) -> None:
    """Refuse a shutter that has not read a frame out when the next one begins."""
    if not readout_s:
        return
    frame_s = float(np.min(np.diff(times_s), initial=np.inf))
    if readout_s > frame_s * (1.0 + 1e-6):
        raise SsacError(
            f"{name}: readout_s is {1e3 * readout_s:g} ms, but frames follow each other in "
            f"{1e3 * frame_s:.3g} ms: give the time from the first row to the last, in seconds"
        )


def _noise_px(times_s: Array, points: Array, max_gap_s: float) -> float:
    """Deviation [px] of white noise on each coordinate: what lies off the cubic through neighbours.

    Of five points an even time apart, the middle one less what the cubic through the other four
    has there.
    """
    if len(times_s) <= _MIN_POINTS:
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
    return max(robust_deviation(scaled.ravel()), _LEAST_SIGMA_PX)


@numba.njit(cache=True)
def _local_parabolas(
    times_s: NDArray[np.float64],
    points_px: NDArray[np.float64],
    sigmas_px: NDArray[np.float64],
    wanted_s: NDArray[np.float64],
    half_window_s: float,
    max_gap_s: float,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]:
    """Positions, velocities, deviations and counts of points at m wanted times.

    Parabolas are fitted to the points within the window, weighed by (1 - (age / window)^2)^2 and by
    their deviations. NaN, and a count of 0, in gaps and beyond the ends.
    """
    n, m = len(times_s), len(wanted_s)
    positions, velocities = np.full((m, 2), np.nan), np.full((m, 2), np.nan)
    deviations, counts = np.full(m, np.nan), np.zeros(m, np.int64)
    for k in range(m):
        t_s = wanted_s[k]
        after = np.searchsorted(times_s, t_s)
        if after < _MIN_SIDE or n - after < _MIN_SIDE:
            continue
        if times_s[after] - times_s[after - 1] > max_gap_s:
            continue
        first, last = after, after
        while first > 0 and t_s - times_s[first - 1] < half_window_s:
            first -= 1
        while last < n and times_s[last] - t_s < half_window_s:
            last += 1
        before = after - first + (times_s[after] - t_s < _SAME_S)  # a point there is on both sides
        if before < _MIN_SIDE or last - after < _MIN_SIDE or last - first < _MIN_POINTS:
            continue
        s0 = s1 = s2 = s3 = s4 = 0.0
        sums = np.zeros((2, 3))
        variance, total = 0.0, 0.0
        for i in range(first, last):
            age = (times_s[i] - t_s) / half_window_s
            nearness = (1.0 - age * age) ** 2
            weight = nearness / (sigmas_px[i] * sigmas_px[i])
            s0, s1, s2 = s0 + weight, s1 + weight * age, s2 + weight * age**2
            s3, s4 = s3 + weight * age**3, s4 + weight * age**4
            for axis in range(2):
                for power in range(3):
                    sums[axis, power] += weight * points_px[i, axis] * age**power
            variance += nearness * sigmas_px[i] ** 2
            total += nearness
        determinant = s0 * (s2 * s4 - s3 * s3) - s1 * (s1 * s4 - s3 * s2) + s2 * (s1 * s3 - s2 * s2)
        if determinant < _SINGULAR * s0**3:
            continue
        for axis in range(2):
            b0, b1, b2 = sums[axis, 0], sums[axis, 1], sums[axis, 2]
            positions[k, axis] = (
                b0 * (s2 * s4 - s3 * s3) - s1 * (b1 * s4 - s3 * b2) + s2 * (b1 * s3 - s2 * b2)
            ) / determinant
            velocities[k, axis] = (
                s0 * (b1 * s4 - b2 * s3) - b0 * (s1 * s4 - s3 * s2) + s2 * (s1 * b2 - b1 * s2)
            ) / (determinant * half_window_s)
        deviations[k] = np.sqrt(variance / total)
        counts[k] = last - first
    return positions, velocities, deviations, counts
