"""A seed to a picture of a room's wall out of focus: the background of an indoor recording."""

import cv2
import numpy as np
from numpy.typing import NDArray

from sim.errors import SimError

FloatArray = NDArray[np.float64]

MEAN_LUMINANCE = 0.4
SPOTS_PX = (6, 12, 24, 48)  # of the plaster, from fine to coarse
SPOTS_STD = 0.12  # of the logarithm
N_THINGS = 9  # posters, shelves, cables and sockets on it
THINGS_STD = 0.35  # of the logarithm of how bright they are beside the wall
_LOW, _HIGH = 0.05, 0.95


def wall(
    width: int, height: int, rng: np.random.Generator, defocus_px: float = 2.0
) -> NDArray[np.float32]:
    """Draw a wall with plaster, an uneven light on it, and things that hang there.

    Parameters
    ----------
    width, height
        [px]
    rng
        The only source of randomness.
    defocus_px
        Deviation of the Gauss that stands for the blur of what is far behind the focus [px].

    Returns
    -------
    NDArray[np.float32]
        Linear luminance in [0, 1], (height, width).

    Raises
    ------
    SimError
        When the blur is negative or not finite.
    """
    if not (np.isfinite(defocus_px) and defocus_px >= 0.0):
        raise SimError(f"wall: defocus_px must be 0 or a positive number, got {defocus_px}")
    level = np.full((height, width), np.log(MEAN_LUMINANCE))
    level += SPOTS_STD * _spots(width, height, rng)
    for _ in range(N_THINGS):
        x, y = rng.uniform(0.0, width), rng.uniform(0.0, height)
        wide, high = np.exp(rng.uniform(np.log(4.0), np.log(0.5 * min(width, height)), 2))
        box = (slice(max(0, int(y - high / 2)), int(y + high / 2) + 1),
               slice(max(0, int(x - wide / 2)), int(x + wide / 2) + 1))  # fmt: skip
        level[box] += THINGS_STD * rng.standard_normal()
    slope = rng.normal(0.0, 0.3, 2)  # of the logarithm over the view: a lamp stands to one side
    rows, columns = np.indices((height, width), sparse=True)
    level += slope[0] * (columns / width - 0.5) + slope[1] * (rows / height - 0.5)
    light: FloatArray = np.exp(level)
    if defocus_px:
        blurred = cv2.GaussianBlur(light, (0, 0), defocus_px, borderType=cv2.BORDER_REFLECT)
        light = np.asarray(blurred, np.float64)
    luminance: NDArray[np.float32] = np.clip(light, _LOW, _HIGH).astype(np.float32)
    return luminance


def _spots(width: int, height: int, rng: np.random.Generator) -> FloatArray:
    """Sum smooth random images of several grains, to a deviation of 1."""
    total: FloatArray = np.zeros((height, width))
    for cell_px in SPOTS_PX:
        coarse = rng.standard_normal((height // cell_px + 3, width // cell_px + 3))
        fine = cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)
        total = total + np.asarray(fine, np.float64)
    return np.asarray(total / total.std(), np.float64)
