"""Light for a sensor: videos, and what crosses its thresholds, by the definition."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim.sensor.events import Sensor, SensorConfig

EPS = 1e-3
IDEAL = SensorConfig()
ZERO = np.zeros(1, np.int64)
# The general loop in place of the one for ideal pixels, with noise too rare to be seen.
SLOW = SensorConfig(refractory_s=1e-15)


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def smooth_video(n: int, height: int, width: int, seed: int = 0) -> NDArray[np.float32]:
    """Blobs that drift over each other: every pixel brightens and darkens by many thresholds."""
    y, x = np.mgrid[:height, :width]
    t = np.arange(n)[:, None, None] / n
    phase = rng(seed).uniform(0, 2 * np.pi, 3)
    waves = (
        np.sin(0.31 * x + 9 * t + phase[0])
        + np.sin(0.23 * y - 7 * t + phase[1])
        + np.sin(0.11 * (x + y) + 13 * t + phase[2])
    )
    return (0.5 + 0.1666 * waves).astype(np.float32)


def step_video(before: float, after: float, n: int = 2) -> NDArray[np.float32]:
    """One pixel that changes once, after the first frame."""
    video = np.full((n, 1, 1), after, np.float32)
    video[0] = before
    return video


def reference_levels(
    events: NDArray[Any], thresholds_on: Any, thresholds_off: Any, shape: tuple[int, int]
) -> NDArray[np.float64]:
    """What the events add up to at each pixel, in log intensity."""
    change = np.zeros(shape)
    x, y = events["x"], events["y"]
    on = events["p"] == 1
    step = np.where(
        on,
        np.broadcast_to(thresholds_on, shape)[y, x],
        -np.broadcast_to(thresholds_off, shape)[y, x],
    )
    np.add.at(change, (y, x), step)
    return change


def spread_px(video: NDArray[Any], seed: int) -> list[tuple[NDArray[np.int64], ...]]:
    """Random rectangles around the places where each frame differs from the first one."""
    generator = rng(seed)
    boxes = []
    for frame in video:
        ys, xs = np.nonzero(frame != video[0])
        low = np.array([xs.min(), ys.min()]) if len(xs) else np.array([3, 3])
        high = np.array([xs.max(), ys.max()]) + 1 if len(xs) else np.array([4, 4])
        margin = generator.integers(0, 3, (2, 2))
        size = np.array(frame.shape[::-1])
        boxes.append((np.maximum(low - margin[0], 0), np.minimum(high + margin[1], size)))
    return boxes


def feed_crop(sensor: Sensor, time_s: float, frame: NDArray[Any], box: Any) -> None:
    (x0, y0), (x1, y1) = box
    crop = np.ascontiguousarray(frame[None, y0:y1, x0:x1])
    sensor.feed(np.array([time_s]), np.array([x0]), np.array([y0]), crop)
