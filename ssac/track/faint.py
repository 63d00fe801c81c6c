"""All events of one camera in; those of a faint object, small and far away, out."""

import numpy as np
from numpy.typing import NDArray

from ssac.errors import SsacError
from ssac.track.clutter import activity, masked_pixels, unmasked
from ssac.track.denoise import radius_filter
from ssac.track.follow import follow

N_NEIGHBOURS, MS_PER_UNIT, N_ROUNDS = 10, 8.0, 4
"""Of the radius filter: an image of 6 px that moves by 60 px/s has some 500 events a second, and
none has the paper authors' 20 neighbours within 5 ms. Noise and the edges of clouds have two in
this larger ball, and by chance ten; but such clumps have too few among themselves, and melt when
they are filtered again, while the object's events keep each other. From there it is followed
through the others."""


def faint_object_events(events: NDArray[np.void], width: int, height: int) -> NDArray[np.void]:
    """Find the events of one object that makes too few to be told from noise by their neighbours.

    What the radius filter leaves is surely the object's, but has gaps where it is far or slow;
    through these it is followed.

    Parameters
    ----------
    events
        All events of a camera, dtype EVENT_DTYPE, shape (m,), sorted by time.
    width, height
        Sensor size [px].

    Returns
    -------
    (k,) array
        Those of the object; those that are surely its own where they are too few to follow it.

    Raises
    ------
    SsacError
        When no event is surely of an object.
    """
    kept = unmasked(events, masked_pixels(activity(events, width, height)))
    sure = kept
    for _ in range(N_ROUNDS):
        sure = radius_filter(sure, ms_per_unit=MS_PER_UNIT, n_neighbours=N_NEIGHBOURS)
    if not len(sure):
        raise SsacError(
            f"of {len(events)} events none keeps {N_NEIGHBOURS} neighbours within 5 px (a px being"
            f" {MS_PER_UNIT:g} ms): no object is seen, or it is too faint even for --faint"
        )
    found = follow(kept, sure, width, height)
    return sure if found is None else found.events
