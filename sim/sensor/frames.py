"""Luminance over time in, exposed intensity frames out."""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from sim.errors import SimError


@dataclass(frozen=True)
class FrameConfig:
    """The frame side of a camera like the DAVIS346."""

    rate_hz: float = 50.0  # 0: no frames
    exposure_s: float = 0.005  # [s]

    def __post_init__(self) -> None:
        if not (np.isfinite(self.rate_hz) and self.rate_hz >= 0.0):
            raise SimError(f"frames: rate_hz must be 0 or a positive number, got {self.rate_hz}")
        if self.rate_hz and not 0.0 < self.exposure_s * self.rate_hz <= 1.0:
            raise SimError(
                f"frames: exposure_s must be more than 0 and at most 1 / rate_hz = "
                f"{1.0 / self.rate_hz:g} s, got {self.exposure_s}"
            )


@dataclass(frozen=True)
class Frames:
    """Intensity frames of one camera."""

    times_us: NDArray[np.int64]  # (n,) [us], middle of the exposure
    images: NDArray[np.uint8]  # (n, height, width), linear, 255 = luminance 1
    exposure_s: float  # [s]


class FrameExposer:
    """Integrates the light of each pixel over each exposure, so that what moves is blurred.

    Parameters
    ----------
    config
    background
        Luminance around the crops, shape (height, width).
    duration_s
        Frame k is exposed from k / rate on; only frames exposed wholly before this time are taken.
    """

    def __init__(
        self, config: FrameConfig, background: NDArray[np.float32], duration_s: float
    ) -> None:
        self.config = config
        room_s = duration_s - config.exposure_s
        n = int(np.floor(room_s * config.rate_hz + 1e-9)) + 1 if config.rate_hz else 0
        self._background = background
        still = _quantise(background)
        self._images = np.broadcast_to(still, (max(n, 0), *still.shape)).copy()
        self._sum = np.zeros(background.shape, np.float32)  # difference from the background
        self._last: tuple[float, int, int, NDArray[np.float32]] | None = None
        self._open = np.zeros(1, np.int64)  # index of the frame that is being exposed

    def feed(
        self,
        times_s: NDArray[np.float64],
        x0_px: NDArray[np.int64],
        y0_px: NDArray[np.int64],
        luminance: NDArray[np.float32],
    ) -> None:
        """Take the next instants: crops of the image, the background around them.

        Shapes as for `sim.sensor.events.Sensor.feed`. Between instants light is linear in time.
        """
        if not len(self._images):
            return
        time_s, x0, y0, crop = self._last or (times_s[0], x0_px[0], y0_px[0], luminance[0])
        _expose(
            times_s, x0_px, y0_px, luminance, time_s, x0, y0, crop, self._background,
            1.0 / self.config.rate_hz, self.config.exposure_s, self._open, self._sum, self._images,
        )  # fmt: skip
        self._last = float(times_s[-1]), int(x0_px[-1]), int(y0_px[-1]), luminance[-1].copy()

    def finish(self) -> Frames:
        """Return all frames; what follows the last instant is background."""
        if self._open[0] < len(self._images):
            _close_frame(self._open[0], self._sum, self._background, self._images)
        starts_s = np.arange(len(self._images)) / (self.config.rate_hz or 1.0)
        middle_us = np.rint((starts_s + 0.5 * self.config.exposure_s) * 1e6).astype(np.int64)
        return Frames(middle_us, self._images, self.config.exposure_s)


def _quantise(image: NDArray[np.float32]) -> NDArray[np.uint8]:
    levels: NDArray[np.uint8] = np.rint(np.clip(image, 0.0, 1.0) * np.float32(255.0)).astype(
        np.uint8
    )
    return levels


@njit(cache=True, nogil=True)
def _expose(  # type: ignore[no-untyped-def]
    times_s, x0_px, y0_px, luminance, last_s, last_x0, last_y0, last_crop, background,
    period_s, exposure_s, open_frame, total, images,
):  # fmt: skip
    n_frames = images.shape[0]
    for k in range(times_s.size):
        t0, t1 = last_s, times_s[k]
        # Every exposure that this interval touches, in turn.
        while open_frame[0] < n_frames:
            start = open_frame[0] * period_s
            end = start + exposure_s
            if t0 >= end:
                _close_frame(open_frame[0], total, background, images)
                open_frame[0] += 1
                continue
            a, b = max(t0, start), min(t1, end)
            if b > a:
                # Integral of the linear interpolation over [a, b], as weights of its two ends.
                middle = (0.5 * (a + b) - t0) / (t1 - t0)
                weight = (b - a) / exposure_s
                _add(total, last_crop, last_x0, last_y0, background, weight * (1.0 - middle))
                _add(total, luminance[k], x0_px[k], y0_px[k], background, weight * middle)
            if t1 < end:
                break
            _close_frame(open_frame[0], total, background, images)
            open_frame[0] += 1
        last_s, last_x0, last_y0, last_crop = t1, x0_px[k], y0_px[k], luminance[k]


@njit(cache=True, nogil=True)
def _add(total, crop, x0, y0, background, weight):  # type: ignore[no-untyped-def]
    height, width = crop.shape
    w = np.float32(weight)
    for j in range(height):
        for i in range(width):
            total[y0 + j, x0 + i] += w * (crop[j, i] - background[y0 + j, x0 + i])


@njit(cache=True, nogil=True)
def _close_frame(k, total, background, images):  # type: ignore[no-untyped-def]
    """Write frame k where its light differs from the background's, and start anew."""
    height, width = total.shape
    for y in range(height):
        for x in range(width):
            if total[y, x] != 0.0:
                light = min(max(background[y, x] + total[y, x], np.float32(0.0)), np.float32(1.0))
                images[k, y, x] = np.uint8(np.rint(light * np.float32(255.0)))
                total[y, x] = 0.0
