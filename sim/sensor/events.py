"""The contrast-threshold model of an event camera, with noise.

L = log(I + eps) is the signal of a pixel. The pixel emits an event whenever L has moved by C+ or C-
from the level that it memorised at its last event, and then memorises anew. Between two instants I,
not L, is linear in time, as the area of a pixel that a moving edge covers grows linearly. So the
threshold crossing has a closed form, and comparing a pixel with its thresholds needs no logarithm.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim.arrays import Float32Array, FloatArray, IntArray
from sim.errors import SimError, check_numbers
from sim.sensor.kernels import (
    EVENT_DTYPE,
    NOISE_STATE_DTYPE,
    EventBuffer,
    process_ideal,
    process_noisy,
)

MIN_THRESHOLD = 0.01  # mismatch never makes a pixel more sensitive than this
HOT_SPREAD = 0.7  # standard deviation of the logarithm of a hot pixel's rate, over pixels


@dataclass(frozen=True)
class SensorConfig:
    """The pixel model. All noise is off by default."""

    threshold_on: float = 0.25  # C+, change of log intensity
    threshold_off: float = 0.25  # C-
    log_eps: float = 1e-3  # added to the intensity, of [0, 1], before the logarithm
    threshold_mismatch: float = 0.0  # standard deviation of C+ and C- over pixels, fixed in time
    refractory_s: float = 0.0  # dead time after an event [s]; the pixel memorises anew at its end
    leak_hz: float = 0.0  # rate of the ON events of a pixel whose memory leaks
    shot_noise_hz: float = 0.0  # rate of noise events of a dark pixel; a quarter of it at I = 1
    background_hz: float = 0.0  # rate of noise events of any pixel, whatever its light
    hot_pixel_share: float = 0.0  # share of pixels that fire without cause
    hot_pixel_hz: float = 50.0  # median rate of their ON events; log-normal over pixels

    def __post_init__(self) -> None:
        positive = ("threshold_on", "threshold_off", "log_eps")
        check_numbers(self, "sensor: ", positive, (f for f in vars(self) if f not in positive))
        if self.hot_pixel_share > 1.0:
            raise SimError(f"sensor: hot_pixel_share is a share of 1, got {self.hot_pixel_share}")

    @property
    def is_ideal_in_time(self) -> bool:
        """Whether pixels respond to light alone, without temporal noise or refractory period."""
        noise_hz = self.leak_hz + self.shot_noise_hz + self.background_hz
        return not (noise_hz or self.refractory_s or self.hot_pixel_share)


PRESETS = {
    "ideal": SensorConfig(),
    # Orders of magnitude of a DAVIS346 in daylight (Hu et al., v2e, CVPRW 2021, section 4).
    "davis346": SensorConfig(
        threshold_mismatch=0.03,
        refractory_s=0.0005,
        leak_hz=0.1,
        shot_noise_hz=0.25,
        hot_pixel_share=2e-4,
    ),
}


class Sensor:
    """The pixels of one camera, with the level that each memorises.

    They start at `time_s` [s] with an image (height, width) of luminance in [0, 1], which causes no
    events. `rng` draws mismatch and noise: the same state of it gives the same events, however the
    recording is cut into crops. `background` surrounds the crops.
    """

    def __init__(
        self,
        config: SensorConfig,
        image: Float32Array,
        time_s: float,
        rng: np.random.Generator,
        background: Float32Array,
    ) -> None:
        self.config = config
        shape = image.shape
        self._image = np.array(image, np.float32, order="C")
        self._background = np.ascontiguousarray(background, np.float32)
        self._reference = self._image.astype(np.float64) + config.log_eps
        on, off = (
            np.maximum(
                nominal + config.threshold_mismatch * rng.standard_normal(shape),
                min(MIN_THRESHOLD, nominal),
            )
            for nominal in (config.threshold_on, config.threshold_off)
        )
        self._up, self._down = np.exp(on), np.exp(-off)
        self._high = (self._reference * self._up - config.log_eps).astype(np.float32)
        self._low = (self._reference * self._down - config.log_eps).astype(np.float32)
        self._time_s = time_s
        # x0, y0, x1, y1 of what may differ from the background
        self._box = np.array([0, 0, *shape[::-1]])
        self._events = EventBuffer()
        self._noise = None if config.is_ideal_in_time else self._start_noise(time_s, rng)

    def _start_noise(self, time_s: float, rng: np.random.Generator) -> NDArray[Any]:
        config, shape = self.config, self._reference.shape
        noise = np.zeros(shape, NOISE_STATE_DTYPE)
        noise["time_s"] = time_s
        noise["dead_until_s"] = -np.inf
        noise["random"] = rng.integers(0, 2**64, shape, np.uint64)
        is_hot = rng.random(shape) < config.hot_pixel_share
        noise["hot_hz"] = np.where(
            is_hot, config.hot_pixel_hz * rng.lognormal(0.0, HOT_SPREAD, shape), 0.0
        )
        rate_hz = config.shot_noise_hz + config.background_hz + noise["hot_hz"]
        noise["leak_per_s"] = config.leak_hz * np.log(self._up)
        with np.errstate(divide="ignore"):
            noise["next_s"] = time_s + rng.standard_exponential(shape) / rate_hz
        if config.leak_hz:
            # The pixels have leaked for long: each starts anywhere between two of its leak events.
            self._reference *= self._up ** -rng.random(shape)
        return noise

    def feed(
        self, times_s: FloatArray, x0_px: IntArray, y0_px: IntArray, luminance: Float32Array
    ) -> None:
        """Take the next instants (n,) [s], increasing, as crops with the background around them.

        The crops (n, height, width) lie wholly within the image and start at columns and rows (n,).
        """
        shared = (
            times_s, x0_px, y0_px, np.ascontiguousarray(luminance), self._background,
            self._time_s, self._box, self._image, self._reference, self._up, self._down,
        )  # fmt: skip
        if self._noise is None:
            levels = (self._high, self._low, self.config.log_eps)
            self._events.follow(process_ideal, *shared, *levels)
        else:
            config = self.config
            rates = (config.log_eps, config.refractory_s, config.shot_noise_hz)
            self._events.follow(process_noisy, *shared, self._noise, *rates, config.background_hz)
        self._time_s = float(times_s[-1])

    def take_settled(self) -> NDArray[Any]:
        """Remove and return the events that no later event precedes, sorted as by `finish`.

        Empty for pixels with temporal noise or effects: a skipped pixel's events are found later.
        """
        if self._noise is not None:
            return np.empty(0, EVENT_DTYPE)
        return self._events.take(np.rint(self._time_s * 1e6), *self._image.shape[::-1])

    def finish(self, time_s: float) -> NDArray[Any]:
        """Hold the last image until `time_s` and return all events that were not taken yet.

        They are sorted by time, then row, column and order of emission.
        """
        if self._noise is not None:
            self._box[:] = 0, 0, *self._image.shape[::-1]
            zero = np.zeros(1, np.int64)
            last_s = np.array([max(time_s, self._time_s)])
            self.feed(last_s, zero, zero, self._image[None].copy())
        return self._events.take(np.inf, *self._image.shape[::-1])


def events_from_frames(
    frames: NDArray[Any],
    times_s: FloatArray,
    config: SensorConfig | None = None,
    rng: np.random.Generator | None = None,
) -> NDArray[Any]:
    """Turn a stack of frames, a user's own video for instance, into events, sorted by time.

    Frames (n, height, width) of linear light (undo a video's gamma first) are floating point in
    [0, 1], or unsigned integers whose largest value stands for 1. Times (n,) [s] increase. `rng`
    is by default seeded with 0. SimError for shapes that do not fit, times that do not increase,
    fewer than 2 frames, or values outside [0, 1] or not finite.
    """
    times_s = np.asarray(times_s, np.float64)
    if frames.ndim != 3 or times_s.shape != frames.shape[:1] or len(times_s) < 2:
        raise SimError(
            "frames: expected an array (n, height, width) and n >= 2 times, "
            f"got {frames.shape} and {times_s.shape}"
        )
    if not (np.isfinite(times_s).all() and (np.diff(times_s) > 0).all()):
        raise SimError("frames: times must be finite and increase from frame to frame; sort them")
    config = config or SensorConfig()
    rng = rng or np.random.default_rng(0)
    first = _unit_range(frames[0])
    sensor = Sensor(config, first, float(times_s[0]), rng, first)
    zero = np.zeros(1, np.int64)
    for time_s, frame in zip(times_s[1:], frames[1:], strict=True):
        sensor.feed(np.array([time_s]), zero, zero, _unit_range(frame)[None])
    return sensor.finish(float(times_s[-1]))


def _unit_range(frame: NDArray[Any]) -> Float32Array:
    if np.issubdtype(frame.dtype, np.unsignedinteger):
        return np.ascontiguousarray(frame, np.float32) / np.float32(np.iinfo(frame.dtype).max)
    image = np.ascontiguousarray(frame, np.float32)
    low, high = image.min(), image.max()
    if not (low >= 0.0 and high <= 1.0):  # NaN fails too
        raise SimError(
            f"frames: expected linear intensities in [0, 1], got values from {low} to {high}; "
            "scale them, or pass unsigned integers"
        )
    return image


def slow_events(
    first: Float32Array,
    batches: Iterable[tuple[FloatArray, Float32Array]],
    config: SensorConfig,
    of_memory: np.random.Generator,
    of_pixels: np.random.Generator,
) -> NDArray[Any]:
    """Return, by time, the events of pixels without temporal noise under slowly changing light.

    `first` is the luminance (height, width) in [0, 1] at time 0, `batches` are later times (n,) [s]
    and luminance (n, height, width). Of the config, thresholds, mismatch and `log_eps` count.
    `of_memory` draws each pixel's memorised level, `of_pixels` the mismatch.
    """
    phases = of_memory.uniform(-0.95, 0.95, first.shape)
    threshold = min(config.threshold_on, config.threshold_off)
    before = np.clip(first * np.exp(phases * threshold), 0.0, 1.0).astype(np.float32)
    without_noise = SensorConfig(
        config.threshold_on, config.threshold_off, config.log_eps, config.threshold_mismatch
    )
    pixels = Sensor(without_noise, before, 0.0, of_pixels, before)
    for times_s, images in batches:
        corner = np.zeros(len(times_s), np.int64)
        pixels.feed(times_s, corner, corner, images)
    return pixels.finish(0.0)  # they act on changes alone
