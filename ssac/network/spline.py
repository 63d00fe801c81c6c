"""Times in; knots that follow them, and the cubic B-splines there, out."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

ORDER = 4
"""Splines that are not zero at a time: of a cubic one."""


@dataclass(frozen=True, eq=False)
class Spline:
    """A curve in space, smooth in time: twice continuously differentiable."""

    knots_s: Array  # (m + 4,) ascending
    coefficients: Array  # (m, 3)

    def at(self, times_s: Array, derivative: int = 0) -> Array:
        """Positions (n, 3) at times (n,) [s], or their derivatives; beyond the ends a cubic."""
        first, weights = basis(self.knots_s, times_s, derivative)
        return np.asarray(
            np.einsum("na,nax->nx", weights, self.coefficients[first[:, None] + np.arange(ORDER)])
        )


def knots_for(times_s: Array, step_s: float, max_gap_s: float) -> Array:
    """Place knots where the data are.

    Parameters
    ----------
    times_s
        Times (n,) [s] of all data, in any order.
    step_s
        Longest time between two knots where there are data.
    max_gap_s
        Longer times without data hold no knots.

    Returns
    -------
    Array
        Shape (m + 4,), the ends fourfold.
    """
    ordered = np.sort(times_s)
    ends = np.flatnonzero(np.diff(ordered) > max_gap_s)
    starts = np.concatenate([[0], ends + 1])
    stops = np.concatenate([ends, [len(ordered) - 1]])
    parts = []
    for start, stop in zip(ordered[starts], ordered[stops], strict=True):
        n = max(1, int(np.ceil((stop - start) / step_s)))
        parts.append(np.linspace(start, stop, n + 1, dtype=np.float64))
    inner = np.unique(np.concatenate(parts))
    inner = inner[np.concatenate([[True], np.diff(inner) > 1e-3 * step_s])]
    if len(inner) < 2:
        inner = inner[0] + step_s * np.arange(2.0)
    return np.concatenate([np.repeat(inner[0], 3), inner, np.repeat(inner[-1], 3)])


def basis(knots_s: Array, times_s: Array, derivative: int = 0) -> tuple[Indices, Array]:
    """Evaluate the splines that are not zero at times (n,): de Boor's recursion.

    Returns
    -------
    tuple
        The first of four neighbouring coefficients (n,), and what each counts (n, 4); of the
        derivative of that order, up to 3 [1/s^derivative].
    """
    m = len(knots_s) - ORDER
    span = np.clip(np.searchsorted(knots_s, times_s, side="right") - 1, ORDER - 1, m - 1)
    weights = np.ones((len(times_s), 1))
    for degree in range(1, ORDER):
        raised = np.zeros((len(times_s), degree + 1))
        for i in range(degree):  # spline i of the lower degree begins at this knot
            begin = span - degree + 1 + i
            low, high = knots_s[begin], knots_s[begin + degree]
            if degree > ORDER - 1 - derivative:
                slope = degree * weights[:, i] / (high - low)
                raised[:, i] -= slope
                raised[:, i + 1] += slope
            else:
                share = weights[:, i] / (high - low)
                raised[:, i] += (high - times_s) * share
                raised[:, i + 1] += (times_s - low) * share
        weights = raised
    return (span - ORDER + 1).astype(np.int64), weights


def jerks(knots_s: Array) -> tuple[Indices, Array]:
    """Say what the third derivative is in each span, times the root of the span's length.

    The sum of its squares is the integral of the squared jerk.

    Returns
    -------
    tuple
        As of `basis`: (k,) and (k, 4) [s^-2.5].
    """
    inner = knots_s[ORDER - 1 : len(knots_s) - ORDER + 1]
    first, weights = basis(knots_s, 0.5 * (inner[:-1] + inner[1:]), 3)
    return first, weights * np.sqrt(np.diff(inner))[:, None]
