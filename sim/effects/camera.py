"""The configured imperfections of one camera: of its lens, pixels, readout and frames."""

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.ndimage import correlate1d
from scipy.special import ive, ndtri

from sim.arrays import Float32Array, FloatArray
from sim.effects.config import SensorEffects
from sim.effects.pixels import EffectsSensor
from sim.render.renderer import Crops
from sim.seeds import generator
from sim.sensor.events import Sensor, SensorConfig
from sim.sensor.frames import FrameConfig, TakeFrame

# Branches of the seed, beside those of `sim.recording` and `sim.disturb`: the lamps are common to
# the cameras; pixels, phase and frames are drawn for each.
_STREAM = 3
_LAMPS, _PIXELS, _PHASE, _FRAMES = range(4)


class CameraEffects:
    """The imperfections between the light of one camera and its recording; none by default.

    `background` is the luminance (height, width) of the empty scene, `index` the camera's, 0 or 1.
    """

    def __init__(
        self,
        effects: SensorEffects,
        sensor: SensorConfig,
        frames: FrameConfig,
        background: Float32Array,
        seed: int,
        index: int,
    ) -> None:
        self.effects = effects.of_camera(index)
        self.frames = frames
        self._sensor, self._seed, self._index, self._sharp = sensor, seed, index, background
        self.background = blurred_image(background, effects.blur_px)
        """Luminance (height, width) of the empty scene behind the lens."""
        self.flicker_rad = self._rng(_LAMPS, 0).uniform(0.0, 2.0 * np.pi)  # common to the cameras
        share = effects.frame_phase_spread * self._rng(_PHASE, index).random()
        self.frame_start_s = share / frames.rate_hz if frames.rate_hz else 0.0
        """When the first frame's exposure begins [s]."""

    def through_lens(self, crops: Crops) -> Crops:
        """Blur crops of the sharp image."""
        if not self.effects.blur_px:
            return crops
        return blurred_crops(crops, self.effects.blur_px, self._sharp, self.background)

    def start_sensor(self, image: Float32Array, time_s: float, rng: np.random.Generator) -> Sensor:
        """Return the sensor, started with an image behind the lens as `Sensor` is."""
        if self.effects.is_none:
            return Sensor(self._sensor, image, time_s, rng, self.background)
        about = (self._sensor, self.effects, self._rng(_PIXELS, self._index), self.flicker_rad)
        return EffectsSensor(*about, image, time_s, rng, self.background)

    def read_out(self, events: NDArray[Any], end_s: float) -> NDArray[Any]:
        """Return the events that the readout delivers of a recording that ends at `end_s` [s].

        Events are sorted by time [us, scene] before and after; those returned lie in the recording.
        """
        effects, frames = self.effects, self.frames
        if effects.frame_gap_s and frames.rate_hz:
            n_frames = int(np.ceil(end_s * frames.rate_hz)) + 1
            ends_s = self.frame_start_s + np.arange(n_frames) / frames.rate_hz + frames.exposure_s
            gaps_us = 1e6 * ends_s
            gap = np.searchsorted(gaps_us, events["t"], side="right") - 1
            is_lost = (gap >= 0) & (events["t"] < gaps_us[gap] + 1e6 * effects.frame_gap_s)
            events = events[~is_lost]
        if effects.scan_s:  # all pixels are scanned periodically: events bear the next scan's time
            events, period_us = events.copy(), 1e6 * effects.scan_s
            events["t"] = np.rint(np.ceil(events["t"] / period_us) * period_us)
        if effects.readout_hz:
            events = queued(events, effects.readout_hz, effects.readout_queue)
        is_within = (events["t"] >= 0) & (events["t"] <= np.rint(1e6 * end_s))
        recorded: NDArray[Any] = events[is_within]
        return recorded

    def through_noise(self, take: TakeFrame) -> TakeFrame:
        """Wrap `take`, so that it is given frames with flicker and noise."""
        effects = self.effects
        if not (effects.frame_read_noise or effects.frame_full_well_e or effects.flicker_depth):
            return take
        rng = self._rng(_FRAMES, self._index)

        def take_without_noise(k: int, image: NDArray[np.uint8]) -> None:
            levels = np.arange(256) * self.brightness(k) / _FULL_SCALE
            variance = np.full(256, effects.frame_read_noise**2)
            if effects.frame_full_well_e:
                variance += levels / effects.frame_full_well_e
            deviation = np.sqrt(variance)
            draws = rng.integers(0, 2**64, -(-image.size // (64 // _BITS)), np.uint64)
            noisy = np.empty_like(image)
            _add_noise(
                image.reshape(-1), draws, (_FULL_SCALE * levels).astype(np.float32),
                (_FULL_SCALE * deviation).astype(np.float32), _QUANTILES, noisy.reshape(-1),
            )  # fmt: skip
            take(k, noisy)

        return take_without_noise

    def brightness(self, k: int) -> float:
        """Return the mean of the lamps' light over frame k's exposure, over the long-run mean."""
        depth, exposure_s = self.effects.flicker_depth, self.frames.exposure_s
        rad_s = 2.0 * np.pi * self.effects.flicker_hz
        from_rad = rad_s * (self.frame_start_s + k / self.frames.rate_hz) + self.flicker_rad
        change = np.sin(from_rad + rad_s * exposure_s) - np.sin(from_rad)
        return float(1.0 + depth * change / (rad_s * exposure_s))

    def _rng(self, stream: int, index: int) -> np.random.Generator:
        return generator(self._seed, _STREAM, stream, index)


_REACH = 4.0  # half width of the point spread, in deviations: 6e-5 of the light lies beyond


def point_spread(blur_px: float) -> FloatArray:
    """Return weights (2 r + 1,) of a point's light along a row, of exactly this deviation [px].

    They are the discrete Gaussian kernel exp(-v) I_n(v), v = blur_px^2 (Lindeberg, TPAMI 1990):
    samples of a Gaussian below 0.7 px are too narrow, by 15 % of the variance at 0.5 px.
    """
    reach = int(np.ceil(_REACH * blur_px))
    weights = ive(np.abs(np.arange(-reach, reach + 1)), blur_px**2)
    spread: FloatArray = weights / weights.sum()
    return spread


def blurred_image(image: Float32Array, blur_px: float) -> Float32Array:
    """Blur a whole image (height, width); beyond its border, its border pixels repeat."""
    weights, blurred = point_spread(blur_px), image.astype(np.float64)
    for axis in (0, 1):
        blurred = correlate1d(blurred, weights, axis, mode="nearest")
    return blurred.astype(np.float32)


def blurred_crops(
    crops: Crops, blur_px: float, background: Float32Array, blurred: Float32Array
) -> Crops:
    """Blur crops, which widens them, given the whole background sharp and blurred."""
    weights = point_spread(blur_px).astype(np.float32)
    margin = len(weights) // 2
    n, height, width = crops.luminance.shape
    size = (min(height + 2 * margin, background.shape[0]),
            min(width + 2 * margin, background.shape[1]))  # fmt: skip
    y0 = np.clip(crops.y0_px - margin, 0, background.shape[0] - size[0])
    x0 = np.clip(crops.x0_px - margin, 0, background.shape[1] - size[1])
    luminance = np.empty((n, *size), np.float32)
    _blur(
        crops.luminance, crops.x0_px, crops.y0_px, x0, y0, background, blurred, weights, luminance
    )
    return Crops(crops.times_s, x0, y0, luminance)


@njit(cache=True, nogil=True)
def _blur(sharp, sharp_x0, sharp_y0, x0_px, y0_px, background, blurred, weights, out):
    """Add the blurred difference from the background to the blurred background, row by row."""
    n, height, width = out.shape
    reach = weights.size // 2
    rows = np.zeros((sharp.shape[1], width), np.float32)
    for k in range(n):
        dx, dy = sharp_x0[k] - x0_px[k], sharp_y0[k] - y0_px[k]
        rows[:] = 0.0
        for j in range(sharp.shape[1]):
            for i in range(sharp.shape[2]):
                behind = background[sharp_y0[k] + j, sharp_x0[k] + i]
                difference = sharp[k, j, i] - behind
                if difference != 0.0:
                    for w in range(weights.size):
                        x = dx + i + w - reach
                        if 0 <= x < width:
                            rows[j, x] += weights[w] * difference
        for j in range(height):
            for i in range(width):
                out[k, j, i] = blurred[y0_px[k] + j, x0_px[k] + i]
        for j in range(sharp.shape[1]):
            for w in range(weights.size):
                y = dy + j + w - reach
                if 0 <= y < height:
                    for i in range(width):
                        out[k, y, i] += weights[w] * rows[j, i]


def queued(events: NDArray[Any], readout_hz: float, queue: int) -> NDArray[Any]:
    """Read sorted events out one by one, stamped then; all beyond `queue` waiting are lost."""
    stamps_us, is_read = _serve(events["t"], 1e6 / readout_hz, queue)
    delivered: NDArray[Any] = events[is_read]
    delivered["t"] = stamps_us[is_read]
    return delivered


@njit(cache=True, nogil=True)
def _serve(t_us, service_us, queue):
    stamps_us = np.empty(t_us.size, np.int64)
    is_read = np.zeros(t_us.size, np.bool_)
    free_us = -np.inf  # when all waiting events have been read out
    for i in range(t_us.size):
        wait_us = free_us - t_us[i]
        if wait_us > (queue + 1e-6) * service_us:
            continue
        stamp_us = max(free_us, np.float64(t_us[i]))
        stamps_us[i], is_read[i] = np.int64(np.floor(stamp_us + 1e-6)), True
        free_us = stamp_us + service_us
    return stamps_us, is_read


_FULL_SCALE = 255.0
_BITS = 12  # of a 64-bit draw, for one pixel
# The normal distribution's quantiles, of deviation 1: up to 3.7 deviations, enough for 8 bits.
_QUANTILES = ndtri((np.arange(1 << _BITS) + 0.5) / (1 << _BITS)).astype(np.float32)
_QUANTILES /= _QUANTILES.std()


@njit(cache=True, nogil=True)
def _add_noise(image, draws, mean, deviation, quantiles, noisy):
    """Draw each pixel's level, all arrays flat; 12 bits of a draw make one pixel's noise."""
    per_draw = 64 // _BITS
    for d in range(draws.size):
        bits = draws[d]
        for i in range(d * per_draw, min((d + 1) * per_draw, image.size)):
            quantile = quantiles[bits & np.uint64((1 << _BITS) - 1)]
            bits >>= np.uint64(_BITS)
            level = mean[image[i]] + deviation[image[i]] * quantile
            noisy[i] = np.uint8(
                min(max(level, np.float32(0.0)), np.float32(255.0)) + np.float32(0.5)
            )
