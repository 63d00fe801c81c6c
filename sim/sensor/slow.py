"""Whole images of a light that changes slowly in, the events of the pixels that see it out."""

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim.sensor.events import Sensor, SensorConfig

FloatArray = NDArray[np.float64]


def slow_events(
    first: NDArray[np.float32],
    batches: Iterable[tuple[FloatArray, NDArray[np.float32]]],
    end_s: float,
    config: SensorConfig,
    of_memory: np.random.Generator,
    of_pixels: np.random.Generator,
) -> NDArray[Any]:
    """Let pixels without noise follow a light that they have seen for long.

    Parameters
    ----------
    first
        Luminance at time 0, in [0, 1], shape (height, width).
    batches
        Times (n,) [s] after 0, increasing, and luminance (n, height, width) at them.
    end_s
        The last image stays until then.
    config
        Whose thresholds count.
    of_memory
        Draws the level that each pixel remembers: any that makes no event at the start.
    of_pixels
        Draws the thresholds' mismatch.

    Returns
    -------
    NDArray[Any]
        Of EVENT_DTYPE, sorted by time.
    """
    phases = of_memory.uniform(-0.95, 0.95, first.shape)
    threshold = min(config.threshold_on, config.threshold_off)
    before = np.clip(first * np.exp(phases * threshold), 0.0, 1.0).astype(np.float32)
    without_noise = SensorConfig(
        config.threshold_on, config.threshold_off, config.log_eps, config.threshold_mismatch
    )
    pixels = Sensor(without_noise, before, 0.0, of_pixels)
    for times_s, images in batches:
        corner = np.zeros(len(times_s), np.int64)
        pixels.feed(times_s, corner, corner, images)
    return pixels.finish(end_s)
