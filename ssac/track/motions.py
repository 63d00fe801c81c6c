"""How the object moves before one camera, from its events or from its track of points."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ssac.config import Windows
from ssac.track.clean import Clean
from ssac.track.motion import Motion, ObjectMotion, object_motion
from ssac.track.point_motion import point_motion


def motion_of(clean: Clean, how: Windows) -> Motion:
    """Sum up a camera's object for sampling at any time (Sec. IV-A).

    Parameters
    ----------
    clean
        What it recorded, without noise. Sums over its events are kept with it: they depend on the
        width of the border alone, so that other windows cost nothing.
    how
        Which windows of events give a position.
    """
    if clean.track is not None:
        return point_motion(clean.track, clean.camera, how.half_window_s)
    n_min = clean.n_min(how.n_min)
    sums = clean.kept.get(how.border_px)
    if sums is None:
        sums = clean.kept[how.border_px] = _summed_up(clean, how, n_min)
    motion: ObjectMotion = sums
    return motion.sampled_by(how.half_window_s, n_min, how.max_border_fraction)


def _summed_up(clean: Clean, how: Windows, n_min: int) -> ObjectMotion:
    """Sum up all events; beside them those that no thin line holds, where there is one."""
    motion = _of_events(clean, clean.events, how, n_min)
    if clean.on_line is None:
        return motion
    return replace(motion, bare=_of_events(clean, clean.events[~clean.on_line], how, n_min))


def _of_events(clean: Clean, events: NDArray[np.void], how: Windows, n_min: int) -> ObjectMotion:
    motion = object_motion(
        events,
        clean.camera,
        half_window_s=how.half_window_s,
        n_min=n_min,
        border_px=how.border_px,
        max_border_fraction=how.max_border_fraction,
    )
    return replace(motion, gaps_us=clean.gaps_us)
