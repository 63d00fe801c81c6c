"""A pixel's light during an interval in, the course of its signal out: where it passes thresholds.

The luminance of a pixel is linear between two instants, I(t) = i0 + slope (t - t0). Its
photoreceptor follows as a low-pass of first order, whose exact answer is

    P(t) = I(t) - slope / k + c exp(-k (t - t0)),    c = P(t0) - i0 + slope / k,

with k = 2 pi f, f the cut-off at the interval's mean light. Lamps that flicker multiply it by
1 + a cos(omega t + phase), with the low-pass's own loss of amplitude and lag of phase.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

from sim.sensor.kernels import decay

_TOLERANCE_S = 1e-8  # of crossing times, which are rounded to microseconds
_SETTLED = 1e-7  # of the light: a photoreceptor that is as near has arrived


class Course(NamedTuple):
    """The signal of a pixel during an interval."""

    t0: float
    i0: float
    slope: float
    k: float  # [1/s], 0: no low-pass
    c: float
    depth: float
    rad_s: float
    rad: float


@njit(cache=True, nogil=True, error_model="numpy")
def course_of(t0, t1, i0, i1, signal, rates):  # type: ignore[no-untyped-def]
    """Say how a pixel's signal goes while its luminance goes linearly from i0 to i1."""
    slope = (i1 - i0) / (t1 - t0)
    k, c = 0.0, 0.0
    if rates.cutoff_hz_per_lux > 0.0:
        lux = rates.lux * (0.5 * (i0 + i1) + rates.eps)
        hz = min(max(rates.cutoff_hz_per_lux * lux, rates.cutoff_min_hz), rates.cutoff_max_hz)
        k = 2.0 * np.pi * hz
        c = signal - i0 + slope / k
    depth, rad = rates.flicker_depth, rates.flicker_rad
    if depth > 0.0 and k > 0.0:
        ratio = rates.flicker_rad_s / k
        depth /= np.sqrt(1.0 + ratio * ratio)
        rad -= np.arctan(ratio)
    return Course(t0, i0, slope, k, c, depth, rates.flicker_rad_s, rad)


@njit(cache=True, nogil=True, error_model="numpy")
def receptor(t, course):  # type: ignore[no-untyped-def]
    """Give P, the photoreceptor's signal without flicker."""
    since_s = t - course.t0
    light = course.i0 + course.slope * since_s
    if course.k == 0.0:
        return light
    return light - course.slope / course.k + course.c * np.exp(-course.k * since_s)


@njit(cache=True, nogil=True, error_model="numpy")
def signal_at(t, course):  # type: ignore[no-untyped-def]
    """Give P with the lamps' flicker."""
    signal = receptor(t, course)
    if course.depth > 0.0:
        signal *= 1.0 + course.depth * np.cos(course.rad_s * t + course.rad)
    return signal


@njit(cache=True, nogil=True, error_model="numpy")
def turn_of(course):  # type: ignore[no-untyped-def]
    """Find when P has its extremum; infinity where it has none."""
    if course.k == 0.0 or course.slope == 0.0 or course.c == 0.0:
        return np.inf
    share = course.slope / (course.k * course.c)
    return course.t0 - np.log(share) / course.k if 0.0 < share < 1.0 else np.inf


@njit(cache=True, nogil=True, error_model="numpy")
def settled_from(course, light):  # type: ignore[no-untyped-def]
    """Find from when on P has lost what it started from, but for a trifle."""
    left = abs(course.c) / (_SETTLED * light)
    return course.t0 + (np.log(left) / course.k if left > 1.0 else 0.0)


@njit(cache=True, nogil=True, error_model="numpy")
def able_from(t, level, up, down, leak, luminance, eps, course):  # type: ignore[no-untyped-def]
    """Find from when on a settled pixel may pass a threshold by flicker, as its level sinks."""
    crest = (luminance * (1.0 + course.depth) + eps) / (level * up)
    trough = (luminance * (1.0 - course.depth) + eps) / (level * down)
    if crest >= 1.0 or trough < 1.0:
        return t
    return t - np.log(crest) / leak if leak > 0.0 else np.inf


@njit(cache=True, nogil=True, error_model="numpy")
def crossing_of(t, stop, level, up, down, leak, eps, course):  # type: ignore[no-untyped-def]
    """Find when the signal next passes a threshold: (time [s], is ON), infinity if not by `stop`.

    The signal is monotone from t to stop; the level sinks. The root is bracketed and found by
    false position, the end that stays being weighed down (Illinois).
    """
    sunk = level * decay(leak * (stop - t))
    at_0, at_1 = signal_at(t, course) + eps, signal_at(stop, course) + eps
    for polarity in (True, False):
        sign, step = (1.0, up) if polarity else (-1.0, down)
        f_b = sign * (at_1 - sunk * step)
        if f_b <= 0.0:
            continue
        f_a = sign * (at_0 - level * step)
        # At most a rounding beyond at the start: an event memorises the threshold itself.
        if f_a >= 0.0:
            return t, polarity
        a, b, s, last = t, stop, stop, np.inf
        side = 0
        while abs(s - last) > _TOLERANCE_S:
            last, s = s, a + (b - a) * f_a / (f_a - f_b)
            now = level * decay(leak * (s - t))
            f_s = sign * (signal_at(s, course) + eps - now * step)
            if f_s > 0.0:
                b, f_b = s, f_s
                f_a *= 0.5 if side == 1 else 1.0
                side = 1
            else:
                a, f_a = s, f_s
                f_b *= 0.5 if side == -1 else 1.0
                side = -1
        return s, polarity
    return np.inf, False
