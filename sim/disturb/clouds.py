"""A view in; the events of clouds that drift over the sky behind the drone out.

The sky is drawn in the image, of each camera by itself: two cameras that look apart see other
clouds, and those that they share are too far for their pose. Neither clouds nor drone hide the
other, as clouds change the light behind the drone by little while it passes.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim.disturb.pixels import View
from sim.sensor.events import SensorConfig
from sim.sensor.slow import slow_events

FloatArray = NDArray[np.float64]
Float32Array = NDArray[np.float32]

SKY_LUMINANCE, CLOUD_LUMINANCE = 0.4, 0.85
"""Of the blue and of the brightest white before it, some two to one as in nature."""

SPOTS_PX = 150.0
"""The sky's largest clouds; smaller ones are fainter, as of turbulence."""

_POWER = -11.0 / 6.0  # of amplitudes over wave numbers, in two dimensions (Kolmogorov)
_COVER_STD = 0.7  # of the field, from clear to white: edges are some 10 px wide, billows softer
_STEP_PX = 0.5  # from frame to frame; linear in between
_BATCH = 16  # frames in memory


def clouds(view: View, drift_px_s: float, rng: np.random.Generator) -> NDArray[Any]:
    """Let clouds drift over the view, in one direction and at one speed.

    Parameters
    ----------
    view
    drift_px_s
        8 m/s at a height of 600 m are 6 px/s for a lens of 432 px.
    rng
        Draws the clouds, their direction and what each pixel saw before.
    """
    sky = cloudy_sky(view, rng)
    angle = rng.uniform(0.0, 2.0 * np.pi)
    drift = drift_px_s * np.array([np.cos(angle), np.sin(angle)])
    n = max(2, int(np.ceil(view.duration_s * drift_px_s / _STEP_PX)))
    times_s: FloatArray = view.duration_s * np.arange(1, n + 1) / n
    first = _seen(sky, view, np.zeros((1, 2)))[0]
    return slow_events(
        first, _frames(sky, view, drift, times_s), view.duration_s, SensorConfig(), rng, rng
    )


def cloudy_sky(view: View, rng: np.random.Generator) -> Float32Array:
    """Draw luminance on a torus that the view fits into, (side, side) [px]."""
    side = 2 ** int(np.ceil(np.log2(2 * max(view.width, view.height))))
    waves = np.hypot(np.fft.fftfreq(side)[:, None], np.fft.rfftfreq(side))
    amplitudes = np.hypot(waves, 1.0 / SPOTS_PX) ** _POWER
    amplitudes[0, 0] = 0.0
    field = np.fft.irfft2(amplitudes * np.fft.rfft2(rng.standard_normal((side, side))))
    share = np.clip(0.5 + field / (2.0 * _COVER_STD * field.std()), 0.0, 1.0)
    share *= share * (3.0 - 2.0 * share)  # no crease where clear and white begin
    contrast = np.log(CLOUD_LUMINANCE / SKY_LUMINANCE)
    sky: Float32Array = (SKY_LUMINANCE * np.exp(contrast * share)).astype(np.float32)
    return sky


def _frames(
    sky: Float32Array, view: View, drift_px_s: FloatArray, times_s: FloatArray
) -> Iterator[tuple[FloatArray, Float32Array]]:
    """Yield times (n,) [s] and what is seen at them (n, height, width), in batches."""
    for start in range(0, len(times_s), _BATCH):
        chunk = times_s[start : start + _BATCH]
        yield chunk, _seen(sky, view, -np.multiply.outer(chunk, drift_px_s))


def _seen(sky: Float32Array, view: View, corners_px: FloatArray) -> Float32Array:
    """Cut views (n, height, width) out of the torus, at corners (n, 2) between its pixels."""
    images = np.empty((len(corners_px), view.height, view.width), np.float32)
    for image, corner in zip(images, corners_px, strict=True):
        whole = np.floor(corner).astype(np.int64)
        u, v = (corner - whole).astype(np.float32)
        columns = np.arange(whole[0], whole[0] + view.width + 1) % len(sky)
        rows = np.arange(whole[1], whole[1] + view.height + 1) % len(sky)
        near = sky[np.ix_(rows, columns)]
        across = (1.0 - u) * near[:, :-1] + u * near[:, 1:]
        image[:] = (1.0 - v) * across[:-1] + v * across[1:]
    return images
