"""Events in, the events of the moving object out: what fires by itself, or alone, removed.

How many neighbours an event needs follows from the noise that is there, and from how many events
the object makes; the paper's 20 are what an ordinary drone in ordinary light needs.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import pdtrc

from ssac.config import N_MIN
from ssac.events import first_from
from ssac.track.clutter import activity, chosen_events, masked_pixels, unmasked
from ssac.track.denoise_kernels import extent, has_neighbours, has_neighbours_in_noise

US_PER_MS = 1000.0

PAPER_PX, PAPER_NEIGHBOURS = 5.0, 20
"""The paper's ball [px, ms] and the neighbours in it."""

NEAR_PX, NEAR_NEIGHBOURS = 3.0, 12
"""The same where there is much noise: what lies beside the object by chance, a large ball keeps."""

NOISY_HZ = 1.0
"""Background of a pixel from which the small ball is taken."""

MOST = 0.9
"""Share of an object's events that have more neighbours, where these are asked for."""

LEAST_NEIGHBOURS = 5
"""However little noise there is."""

THIN = 2.0
"""An object of fewer events in a window than so many times the paper's N_min is thin."""

_LEAST_N_MIN = 20
_SHARE_N_MIN = 0.25  # of a thin object's events in a window
_WINDOW_S = 0.040  # whatever the config's is: what is prepared must not depend on that
_SAMPLES = 1000  # of windows

_CORE = 0.4  # of the ball's squared radius: pixels nearer than that are counted, for most events


@dataclass(frozen=True)
class Clutter:
    """What was done to the events of one camera, and why."""

    masked_pixels: int  # which fire by themselves: lamps and hot pixels
    masked_events: int
    background_hz: float  # of an ordinary pixel
    radius_px: float  # of the radius filter's ball, and in ms
    n_neighbours: int  # that an event needs in it
    n_min: int  # events that a window holds at least, unless the config says how many

    @property
    def is_adapted(self) -> bool:
        """Whether the paper's values were left."""
        used = self.radius_px, self.n_neighbours, self.n_min
        return used != (PAPER_PX, PAPER_NEIGHBOURS, N_MIN)


def without_noise(
    events: NDArray[np.void], width: int, height: int, n_neighbours: int | None = None
) -> tuple[NDArray[np.void], Clutter]:
    """Remove what fires by itself, then what fires alone.

    Parameters
    ----------
    events
        Events, dtype EVENT_DTYPE, shape (N,), sorted by time.
    width, height
        Sensor size [px].
    n_neighbours
        That an event needs in the paper's ball. None: the paper's, in little noise; in more than
        NOISY_HZ the smaller ball; fewer, if noise allows it, where the object is thin.

    Returns
    -------
    tuple
        The events left, in the same order, and what was done.
    """
    found = activity(events, width, height)
    mask = masked_pixels(found)
    n_all, hz = len(events), found.background_hz
    events, size_px = unmasked(events, mask), (width, height)
    n_masked = n_all - len(events)
    radius_px, n = PAPER_PX, n_neighbours or PAPER_NEIGHBOURS
    if n_neighbours is None and hz > NOISY_HZ:
        radius_px, n = NEAR_PX, least_neighbours(hz, width * height, NEAR_PX, NEAR_NEIGHBOURS)
        left = radius_filter(events, radius_px, n_neighbours=n, mostly_noise=True, size_px=size_px)
        fewer = radius_filter(left, radius_px, n_neighbours=NEAR_NEIGHBOURS, size_px=size_px)
        if len(fewer) > MOST * len(left):
            left, n = fewer, NEAR_NEIGHBOURS
    else:
        left = radius_filter(events, n_neighbours=n, size_px=size_px)
        if n_neighbours is None and events_per_window(left) < THIN * N_MIN:
            n = least_neighbours(hz, width * height, PAPER_PX, PAPER_NEIGHBOURS)
            left = radius_filter(events, n_neighbours=n, size_px=size_px)
    n_min, in_window = N_MIN, events_per_window(left)
    if in_window < THIN * N_MIN:
        n_min = int(np.clip(_SHARE_N_MIN * in_window, _LEAST_N_MIN, N_MIN))
    return left, Clutter(int(mask.sum()), n_masked, hz, radius_px, n, n_min)


def least_neighbours(background_hz: float, n_pixels: int, radius_px: float, most: int) -> int:
    """Fewest neighbours that leave at most one event of the noise in a window, up to `most`.

    Parameters
    ----------
    background_hz
        Of each pixel, at random times.
    n_pixels
        Of the sensor.
    radius_px
        Of the ball [px, ms].
    most
        Given where even that many leave more.
    """
    in_ball = background_hz * 4.0 / 3.0 * np.pi * radius_px**3 / US_PER_MS
    in_window = background_hz * n_pixels * _WINDOW_S
    for n in range(LEAST_NEIGHBOURS, most):
        if in_window * pdtrc(n - 1, in_ball) <= 1.0:  # n or more, of a Poisson distribution
            return n
    return most


