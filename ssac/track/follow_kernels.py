"""Compiled loops over bins and their events, for `ssac.track.follow`."""

import numba
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

INSIDE = 9.0
"""Squared deviations up to which an event may be the object's."""

AROUND = 20.0
"""Squared deviations from which an event tells how much there is beside the object."""

N_SUMS = 5  # columns of `sums_in_bins`

_UNKNOWN = 1e6  # variance of what is not known yet, [px^2] and [px^2/s^2]
_FASTEST = 1e4  # variance of velocities between two sights [px^2/s^2]


@numba.njit(cache=True)
def smoothed_path(
    means_px: Array, variances_px2: Array, step_s: float, density: float
) -> tuple[Array, Array, Array]:
    """Smooth one coordinate: a Kalman filter forward, Rauch, Tung and Striebel's smoother back.

    Parameters
    ----------
    means_px, variances_px2
        Measured in each bin (n,); of infinite variance where nothing was.
    step_s
        Length of a bin.
    density
        Of the acceleration, which is white noise [px^2/s^3].

    Returns
    -------
    tuple
        Position [px], velocity [px/s] and the position's variance [px^2] in each bin (n,).
    """
    n = len(means_px)
    states, covariances = np.zeros((n, 2)), np.zeros((n, 3))
    predicted, before = np.zeros((n, 2)), np.zeros((n, 3))
    x, v = 0.0, 0.0
    xx, xv, vv = _UNKNOWN, 0.0, _UNKNOWN
    for k in range(n):
        if k > 0:
            x += step_s * v
            xx += 2.0 * step_s * xv + step_s**2 * vv + density * step_s**3 / 3.0
            xv += step_s * vv + density * step_s**2 / 2.0
            vv = min(vv + density * step_s, _FASTEST)
        predicted[k, 0], predicted[k, 1] = x, v
        before[k, 0], before[k, 1], before[k, 2] = xx, xv, vv
        if np.isfinite(variances_px2[k]):
            total = xx + variances_px2[k]
            gain_x, gain_v = xx / total, xv / total
            innovation = means_px[k] - x
            x += gain_x * innovation
            v += gain_v * innovation
            vv -= gain_v * xv
            xv -= gain_x * xv
            xx -= gain_x * xx
        states[k, 0], states[k, 1] = x, v
        covariances[k, 0], covariances[k, 1], covariances[k, 2] = xx, xv, vv
    positions, velocities, variances = np.empty(n), np.empty(n), np.empty(n)
    positions[n - 1], velocities[n - 1], variances[n - 1] = x, v, xx
    for k in range(n - 2, -1, -1):
        a, b, c = covariances[k]
        p, q, r = before[k + 1]
        determinant = p * r - q * q
        a, b_next = a + step_s * b, b + step_s * c
        g_xx, g_xv = (a * r - b * q) / determinant, (b * p - a * q) / determinant
        g_vx, g_vv = (b_next * r - c * q) / determinant, (c * p - b_next * q) / determinant
        d_x, d_v = positions[k + 1] - predicted[k + 1, 0], velocities[k + 1] - predicted[k + 1, 1]
        positions[k] = states[k, 0] + g_xx * d_x + g_xv * d_v
        velocities[k] = states[k, 1] + g_vx * d_x + g_vv * d_v
        d_xx, d_xv, d_vv = xx - p, xv - q, vv - r
        t_xx, t_xv = g_xx * d_xx + g_xv * d_xv, g_xx * d_xv + g_xv * d_vv
        t_vx, t_vv = g_vx * d_xx + g_vv * d_xv, g_vx * d_xv + g_vv * d_vv
        xx = covariances[k, 0] + t_xx * g_xx + t_xv * g_xv
        xv = covariances[k, 1] + t_xx * g_vx + t_xv * g_vv
        vv = covariances[k, 2] + t_vx * g_vx + t_vv * g_vv
        variances[k] = xx
    return positions, velocities, variances


@numba.njit(cache=True)
def sums_in_bins(
    ages_s: Array,
    x: NDArray[np.uint16],
    y: NDArray[np.uint16],
    bounds: NDArray[np.int64],
    known: NDArray[np.bool_],
    positions_px: Array,
    velocities_px_s: Array,
    variances_px2: Array,
    half_px: float,
    counted: float,
    rates: Array,
    background: Array,
) -> Array:
    """Sum up the events about a path, bin by bin.

    Parameters
    ----------
    ages_s
        Of the events (m,), from the middle of their bins on.
    x, y
        Of the events (m,).
    bounds
        First event of each bin, and the one after the last (n + 1,).
    known
        Bins (n,) to be summed up.
    positions_px, velocities_px_s
        Of the path (n, 2).
    variances_px2
        Of the events about the path (n, 2).
    half_px
        Half the side of the square in which what lies around is counted.
    counted
        Squared deviations up to which an event is counted.
    rates, background
        Events of the object in a bin (n,), and of all else in a bin and a pixel (n,).

    Returns
    -------
    Array
        (n, N_SUMS): events counted, events around; weights, of each event the share of the
        object in all that is there; and weighted sums of x and y.
    """
    sums = np.zeros((len(known), N_SUMS))
    for k in range(len(known)):
        if not known[k]:
            continue
        a, b = variances_px2[k]
        peak = rates[k] / (2.0 * np.pi * np.sqrt(a * b))
        for i in range(bounds[k], bounds[k + 1]):
            dx = x[i] - positions_px[k, 0] - velocities_px_s[k, 0] * ages_s[i]
            dy = y[i] - positions_px[k, 1] - velocities_px_s[k, 1] * ages_s[i]
            if abs(dx) > half_px or abs(dy) > half_px:
                continue
            squares = dx * dx / a + dy * dy / b
            sums[k, 0] += squares < counted
            sums[k, 1] += squares > AROUND
            if squares < INSIDE and peak > 0.0:
                density = peak * np.exp(-0.5 * squares)
                weight = density / (density + background[k])
                sums[k, 2] += weight
                sums[k, 3] += weight * (dx + positions_px[k, 0])
                sums[k, 4] += weight * (dy + positions_px[k, 1])
    return sums


@numba.njit(cache=True)
def in_corridor(
    ages_s: Array,
    x: NDArray[np.uint16],
    y: NDArray[np.uint16],
    bounds: NDArray[np.int64],
    seen: NDArray[np.bool_],
    positions_px: Array,
    velocities_px_s: Array,
    half_sizes_px: Array,
) -> NDArray[np.bool_]:
    """Tell which events (m,) lie in an ellipse of half axes (n, 2) about a path, where it is seen.

    Other parameters as of `sums_in_bins`.
    """
    inside = np.zeros(len(ages_s), np.bool_)
    for k in range(len(seen)):
        if not seen[k]:
            continue
        for i in range(bounds[k], bounds[k + 1]):
            dx = x[i] - positions_px[k, 0] - velocities_px_s[k, 0] * ages_s[i]
            dy = y[i] - positions_px[k, 1] - velocities_px_s[k, 1] * ages_s[i]
            inside[i] = (dx / half_sizes_px[k, 0]) ** 2 + (dy / half_sizes_px[k, 1]) ** 2 < 1.0
    return inside
