"""Events of one camera in, the track of the object out."""

import numpy as np

from ssac.camera import Camera, Rig, distort_points
from ssac.config import Config
from ssac.errors import SsacError
from ssac.points import PointTrack
from ssac.search.seen import seen_of, seen_times
from ssac.track.observation import Observation, denoised, object_motions

STEP_S = 0.01
"""Time between points: half of a window's half, so that a track loses nothing of the motion."""

STRAY_SIZES = 0.04
"""Deviation of a point, in sizes of the object's image: by so much the mean of the events strays
over the object as this turns."""

_LEAST_SIGMA_PX = 0.05


def track_of_events(
    observation: Observation,
    camera: Camera,
    config: Config | None = None,
    step_s: float = STEP_S,
) -> PointTrack:
    """Follow the object through the events of one camera.

    Parameters
    ----------
    observation
        What the camera recorded.
    camera
        Its intrinsics.
    config
        Of the windows and of denoising; the defaults when None.
    step_s
        Time between points [s].

    Returns
    -------
    PointTrack
        Where a window holds enough events, and few of them on the border: positions in the image as
        it is, distorted, with their deviations.

    Raises
    ------
    SsacError
        If the events cannot be used, or show no object anywhere.
    """
    config = config or Config()
    rig = Rig(camera, camera)
    clean = denoised(observation, observation, rig, config)[0]
    motion = object_motions(clean, clean, rig, config)[0]
    seen = seen_of(motion, step_s)
    times_s = seen_times(seen, int(np.count_nonzero(seen.valid)))
    sharp = motion.sharp_at(times_s)
    points = np.full((len(times_s), 2), np.nan)
    points[sharp.valid] = distort_points(camera, sharp.positions_px[sharp.valid])
    size = np.array([camera.width, camera.height])
    good = sharp.valid & np.all((points >= -0.5) & (points <= size - 0.5), axis=1)
    if not good.any():
        raise SsacError(
            f"no window of {2e3 * config.half_window_s:g} ms shows an object: {len(clean.events)} "
            "events are left after denoising; record closer to it, or give a smaller --n-min"
        )
    sigmas = np.maximum(STRAY_SIZES * sharp.sizes_px[good], _LEAST_SIGMA_PX)
    return PointTrack(times_s[good], points[good], sigmas)
