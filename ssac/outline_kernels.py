"""Events' values and even times in: values of ranks in windows, interpolation and smoothing out."""

import numba
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@numba.njit(cache=True)
def interpolated_at(
    event_times_us: NDArray[np.int64], times_s: Array, values: Array
) -> NDArray[np.float64]:
    """Interpolate values, known at even times, at the times of events; constant beyond the ends."""
    out = np.empty(len(event_times_us))
    last = len(times_s) - 1
    per_us = 1e-6 * last / (times_s[last] - times_s[0])
    start_us = 1e6 * times_s[0]
    for k in range(len(event_times_us)):
        place = min(max((event_times_us[k] - start_us) * per_us, 0.0), float(last))
        i = min(int(place), last - 1)
        out[k] = values[i] + (place - i) * (values[i + 1] - values[i])
    return out


@numba.njit(cache=True)
def ranked_in_windows(
    event_times_us: NDArray[np.int64],
    values: Array,
    middles_us: NDArray[np.int64],
    half_us: int,
    usable: NDArray[np.bool_],
    rank: int,
    deeper_rank: int,
) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
    """Values (n, 2) of two ranks from the top in each window, and the index of the first's event.

    NaN and 0 where a window is not usable or has fewer events.
    """
    n = len(middles_us)
    ranked, indices = np.full((n, 2), np.nan), np.zeros(n, np.intp)
    top, at = np.empty(deeper_rank + 1), np.empty(deeper_rank + 1, np.intp)  # descending
    first = last = 0
    for i in range(n):
        while first < len(values) and event_times_us[first] < middles_us[i] - half_us:
            first += 1
        last = max(last, first)
        while last < len(values) and event_times_us[last] < middles_us[i] + half_us:
            last += 1
        if not usable[i] or last - first <= deeper_rank:
            continue
        top[:] = -np.inf
        for k in range(first, last):
            if values[k] > top[deeper_rank]:
                j = deeper_rank
                while j > 0 and top[j - 1] < values[k]:
                    top[j], at[j] = top[j - 1], at[j - 1]
                    j -= 1
                top[j], at[j] = values[k], k
        ranked[i, 0], ranked[i, 1], indices[i] = top[rank], top[deeper_rank], at[rank]
    return ranked, indices


@numba.njit(cache=True)
def local_parabolas(values: Array, reach: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Value and slope per step (n,) of parabolas fitted about each of n even samples.

    By tricube weights over `reach` samples on each side; NaN, where the sample is itself or fewer
    than half of those around it are known.
    """
    n = len(values)
    smooth, slopes = np.full(n, np.nan), np.full(n, np.nan)
    for i in range(n):
        if np.isnan(values[i]):
            continue
        known = 0
        moments, sums = np.zeros(5), np.zeros(3)
        for j in range(max(i - reach, 0), min(i + reach + 1, n)):
            if np.isnan(values[j]):
                continue
            known += 1
            lag = (j - i) / (reach + 1.0)
            term = (1.0 - abs(lag) ** 3) ** 3
            for power in range(5):
                moments[power] += term
                if power < 3:
                    sums[power] += term * (values[j] - values[i])
                term *= lag
        if known < reach + 1:
            continue
        m0, m1, m2, m3, m4 = moments
        # Cofactors of the symmetric matrix of moments.
        c00, c01, c02 = m2 * m4 - m3 * m3, m2 * m3 - m1 * m4, m1 * m3 - m2 * m2
        c11, c12 = m0 * m4 - m2 * m2, m1 * m2 - m0 * m3
        determinant = m0 * c00 + m1 * c01 + m2 * c02
        smooth[i] = values[i] + (c00 * sums[0] + c01 * sums[1] + c02 * sums[2]) / determinant
        slope = (c01 * sums[0] + c11 * sums[1] + c12 * sums[2]) / determinant
        slopes[i] = slope / (reach + 1.0)
    return smooth, slopes
