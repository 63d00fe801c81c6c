"""Frames as light makes them in, frames with flicker and noise out."""

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.special import ndtri

from sim.effects.config import SensorEffects
from sim.sensor.frames import FrameConfig, Images

_FULL_SCALE = 255.0
_BITS = 12  # of a draw
# The normal distribution's quantiles, of deviation 1: up to 3.7 deviations, enough for 8 bits.
_QUANTILES = ndtri((np.arange(1 << _BITS) + 0.5) / (1 << _BITS)).astype(np.float32)
_QUANTILES /= _QUANTILES.std()


class NoisyImages:
    """Takes frames in place of others, to which it hands them on.

    Parameters
    ----------
    images
        Takes the frames afterwards.
    effects, config
    start_s
        When the first exposure begins.
    rng
    flicker_rad
        Phase of the lamps at time 0.
    """

    def __init__(
        self,
        images: Images,
        effects: SensorEffects,
        config: FrameConfig,
        start_s: float,
        rng: np.random.Generator,
        flicker_rad: float,
    ) -> None:
        self._images = images
        self._effects = effects
        self._config = config
        self._start_s = start_s
        self._rng = rng
        self._flicker_rad = flicker_rad

    def __setitem__(self, k: int, image: NDArray[np.uint8], /) -> None:
        """Take frame k, (height, width)."""
        effects = self._effects
        levels = np.arange(256) * self._brightness(k) / _FULL_SCALE
        variance = np.full(256, effects.frame_read_noise**2)
        if effects.frame_full_well_e:
            variance += levels / effects.frame_full_well_e
        deviation = np.sqrt(variance)
        per_draw = 64 // _BITS
        draws = self._rng.integers(0, 2**64, -(-image.size // per_draw), np.uint64)
        noisy = np.empty_like(image)
        _add_noise(
            image.reshape(-1), draws, (_FULL_SCALE * levels).astype(np.float32),
            (_FULL_SCALE * deviation).astype(np.float32), _QUANTILES, noisy.reshape(-1),
        )  # fmt: skip
        self._images[k] = noisy

    def _brightness(self, k: int) -> float:
        """Give the mean of the lamps' light during an exposure, over its mean in the long run."""
        depth, exposure_s = self._effects.flicker_depth, self._config.exposure_s
        rad_s = 2.0 * np.pi * self._effects.flicker_hz
        from_rad = rad_s * (self._start_s + k / self._config.rate_hz) + self._flicker_rad
        change = np.sin(from_rad + rad_s * exposure_s) - np.sin(from_rad)
        return float(1.0 + depth * change / (rad_s * exposure_s))


@njit(cache=True, nogil=True)
def _add_noise(image, draws, mean, deviation, quantiles, noisy):  # type: ignore[no-untyped-def]
    """Draw each pixel's level, all flat; 12 bits of a draw make one pixel's noise."""
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
