"""The types of arrays that functions take and give; docstrings say the shapes."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]
Indices = NDArray[np.intp]
Mask = NDArray[np.bool_]
Pixels = NDArray[np.uint16]
Events = NDArray[np.void]
"""Structured, of `ssac.events.EVENT_DTYPE`."""
