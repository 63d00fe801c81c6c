"""Values as image files and meshes hold them in, linear light out."""

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


def linear_from_srgb(srgb: FloatArray) -> FloatArray:
    """Undo the transfer function of IEC 61966-2-1; both values and light are 0 to 1."""
    linear: FloatArray = np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
    return linear
