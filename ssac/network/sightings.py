"""What one camera of many recorded in; where it saw the object, undistorted, out."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ssac.camera import Camera, undistort_points
from ssac.geometry.pose import rays_of
from ssac.points import PointTrack
from ssac.track.point_motion import PointMotion, point_motion
from ssac.track.silhouette import Images

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Sightings:
    """Where one camera saw the object, on its own clock."""

    name: str
    camera: Camera
    times_s: Array  # (n,) ascending; of the points' own rows, as far as the rig tells the readout
    points_px: Array  # (n, 2) undistorted
    rows: Array  # (n,) 0 at the image's first row, 1 at its last
    sigmas_px: Array  # (n,) of each coordinate
    motion: PointMotion  # the same, to be sampled at any time
    has_frames: bool  # rows may be read out one after the other; no: events
    spreads_px2: Array | None = None
    """(n, 3) second moments of the silhouettes whose centres of area the points are; NaN where one
    is another point of the object; None where all are."""
    images: Images | None = None  # the silhouettes, distorted as they are

    def __len__(self) -> int:
        return len(self.times_s)

    @property
    def span_s(self) -> tuple[float, float]:
        """Times of the first and the last sighting [s]."""
        return float(self.times_s[0]), float(self.times_s[-1])

    @property
    def middle_s(self) -> float:
        """Middle of the recording [s]."""
        return 0.5 * (self.span_s[0] + self.span_s[1])

    @property
    def interval_s(self) -> float:
        """Median time between sightings [s]."""
        return float(np.median(np.diff(self.times_s)))

    def rays_at(self, times_s: Array) -> Array:
        """Directions (n, 3), z = 1, at times (n,) of its clock; NaN where it did not see it."""
        return rays_of(self.camera.K, self.motion.at(times_s).positions_px)


def sightings(
    track: PointTrack,
    camera: Camera,
    name: str,
    has_frames: bool = True,
    spreads_px2: Array | None = None,
    images: Images | None = None,
) -> Sightings:
    """Prepare the track of one camera.

    Parameters
    ----------
    track
        As `ssac.points.check_track` lets pass.
    camera
        Its intrinsics.
    name
        For messages and reports.
    has_frames
        Whether it is of frames; no: of events, of which each has its own time.
    spreads_px2, images
        Of the track's points, as of `Sightings`.
    """
    motion = point_motion(track, camera, name=name)
    known = np.isfinite(undistort_points(camera, track.points_px)[:, 0])
    rows = track.points_px[known, 1] / max(camera.height - 1, 1)
    spreads = None if spreads_px2 is None else spreads_px2[known]
    points = motion.points_px, rows, motion.sigmas_px
    images = None if images is None else images.of(known)
    return Sightings(name, camera, motion.times_s, *points, motion, has_frames, spreads, images)


def is_near(times_s: Array, seen_s: Array, reach_s: float) -> NDArray[np.bool_]:
    """Whether any of the times (m,) that a camera saw something is within reach of times (n,)."""
    if not len(seen_s):
        return np.zeros(len(times_s), dtype=bool)
    ordered = np.sort(seen_s)
    after = np.searchsorted(ordered, times_s)
    low = ordered[np.clip(after - 1, 0, len(ordered) - 1)]
    high = ordered[np.clip(after, 0, len(ordered) - 1)]
    return np.asarray(np.minimum(np.abs(times_s - low), np.abs(high - times_s)) <= reach_s)
