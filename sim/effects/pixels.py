"""The pixels of `sim.sensor.events` with the imperfections of real ones."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim.arrays import Float32Array, FloatArray, IntArray
from sim.effects.config import DIM_LUX, SensorEffects
from sim.effects.kernels import PIXEL_DTYPE, PixelRates, follow_all, follow_changes
from sim.errors import SimError
from sim.sensor.events import HOT_SPREAD, Sensor, SensorConfig

CLUSTER_PX = 3  # side of a hot cluster
_TABLE = 4097  # entries, in steps of a quarter of `log_eps`: at most 1 % off in between


class EffectsSensor(Sensor):
    """The pixels of one camera, with the effects that act within a pixel.

    At the start they have settled on their first image and memorised it. `effects_rng` draws what
    the effects add; `flicker_rad` is the phase of the lamps at time 0. SimError when the image is
    smaller than a hot cluster.
    """

    def __init__(
        self,
        config: SensorConfig,
        effects: SensorEffects,
        effects_rng: np.random.Generator,
        flicker_rad: float,
        image: Float32Array,
        time_s: float,
        rng: np.random.Generator,
        background: Float32Array,
    ) -> None:
        super().__init__(config, image, time_s, rng, background)
        if self._noise is None:
            self._noise = self._start_noise(time_s, rng)
        self._pixels = _start(self._noise, config, effects, self._up, self._image, effects_rng)
        rad = 2.0 * np.pi * effects.flicker_hz * time_s + flicker_rad
        lit = self._image * _flicker_at(rad, self._image, config, effects)
        level = self._reference * (lit + config.log_eps) / (self._image + config.log_eps)
        self._pixels["down"], self._pixels["level"] = self._down, level
        # The rate of the dim-light shot noise, over luminance from 0 to 1.
        lux = effects.illuminance_lux * (np.linspace(0.0, 1.0, _TABLE) + config.log_eps)
        dim_hz = effects.dim_noise_on_hz + effects.dim_noise_off_hz
        self._dim_hz = dim_hz * np.maximum(lux / DIM_LUX, 1.0) ** (-effects.dim_noise_exponent)
        same = {name: value for name, value in vars(effects).items() if name in PixelRates._fields}
        self._rates_of_all = PixelRates(
            eps=config.log_eps,
            lux=effects.illuminance_lux,
            refractory_s=config.refractory_s,
            shot_hz=config.shot_noise_hz,
            background_hz=config.background_hz,
            dim_on_share=effects.dim_noise_on_hz / dim_hz if dim_hz else 0.0,
            flicker_rad_s=2.0 * np.pi * effects.flicker_hz,
            flicker_rad=flicker_rad,
            **same,
        )

    def feed(
        self, times_s: FloatArray, x0_px: IntArray, y0_px: IntArray, luminance: Float32Array
    ) -> None:
        """Take the next instants, as `Sensor.feed` does."""
        self._events.follow(
            follow_changes, times_s, x0_px, y0_px, np.ascontiguousarray(luminance),
            self._background, self._time_s, self._box, self._image, self._pixels,
            self._rates_of_all, self._dim_hz,
        )  # fmt: skip
        self._time_s = float(times_s[-1])

    def finish(self, time_s: float) -> NDArray[Any]:
        """Hold the last image until `time_s` and return all events, as `Sensor.finish` does.

        Latency may stamp some after `time_s`, and jitter some before the start.
        """
        self._time_s = max(time_s, self._time_s)
        self._events.follow(
            follow_all, self._time_s, self._image, self._pixels, self._rates_of_all, self._dim_hz
        )  # fmt: skip
        return self._events.take(np.inf, *self._image.shape[::-1])


def _start(
    noise: NDArray[Any],
    config: SensorConfig,
    effects: SensorEffects,
    up: FloatArray,
    image: Float32Array,
    rng: np.random.Generator,
) -> NDArray[Any]:
    """Draw each pixel's initial state, except for what `Sensor` has drawn into `noise`."""
    pixels = np.zeros(image.shape, PIXEL_DTYPE)
    for name in ("time_s", "dead_until_s", "hot_hz", "random"):
        pixels[name] = noise[name]
    pixels["up"], pixels["signal"] = up, image
    pixels["budget"] = rng.standard_exponential(image.shape)
    spread = np.log(10.0) * effects.noise_spread_decades
    # Log-normal about the nominal rate, as in v2e; divided by its mean, which keeps the mean rate.
    pixels["noisiness"] = rng.lognormal(-0.5 * spread**2, spread, image.shape)
    pixels["mean_leak_per_s"] = config.leak_hz * np.log(up) * pixels["noisiness"]
    late = np.maximum(1.0 + effects.leak_jitter * rng.standard_normal(image.shape), 0.1)
    pixels["leak_per_s"] = pixels["mean_leak_per_s"] / late
    for _ in range(effects.hot_clusters):
        height, width = image.shape
        if min(height, width) < CLUSTER_PX:
            raise SimError(
                f"effects: a hot cluster of {CLUSTER_PX} x {CLUSTER_PX} px does not fit into "
                f"{width} x {height} px: leave out hot_clusters"
            )
        y0 = int(rng.integers(0, height - CLUSTER_PX + 1))
        x0 = int(rng.integers(0, width - CLUSTER_PX + 1))
        pixels["hot_hz"][y0 : y0 + CLUSTER_PX, x0 : x0 + CLUSTER_PX] = (
            effects.hot_cluster_hz * rng.lognormal(0.0, HOT_SPREAD, (CLUSTER_PX, CLUSTER_PX))
        )
    return pixels


def _flicker_at(
    rad_at: float, image: Float32Array, config: SensorConfig, effects: SensorEffects
) -> FloatArray:
    """Return the factors (height, width) by which flicker multiplies each pixel's signal."""
    rad: FloatArray = np.full(image.shape, rad_at)
    depth: Any = effects.flicker_depth
    if effects.cutoff_hz_per_lux:
        lux = effects.illuminance_lux * (image.astype(np.float64) + config.log_eps)
        low_hz, high_hz = effects.cutoff_min_hz, effects.cutoff_max_hz
        ratio = effects.flicker_hz / np.clip(effects.cutoff_hz_per_lux * lux, low_hz, high_hz)
        rad, depth = rad - np.arctan(ratio), depth / np.hypot(1.0, ratio)
    factor: FloatArray = 1.0 + depth * np.cos(rad)
    return factor
