"""Residuals in; their robust deviation, and the weights of a robust fit, out."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

CAUCHY = 2.385
"""Where Cauchy's loss turns, in robust standard deviations: 95 % efficiency on Gaussian noise."""

TO_DEVIATION = 1.4826
"""From the median absolute value of Gaussian noise to its standard deviation."""

_LEAST_DEVIATION = 1e-12  # of residuals that are all zero


def robust_deviation(residuals: Array) -> float:
    """Deviation, from zero, of Gaussian noise with the same median absolute value."""
    return float(TO_DEVIATION * np.median(np.abs(residuals)))


def cauchy_weights(residuals: Array, turn: float = CAUCHY) -> tuple[Array, Array]:
    """First derivative over residual, and second derivative, of Cauchy's loss: both (n,).

    Parameters
    ----------
    residuals
        Shape (n,).
    turn
        Where the loss turns, in robust standard deviations.
    """
    deviation = robust_deviation(residuals) + _LEAST_DEVIATION
    squares = (residuals / (turn * deviation)) ** 2
    return 1.0 / (1.0 + squares), (1.0 - squares) / (1.0 + squares) ** 2
