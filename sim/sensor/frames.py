"""Intensity frames: the mean light of each pixel over an exposure."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from sim.arrays import Float32Array, FloatArray, IntArray
from sim.errors import SimError, check_numbers


@dataclass(frozen=True)
class FrameConfig:
    """Rate and exposure of the intensity frames of a camera like the DAVIS346."""

    rate_hz: float = 50.0  # 0: no frames
    exposure_s: float = 0.005  # [s]

    def __post_init__(self) -> None:
        check_numbers(self, "frames: ", or_zero=("rate_hz",))
        if self.rate_hz and not 0.0 < self.exposure_s * self.rate_hz <= 1.0:
            raise SimError(
                f"frames: exposure_s must be more than 0 and at most 1 / rate_hz = "
                f"{1.0 / self.rate_hz:g} s, got {self.exposure_s}"
            )


@dataclass(frozen=True)
class Frames:
    """Intensity frames of one camera."""

    times_us: IntArray  # (n,) [us], middle of the exposure
    images: NDArray[np.uint8]  # (n, height, width), linear, 255 = luminance 1
    exposure_s: float  # [s]


TakeFrame = Callable[[int, NDArray[np.uint8]], None]
"""Takes frame k; the caller reuses the array (height, width) afterwards."""


class FrameExposer:
    """Integrates the light of each pixel over each exposure, so that moving objects are blurred.

    `background` (height, width) surrounds the crops. `take` gets each of the `n_frames` frames, as
    many as `frame_times_us` has, when its exposure closes; the first begins at `start_s`.
    """

    def __init__(
        self,
        config: FrameConfig,
        background: Float32Array,
        n_frames: int,
        take: TakeFrame,
        start_s: float = 0.0,
    ) -> None:
        self.config = config
        self._start_s = start_s
        self._n_frames = n_frames
        self._take = take
        self._background = background
        self._image = np.empty(background.shape, np.uint8)  # of the frame that closed last
        self._sum = np.zeros(background.shape, np.float32)  # difference from the background
        self._last: tuple[float, int, int, Float32Array] | None = None
        self._open = 0  # index of the frame that is being exposed

    def feed(
        self, times_s: FloatArray, x0_px: IntArray, y0_px: IntArray, luminance: Float32Array
    ) -> None:
        """Take the next instants, as crops of the image with the background around them.

        Shapes as for `sim.sensor.events.Sensor.feed`. Between instants light is linear in time.
        """
        last_s, last_x0, last_y0, last_crop = self._last or (
            times_s[0], x0_px[0], y0_px[0], luminance[0]
        )  # fmt: skip
        k = 0
        while self._open < self._n_frames:
            k, is_closed = _expose(
                k, times_s, x0_px, y0_px, luminance, last_s, last_x0, last_y0, last_crop,
                self._background, self._start_s + self._open * (1.0 / self.config.rate_hz),
                self.config.exposure_s, self._sum,
            )  # fmt: skip
            if not is_closed:
                break
            self._close()
        self._last = float(times_s[-1]), int(x0_px[-1]), int(y0_px[-1]), luminance[-1].copy()

    def finish(self) -> None:
        """Close the remaining frames; after the last instant the image is the background."""
        while self._open < self._n_frames:
            self._close()

    def _close(self) -> None:
        _develop(self._sum, self._background, self._image)
        self._take(self._open, self._image)
        self._open += 1


def frame_times_us(config: FrameConfig, duration_s: float, start_s: float = 0.0) -> IntArray:
    """Return the middle (n,) [us] of each exposure that lies wholly within the duration.

    Frame k is exposed from start_s + k / rate on.
    """
    room_s = duration_s - config.exposure_s - start_s
    n = int(np.floor(room_s * config.rate_hz + 1e-9)) + 1 if config.rate_hz else 0
    starts_s = start_s + np.arange(max(n, 0)) / (config.rate_hz or 1.0)
    return np.rint((starts_s + 0.5 * config.exposure_s) * 1e6).astype(np.int64)


@njit(cache=True, nogil=True)
def _expose(
    first, times_s, x0_px, y0_px, luminance, last_s, last_x0, last_y0, last_crop, background,
    start_s, exposure_s, total,
):  # fmt: skip
    """Add the light of the open exposure, beginning with the interval that ends at `first`."""
    end_s = start_s + exposure_s
    for k in range(first, times_s.size):
        if k > 0:
            last_s, last_x0, last_y0 = times_s[k - 1], x0_px[k - 1], y0_px[k - 1]
            last_crop = luminance[k - 1]
        t0, t1 = last_s, times_s[k]
        a, b = max(t0, start_s), min(t1, end_s)
        if b > a:
            # Integral of the linear interpolation over [a, b], as weights of its two ends.
            middle = (0.5 * (a + b) - t0) / (t1 - t0)
            weight = (b - a) / exposure_s
            before, after = weight * (1.0 - middle), weight * middle
            _add(total, last_crop, last_x0, last_y0, background, before)
            _add(total, luminance[k], x0_px[k], y0_px[k], background, after)
        if t1 >= end_s:
            return k, True
    return times_s.size, False


@njit(cache=True, nogil=True)
def _add(total, crop, x0, y0, background, weight):
    height, width = crop.shape
    w = np.float32(weight)
    for j in range(height):
        into, behind = total[y0 + j, x0 : x0 + width], background[y0 + j, x0 : x0 + width]
        for i in range(width):
            into[i] += w * (crop[j, i] - behind[i])


@njit(cache=True, nogil=True)
def _develop(total, background, image):
    """Write the image of the light summed over an exposure, and clear the sum."""
    for y in range(image.shape[0]):
        for x in range(image.shape[1]):
            light = min(max(background[y, x] + total[y, x], np.float32(0.0)), np.float32(1.0))
            image[y, x] = np.uint8(np.rint(light * np.float32(255.0)))
            total[y, x] = 0.0
