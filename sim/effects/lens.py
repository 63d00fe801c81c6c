"""Crops of a sharp image in, crops of the image that a lens makes of it out."""

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.ndimage import correlate1d
from scipy.special import ive

from sim.render.renderer import Crops

_REACH = 4.0  # deviations of the point spread, beyond which 6e-5 of the light would lie


def point_spread(blur_px: float) -> NDArray[np.float64]:
    """Weights (2 r + 1,) of a point's light on the pixels of a row, of exactly this deviation.

    The discrete Gaussian kernel exp(-v) I_n(v), v = blur_px^2 (Lindeberg, TPAMI 1990): samples of
    a Gaussian narrower than 0.7 px are too narrow, by 15 % of the variance at 0.5 px.
    """
    reach = int(np.ceil(_REACH * blur_px))
    weights = ive(np.abs(np.arange(-reach, reach + 1)), blur_px**2)
    spread: NDArray[np.float64] = weights / weights.sum()
    return spread


def blurred_image(image: NDArray[np.float32], blur_px: float) -> NDArray[np.float32]:
    """Blur a whole image (height, width); beyond its border lies what is on it."""
    weights, blurred = point_spread(blur_px), image.astype(np.float64)
    for axis in (0, 1):
        blurred = correlate1d(blurred, weights, axis, mode="nearest")
    return blurred.astype(np.float32)


def blurred_crops(
    crops: Crops,
    blur_px: float,
    background: NDArray[np.float32],
    blurred: NDArray[np.float32],
) -> Crops:
    """Blur crops of an image.

    Parameters
    ----------
    crops
        On the sharp background.
    blur_px
        Deviation of the Gaussian point spread.
    background, blurred
        The background (height, width), sharp and blurred.

    Returns
    -------
    Crops
        On the blurred background, wider by the blur's reach where the image goes on.
    """
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
def _blur(  # type: ignore[no-untyped-def]
    sharp, sharp_x0, sharp_y0, x0_px, y0_px, background, blurred, weights, out
):
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
