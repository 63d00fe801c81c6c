"""The point track: image positions of one object over time, from a camera of any kind."""

from dataclasses import dataclass

import numpy as np

from ssac.arrays import Array
from ssac.errors import SsacError
from ssac.events import is_whole, wrap_message, wrapped


@dataclass(frozen=True)
class PointTrack:
    """Positions of one object in one camera's image, at times of the camera's own clock."""

    times_s: Array  # (n,) [s], ascending
    points_px: Array  # (n, 2) in the distorted image
    sigmas_px: Array | None = None  # (n,) deviation of each coordinate; None: not known

    def __len__(self) -> int:
        return len(self.times_s)


def check_track(track: PointTrack, width: int, height: int, name: str) -> None:
    """Raise SsacError, led by `name`, unless a track is finite, in order and in the image."""
    times_s, points = track.times_s, track.points_px
    n = len(times_s)
    if points.shape != (n, 2) or (track.sigmas_px is not None and track.sigmas_px.shape != (n,)):
        sigmas_shape = None if track.sigmas_px is None else track.sigmas_px.shape
        raise SsacError(
            f"{name}: a track of {n} times must have points of shape ({n}, 2), and deviations of "
            f"shape ({n},) or none, got {points.shape} and {sigmas_shape}: give one of each a time"
        )
    if n == 0:
        raise SsacError(f"{name}: there are no points: track again, or check the right file")
    sigmas = np.ones(n) if track.sigmas_px is None else track.sigmas_px
    finite = np.isfinite(times_s) & np.isfinite(points).all(axis=1) & np.isfinite(sigmas)
    if not finite.all():
        raise SsacError(
            f"{name}: point {np.argmin(finite)} has a value that is no finite number: leave out"
            " the rows in which the object was not seen"
        )
    disorder = disorder_of(times_s, of_sensor=True)
    if disorder:
        raise SsacError(f"{name}: {disorder}")
    longest_s = 5.0  # between points: longer than in any track of an object
    if n > 2 and is_whole(times_s) and np.median(np.diff(times_s)) > longest_s:
        raise SsacError(
            f"{name}: the times are whole numbers up to {times_s[-1]:.0f}, as of microseconds or "
            "milliseconds: give t_s in seconds"
        )
    low, high = -0.5, np.array([width, height]) - 0.5  # pixel centres are at whole coordinates
    inside = np.all((points >= low) & (points <= high), axis=1)
    if not inside.all():
        x, y = points[~inside][0]
        raise SsacError(
            f"{name}: the image is {width} x {height} px, but point {np.argmin(inside)} is at "
            f"({x:g}, {y:g}): give the rig of this camera, and leave out where nothing was seen"
        )
    if not (sigmas > 0.0).all():
        raise SsacError(
            f"{name}: sigma_px must be positive, got {sigmas.min():g} at point "
            f"{np.argmin(sigmas > 0.0)}: correct it, or leave the column out"
        )


def disorder_of(times_s: Array, of_sensor: bool = False) -> str:
    """Say which of the times (n,) [s] is not after the one before it; empty where all are.

    Those of an event sensor may be a counter's, which begins anew.
    """
    backwards = np.diff(times_s) <= 0.0
    if not backwards.any():
        return ""
    k = int(np.argmax(backwards)) + 1
    if of_sensor and wrapped(times_s[k - 1], times_s[k]):
        return wrap_message(f"point {k}")
    return (
        f"rows must be in time order, but point {k} is at {times_s[k]:.10g} s, after one at"
        f" {times_s[k - 1]:.10g} s: sort the rows, one object and one point a time"
    )
