"""The array types of arguments and results; docstrings state the shapes."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Float32Array = NDArray[np.float32]
IntArray = NDArray[np.int64]
Int32Array = NDArray[np.int32]
Indices = NDArray[np.intp]
Mask = NDArray[np.bool_]
Pixels = NDArray[np.uint16]
Events = NDArray[np.void]
"""Structured array of `ssac.events.EVENT_DTYPE`."""
