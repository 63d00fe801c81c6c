"""A view in; the events of pixels that fire where nothing moves out: lamps, clusters, noise.

Times are the scene's, in no order; `sim.disturb.clutter` sorts them in among the others.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim.effects.pixels import CLUSTER_PX
from sim.errors import SimError
from sim.sensor.buffer import EVENT_DTYPE
from sim.sensor.events import HOT_SPREAD

FloatArray = NDArray[np.float64]

LAMP_HZ = 100.0  # mains of 50 Hz: bright at both crests
LAMP_STEPS = 2  # thresholds that its light passes on the way up, and again on the way down
LAMP_JITTER_S = 1e-4
CLUSTER_HZ = 200.0  # median rate of a hot cluster's pixels


@dataclass(frozen=True)
class View:
    """What clutter fills."""

    width: int  # [px]
    height: int  # [px]
    duration_s: float

    def events(
        self, times_s: FloatArray, x_px: FloatArray, y_px: FloatArray, brighter: NDArray[np.bool_]
    ) -> NDArray[Any]:
        """Make events of times and places (n,), without those that are outside of either."""
        t_us = np.floor(1e6 * times_s)
        x, y = np.rint(x_px), np.rint(y_px)
        inside = (t_us >= 0) & (t_us < 1e6 * self.duration_s)
        inside &= (x >= 0) & (x < self.width) & (y >= 0) & (y < self.height)
        events = np.empty(int(inside.sum()), EVENT_DTYPE)
        for name, values in (("t", t_us), ("x", x), ("y", y), ("p", brighter)):
            events[name] = values[inside]
        return events


def lamp(view: View, size_px: int, rng: np.random.Generator) -> NDArray[Any]:
    """Let a square of pixels flicker at 100 Hz all along.

    Raises
    ------
    SimError
        When it does not fit into the view.
    """
    x0, y0 = _corner(view, size_px, "a lamp", rng)
    starts_s = np.arange(np.ceil(LAMP_HZ * view.duration_s)) / LAMP_HZ
    # Up in the first half of a cycle and down in the second.
    steps_s = (np.arange(2 * LAMP_STEPS) + 0.5) / (2 * LAMP_STEPS * LAMP_HZ)
    shape = (size_px, size_px, len(starts_s), len(steps_s))
    times_s = starts_s[:, None] + steps_s + LAMP_JITTER_S * rng.standard_normal(shape)
    rows, columns, _, step = np.indices(shape, sparse=True)
    x_px, y_px, up = (np.broadcast_to(each, shape).astype(float).ravel()
                      for each in (x0 + columns, y0 + rows, step < LAMP_STEPS))  # fmt: skip
    return view.events(times_s.ravel(), x_px, y_px, up > 0.0)


def hot_clusters(view: View, n_clusters: int, rng: np.random.Generator) -> NDArray[Any]:
    """Let clusters of 3 x 3 pixels fire without cause, all events ON.

    Raises
    ------
    SimError
        When the view is smaller than a cluster.
    """
    x_px, y_px = [np.empty(0)], [np.empty(0)]
    for _ in range(n_clusters):
        x0, y0 = _corner(view, CLUSTER_PX, "a hot cluster", rng)
        for row, column in np.ndindex(CLUSTER_PX, CLUSTER_PX):
            rate_hz = CLUSTER_HZ * rng.lognormal(0.0, HOT_SPREAD)
            n = rng.poisson(rate_hz * view.duration_s)
            x_px.append(np.full(n, float(x0 + column)))
            y_px.append(np.full(n, float(y0 + row)))
    x, y = np.concatenate(x_px), np.concatenate(y_px)
    times_s = rng.uniform(0.0, view.duration_s, len(x))
    return view.events(times_s, x, y, np.ones(len(x), bool))


def noise(view: View, rate_hz: float, rng: np.random.Generator) -> NDArray[Any]:
    """Let every pixel fire at a rate [Hz], each polarity half of the time."""
    n = rng.poisson(rate_hz * view.width * view.height * view.duration_s)
    events = np.empty(n, EVENT_DTYPE)
    events["t"] = rng.integers(0, round(1e6 * view.duration_s), n)
    events["x"] = rng.integers(0, view.width, n)
    events["y"] = rng.integers(0, view.height, n)
    events["p"] = rng.integers(0, 2, n)
    return events


def _corner(view: View, size_px: int, what: str, rng: np.random.Generator) -> tuple[int, int]:
    """Draw the first column and row of a square that lies within the view."""
    if size_px > min(view.width, view.height):
        raise SimError(
            f"disturbance: {what} of {size_px} x {size_px} px does not fit into a view of "
            f"{view.width} x {view.height} px: make it smaller"
        )
    x0 = int(rng.integers(0, view.width - size_px + 1))
    return x0, int(rng.integers(0, view.height - size_px + 1))