def events_per_window(events: NDArray[np.void]) -> float:
    """Median number of events within 20 ms of one of them; 0 of none."""
    t = events["t"]
    if len(t) == 0:
        return 0.0
    some = t[:: -(-len(t) // _SAMPLES)]
    half_us = round(0.5e6 * _WINDOW_S)
    return float(np.median(first_from(t, some + half_us) - first_from(t, some - half_us)))


def radius_filter(
    events: NDArray[np.void],
    radius_px: float = PAPER_PX,
    ms_per_unit: float = 1.0,
    n_neighbours: int = PAPER_NEIGHBOURS,
    *,
    mostly_noise: bool = False,
    size_px: tuple[int, int] | None = None,
) -> NDArray[np.void]:
    """Events with enough neighbours in a ball of x-y-t space, as the paper's authors filter.

    Time is scaled so that `ms_per_unit` milliseconds count as much as one pixel. An event is kept
    when at least `n_neighbours` other events lie within `radius_px` of it (the boundary counts).

    Parameters
    ----------
    events
        Events, dtype EVENT_DTYPE, shape (N,), sorted by time.
    radius_px
        Radius of the ball [px].
    ms_per_unit
        Length of the time axis's unit [ms/px].
    n_neighbours
        Neighbours needed, the event itself not counted.
    mostly_noise
        Most events are to be removed: another way to the same result, which is faster then.
    size_px
        The sensor's width and height; None: as far as the events reach.

    Returns
    -------
    NDArray[np.void]
        The kept events, in the same order.

    Notes
    -----
    The core of the ball, for as long as all of it lasts, has its events counted as they come and
    go, and where it holds enough the event is kept at a cost that depends neither on the rate of
    events nor on the size of the sensor. For the others, the events of each pixel around are looked
    through from the latest one on, the nearest pixels first. Where most are noise, the events of
    tiles are counted instead: those around an event hold the ball, and where they have too few it
    is removed. Both are exact.
    """
    if len(events) <= n_neighbours:
        return events[:0]
    offsets_px, spans_us = _ball(radius_px, US_PER_MS * ms_per_unit)
    where = events["t"], events["x"], events["y"]
    if mostly_noise or radius_px < 1.0:
        keep = has_neighbours_in_noise(*where, offsets_px, spans_us, n_neighbours)
        return chosen_events(events, keep)
    width, height = size_px or extent(*where[1:])
    margin_px = int(radius_px)
    n_rows = height + 2 * margin_px
    squared_px = max(_CORE * radius_px**2, 1.0)
    core_us = int(np.min(spans_us[np.sum(offsets_px**2, axis=1) <= squared_px]))
    steps = offsets_px[:, 0] * n_rows + offsets_px[:, 1]
    sensor = width + 2 * margin_px, n_rows, margin_px
    core = _core(squared_px, n_rows), core_us
    return chosen_events(
        events, has_neighbours(*where, sensor, steps, spans_us, *core, n_neighbours)
    )


def _core(squared_px: float, n_rows: int) -> tuple[int, ...]:
    """Middles of three pixels of a column each, which no circle of that radius cuts: as cells.

    Cells are numbered column by column, of `n_rows` each, from that in the circle's middle on.
    """
    reach_px, found = int(np.sqrt(squared_px)), []
    for column in range(-reach_px, reach_px + 1):
        n_threes = (2 * int(np.sqrt(squared_px - column**2)) + 1) // 3
        top = -(3 * n_threes // 2)
        found += [column * n_rows + top + 3 * k + 1 for k in range(n_threes)]
    return tuple(found)


def _ball(radius_px: float, us_per_px: float) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Pixels (k, 2) [px] that a ball about a pixel reaches, the nearest first, and how far (k,).

    That is the most that two events of these pixels may lie apart in time [us].
    """
    axis_px = np.arange(-int(radius_px), int(radius_px) + 1)
    offsets_px = np.stack(np.meshgrid(axis_px, axis_px, indexing="ij"), axis=-1).reshape(-1, 2)
    squares_px = np.sum(offsets_px**2, axis=1)
    order = np.argsort(squares_px, kind="stable")
    order = order[squares_px[order] <= radius_px**2]
    left = (radius_px**2 - squares_px[order]) * us_per_px**2
    spans_us = np.floor(np.sqrt(left))
    spans_us += (spans_us + 1.0) ** 2 <= left  # the root of a whole square may come out below it
    return offsets_px[order], spans_us.astype(np.int64)
