"""Events of one camera and its track in; the centre and the shape of the object's image out.

The mean of the events strays over the object as it turns: how many events a part makes depends on
its edges and on which way they move. The centre of the image's area does so far less. Events tell
the image itself, as `ssac.track.level_kernels` has it: what is darker or brighter than what
the pixel shows when it is bare.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d

from ssac.camera import Camera, distort_points
from ssac.track.level_kernels import image_sums, linked_levels

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

LEAST_SIZE_PX = 5.0
"""Least root mean square radius of an image, in the median, that has a silhouette: of one below,
as of a drone of 17 px, most pixels are neither bare nor covered."""

LEAST_CLOSED = 0.8
"""Least share of the pixels that come to rest where they had been: a sensor's noise and thresholds
that differ open it, as do events that were left out. Ideal sensors have over 0.99 of them."""

LEAST_SHARE = 0.5
"""Least share of a track's points that have a silhouette: the mean of the events is of another
point of the object, so that one of the two is to be followed nearly all the time."""

_REACH, _REACH_PX = 3.0, 4.0  # of the box, from the track: in sizes of the image, and beside
_AROUND = 20  # points on each side, of which the largest image sets the box
_GAP_STEPS = 3.0  # beyond which the object may have been anywhere
_FULL_PERCENTILE = 95.0  # of the events' levels: nearly as dark as the object gets
_CURVATURE = 1.0  # between a share that is as the level and one of contrast 7
_RAMP_PX, _LEAST_SPEED_PX_S = 0.5, 20.0  # by which an edge changes a level
_WINDOW, _LARGE_PERCENTILE = 2.2, 98.0  # of an image by itself, in sizes nearly the largest
_MOST_OFF = 1.0  # of the centre from the mean of the events, in sizes of the image


@dataclass(frozen=True, eq=False)
class Images:
    """Of the object alone, in square windows: n of them, w pixels wide."""

    shares: NDArray[np.float32]  # (n, w, w) of each pixel that is covered
    corners_px: NDArray[np.int64]  # (n, 2) column and row of the first pixel

    def of(self, chosen: Mask) -> "Images":
        """Give some of them."""
        return Images(self.shares[chosen], self.corners_px[chosen])


@dataclass(frozen=True, eq=False)
class Silhouettes:
    """The object's image at the points of a track."""

    centres_px: Array  # (n, 2) of its area, in the image as it is; NaN where it is not known
    spreads_px2: Array  # (n, 3) its second moments xx, xy and yy; NaN likewise
    images: Images  # all of it

    @property
    def known(self) -> Mask:
        """Where there is one (n,)."""
        return np.isfinite(self.centres_px[:, 0])


def silhouettes(
    events: NDArray[np.void], camera: Camera, times_s: Array, points_px: Array, sizes_px: Array
) -> Silhouettes | None:
    """Find the object's silhouettes.

    Parameters
    ----------
    events
        All that the camera recorded, dtype EVENT_DTYPE, sorted: denoised ones count wrong.
    camera
        Its intrinsics.
    times_s, points_px, sizes_px
        Shapes (n,), (n, 2) and (n,): a track by the mean of the events, undistorted, and the root
        mean square radius of the image.

    Returns
    -------
    Silhouettes or None
        None where the object is too small, or the events do not tell: `LEAST_SIZE_PX`,
        `LEAST_CLOSED`, `LEAST_SHARE`.
    """
    if len(times_s) < 2 or float(np.median(sizes_px)) < LEAST_SIZE_PX:
        return None
    where_px = distort_points(camera, points_px)
    samples_us, boxes, own = _boxes(times_s, where_px, sizes_px, camera)
    first = int(np.searchsorted(events["t"], samples_us[0]))
    times_us, x, y, polarities = (np.ascontiguousarray(events[name]) for name in "txyp")
    linked = linked_levels(
        times_us, x, y, polarities, camera.width, camera.height, samples_us, boxes
    )
    levels, before, after, rests, closed = linked
    if first == len(events) or closed < LEAST_CLOSED * rests:
        return None
    moving = np.gradient(where_px, times_s, axis=0)
    speeds = np.maximum(np.linalg.norm(moving, axis=1), _LEAST_SPEED_PX_S)
    ramps_us = np.interp(1e-6 * samples_us, times_s, 1e6 * _RAMP_PX / speeds)
    full = float(np.percentile(np.abs(levels[first:]), _FULL_PERCENTILE))
    half = int(np.ceil(_WINDOW * np.percentile(sizes_px, _LARGE_PERCENTILE)))
    corners = np.rint(where_px).astype(np.int64) - half
    placed = np.zeros((len(samples_us), 2), np.int64)
    placed[own] = corners
    shares = np.zeros((len(samples_us), 2 * half + 1, 2 * half + 1), np.float32)
    sums = image_sums(
        times_us,
        x,
        y,
        levels,
        before,
        after,
        camera.width,
        camera.height,
        samples_us,
        boxes,
        ramps_us,
        full,
        _CURVATURE,
        placed,
        shares,
    )[own]
    off_px = np.linalg.norm(sums[:, 1:3] - where_px, axis=1)
    good = (sums[:, 0] > 0.0) & (sums[:, 6] == 0.0) & (sums[:, 7] == 0.0)
    good &= off_px < _MOST_OFF * sizes_px
    if np.mean(good) < LEAST_SHARE:
        return None
    found = np.where(good[:, None], sums[:, 1:6], np.nan)
    return Silhouettes(found[:, :2], found[:, 2:], Images(shares[own], corners))


def _boxes(
    times_s: Array, where_px: Array, sizes_px: Array, camera: Camera
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.intp]]:
    """Give times [us] and boxes of samples, and which of them are the track's points.

    Where there are none, at the beginning and in gaps, the object may be anywhere.
    """
    reach_px = _REACH * maximum_filter1d(sizes_px, 2 * _AROUND + 1) + _REACH_PX
    most = np.array([camera.width - 1, camera.height - 1])
    low = np.clip(np.floor(where_px - reach_px[:, None]), 0, most)
    high = np.clip(np.ceil(where_px + reach_px[:, None]), 0, most)
    boxes = np.column_stack([low[:, 0], high[:, 0], low[:, 1], high[:, 1]]).astype(np.int64)
    steps_s = np.diff(times_s)
    gaps = np.flatnonzero(steps_s > _GAP_STEPS * np.median(steps_s)) + 1
    places = np.concatenate([[0], gaps])
    between_s = np.concatenate([[times_s[0] - 1e-3], times_s[gaps] - 0.5 * steps_s[gaps - 1]])
    everywhere = np.array([0, camera.width - 1, 0, camera.height - 1])
    samples_s = np.insert(times_s, places, between_s)
    boxes = np.insert(boxes, places, everywhere, axis=0)
    own = np.arange(len(times_s)) + np.searchsorted(places, np.arange(len(times_s)), side="right")
    return np.rint(1e6 * samples_s).astype(np.int64), boxes, own
