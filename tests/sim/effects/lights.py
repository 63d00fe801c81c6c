"""Light for a sensor with effects, and pixels that look at it."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim.effects.config import SensorEffects
from sim.effects.pixels import EffectsSensor
from sim.sensor.events import SensorConfig
from tests.sim.sensor.videos import rng

SHAPE = (50, 60)
FLICKER_RAD = 1.0  # away from crests, where a threshold may just be reached or not
QUIET = SensorConfig(threshold_on=20.0, threshold_off=20.0)  # only noise makes events


def events_of(
    light: NDArray[Any],
    times_s: NDArray[np.float64],
    effects: SensorEffects,
    config: SensorConfig | None = None,
    seed: int = 1,
) -> NDArray[Any]:
    """Events of a video (n, height, width) of linear light at times (n,) [s]."""
    video = np.ascontiguousarray(light, np.float32)
    about = (config or SensorConfig(), effects, video[0], float(times_s[0]), rng(seed))
    sensor = EffectsSensor(*about, effects_rng=rng(seed + 1000), flicker_rad=FLICKER_RAD)
    zeros = np.zeros(len(times_s) - 1, np.int64)
    sensor.feed(times_s[1:], zeros, zeros, video[1:])
    return sensor.finish(float(times_s[-1]))


def still_events(
    effects: SensorEffects,
    light: float,
    duration_s: float,
    config: SensorConfig = QUIET,
    shape: tuple[int, int] = SHAPE,
) -> NDArray[Any]:
    """Events of pixels that see one and the same light all along."""
    image = np.full(shape, light, np.float32)
    sensor = EffectsSensor(config, effects, image, 0.0, rng(11), effects_rng=rng(12))
    return sensor.finish(duration_s)


def stepping(before: float, after: float, at_s: float, until_s: float, shape: Any = (1, 1)) -> Any:
    """A video of light that changes once, within a nanosecond, and its times."""
    times_s = np.array([0.0, at_s, at_s + 1e-9, until_s])
    levels = np.array([before, before, after, after], np.float32)
    return np.broadcast_to(levels[:, None, None], (4, *shape)), times_s
