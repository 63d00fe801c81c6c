"""The compiled loops over the pixels of a sensor with effects.

A pixel whose light is constant is skipped, and followed when its light next changes: its signal is
exact for steps of any length, and noise has no memory. The luminance of a pixel is linear between
two instants, I(t) = i0 + slope (t - t0). Its photoreceptor is a first-order low-pass, whose exact
response is

    P(t) = I(t) - slope / k + c exp(-k (t - t0)),    c = P(t0) - i0 + slope / k,

with k = 2 pi f, f the cut-off at the interval's mean light. Lamps that flicker multiply P by
1 + a cos(omega t + phase), where a and phase include the low-pass's attenuation and phase lag.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

from sim.sensor.kernels import SHOT_NOISE_DROP, decay, grown, uniform

_TOLERANCE_S = 1e-8  # of crossing times, which are rounded to microseconds
_SETTLED = 1e-7  # share of the light that a settled photoreceptor may be off


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
def course_of(t0, t1, i0, i1, signal, rates):
    """Return a pixel's signal over [t0, t1], while its luminance goes linearly from i0 to i1."""
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
def receptor(t, course):
    """Return P, the photoreceptor's signal without flicker."""
    since_s = t - course.t0
    light = course.i0 + course.slope * since_s
    if course.k == 0.0:
        return light
    return light - course.slope / course.k + course.c * np.exp(-course.k * since_s)


@njit(cache=True, nogil=True, error_model="numpy")
def signal_at(t, course):
    """Return P with the lamps' flicker."""
    signal = receptor(t, course)
    if course.depth > 0.0:
        signal *= 1.0 + course.depth * np.cos(course.rad_s * t + course.rad)
    return signal


@njit(cache=True, nogil=True, error_model="numpy")
def turn_of(course):
    """Find when P has its extremum; infinity where it has none."""
    if course.k == 0.0 or course.slope == 0.0 or course.c == 0.0:
        return np.inf
    share = course.slope / (course.k * course.c)
    return course.t0 - np.log(share) / course.k if 0.0 < share < 1.0 else np.inf


@njit(cache=True, nogil=True, error_model="numpy")
def settled_from(course, light):
    """Return the time from which the transient c exp(-k (t - t0)) of P is negligible."""
    left = abs(course.c) / (_SETTLED * light)
    return course.t0 + (np.log(left) / course.k if left > 1.0 else 0.0)


@njit(cache=True, nogil=True, error_model="numpy")
def able_from(t, level, up, down, leak, luminance, eps, course):
    """Return the time from which flicker may take a settled pixel to a threshold, as it leaks."""
    crest = (luminance * (1.0 + course.depth) + eps) / (level * up)
    trough = (luminance * (1.0 - course.depth) + eps) / (level * down)
    if crest >= 1.0 or trough < 1.0:
        return t
    return t - np.log(crest) / leak if leak > 0.0 else np.inf


@njit(cache=True, nogil=True, error_model="numpy")
def crossing_of(t, stop, level, up, down, leak, eps, course):
    """Find when the signal next passes a threshold: (time [s], is ON), infinity if not by `stop`.

    The signal is monotone from t to stop; the level sinks. The root is bracketed and found by
    false position, with the value at an end that stays halved (Illinois).
    """
    sunk = level * decay(leak * (stop - t))
    at_0, at_1 = signal_at(t, course) + eps, signal_at(stop, course) + eps
    for polarity in (True, False):
        sign, step = (1.0, up) if polarity else (-1.0, down)
        f_b = sign * (at_1 - sunk * step)
        if f_b <= 0.0:
            continue
        f_a = sign * (at_0 - level * step)
        # The signal at t is beyond by rounding at most: an event memorises the threshold itself.
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


PIXEL_DTYPE = np.dtype(
    [
        ("up", "f8"),  # exp(C+)
        ("down", "f8"),  # exp(-C-)
        ("level", "f8"),  # memorised luminance, with eps
        ("time_s", "f8"),  # up to when this pixel has been followed
        ("signal", "f8"),  # P at that time, without flicker
        ("dead_until_s", "f8"),  # end of its refractory period
        ("budget", "f8"),  # integral of its noise rate that is left until its next noise event
        ("hot_hz", "f8"),  # rate of a hot pixel, 0 otherwise
        ("noisiness", "f8"),  # ratio of its noise rates to the nominal ones
        ("leak_per_s", "f8"),  # how fast its memorised log intensity sinks, until its next event
        ("mean_leak_per_s", "f8"),  # the same in the mean
        ("random", "u8"),  # state of its own random numbers
    ]
)


class PixelRates(NamedTuple):
    """The parameters that all pixels of a camera share."""

    eps: float
    lux: float  # of luminance 1
    refractory_s: float
    shot_hz: float
    background_hz: float
    dim_on_share: float  # share of ON events in the dim-light shot noise
    leak_jitter: float
    cutoff_hz_per_lux: float
    cutoff_min_hz: float
    cutoff_max_hz: float
    flicker_depth: float
    flicker_rad_s: float
    flicker_rad: float  # phase at time 0
    latency_s: float
    latency_lux_s: float
    jitter_s: float
    jitter_lux_s: float


@njit(cache=True, nogil=True, error_model="numpy")
def follow_changes(
    times_s, x0_px, y0_px, luminance, background, time_s, box, image, pixels, rates, dim_hz,
    events, n,
):  # fmt: skip
    """Follow the pixels whose light changes; see `sim.sensor.events.Sensor.feed`."""
    height, width = luminance.shape[1:]
    for k in range(times_s.size):
        t0, t1, x0, y0 = time_s, times_s[k], x0_px[k], y0_px[k]
        x1, y1 = x0 + width, y0 + height
        for y in range(min(y0, box[1]), max(y1, box[3])):
            for x in range(min(x0, box[0]), max(x1, box[2])):
                in_crop = y0 <= y < y1 and x0 <= x < x1
                value = luminance[k, y - y0, x - x0] if in_crop else background[y, x]
                old, state = image[y, x], pixels[y, x]
                if value == old:
                    continue
                image[y, x] = value
                i0, i1 = np.float64(old), np.float64(value)
                is_quiet = state.time_s >= t0 or _stays_quiet(state, t0, i0, i0, rates, dim_hz)
                if is_quiet and _stays_quiet(state, t1, i0, i1, rates, dim_hz):
                    continue
                if state.time_s < t0:
                    events, n = _follow(y, x, t0, i0, i0, pixels, rates, dim_hz, events, n)
                events, n = _follow(y, x, t1, i0, i1, pixels, rates, dim_hz, events, n)
        box[0], box[1], box[2], box[3] = x0, y0, x1, y1
        time_s = t1
    return events, n


@njit(cache=True, nogil=True, error_model="numpy")
def follow_all(time_s, image, pixels, rates, dim_hz, events, n):
    """Follow all pixels, whose light is constant, up to a time."""
    for y in range(image.shape[0]):
        for x in range(image.shape[1]):
            i, state = np.float64(image[y, x]), pixels[y, x]
            if state.time_s < time_s and not _stays_quiet(state, time_s, i, i, rates, dim_hz):
                events, n = _follow(y, x, time_s, i, i, pixels, rates, dim_hz, events, n)
    return events, n


@njit(cache=True, nogil=True, error_model="numpy")
def _stays_quiet(state, t1, i0, i1, rates, dim_hz):
    """Follow a pixel to t1, returning True, if its signal is monotone and surely without event."""
    t = state.time_s
    if state.dead_until_s > t:
        return False
    middle = 0.5 * (i0 + i1)
    expected = _noise_hz(middle, state, rates, dim_hz) * (t1 - t)
    if state.budget <= expected:
        return False
    course = course_of(t, t1, i0, i1, state.signal, rates)
    signal = i1
    if course.k > 0.0:
        left = course.c * np.exp(-course.k * (t1 - t))
        signal += left - course.slope / course.k
        # P turns where its slope changes sign.
        if (course.slope - course.k * course.c) * (course.slope - course.k * left) < 0.0:
            return False
    high = max(state.signal, signal) * (1.0 + course.depth) + rates.eps
    low = min(state.signal, signal) * (1.0 - course.depth) + rates.eps
    last = state.level * decay(state.leak_per_s * (t1 - t))
    if low < state.level * state.down or high > last * state.up:
        return False
    state.level, state.signal, state.time_s = last, signal, t1
    state.budget -= expected
    return True


@njit(cache=True, nogil=True, error_model="numpy")
def _follow(y, x, t1, i0, i1, pixels, rates, dim_hz, events, n):
    """Follow one pixel up to t1 while its luminance goes linearly from i0 to i1."""
    state = pixels[y, x]
    t = state.time_s
    middle = 0.5 * (i0 + i1)
    course = course_of(t, t1, i0, i1, state.signal, rates)
    step_up, step_down = state.up, state.down
    noise_hz = _noise_hz(middle, state, rates, dim_hz)
    leak = state.leak_per_s
    level = state.level
    turn_s = turn_of(course)
    settled_s = settled_from(course, i1 + rates.eps) if i0 == i1 else np.inf
    while t < t1:
        if state.dead_until_s > t:
            if state.dead_until_s >= t1:
                break  # noise has no memory: events due meanwhile are lost
            t = state.dead_until_s
            level = signal_at(t, course) + rates.eps
        stop = t1
        if t < turn_s < stop:
            stop = turn_s
        if t < settled_s < stop:
            stop = settled_s
        noise_s = t + max(state.budget, 0.0) / noise_hz if noise_hz > 0.0 else np.inf
        stop = min(stop, noise_s)
        if course.depth > 0.0:
            able_s = able_from(t, level, step_up, step_down, leak, i1, rates.eps, course)
            if t >= settled_s and able_s > t:  # flicker alone passes no threshold until then
                stop = min(stop, able_s)
            else:
                half = np.floor((course.rad_s * t + course.rad) / np.pi + 1e-9) + 1.0
                turn_back_s = (half * np.pi - course.rad) / course.rad_s
                if turn_back_s <= t:  # as rounded, of a fast flicker late
                    turn_back_s = ((half + 1.0) * np.pi - course.rad) / course.rad_s
                stop = min(stop, turn_back_s)
        crossing_s, polarity = crossing_of(
            t, stop, level, step_up, step_down, leak, rates.eps, course
        )
        if crossing_s <= stop:
            state.budget -= noise_hz * (crossing_s - t)
            t = crossing_s
        else:
            state.budget -= noise_hz * (stop - t)
            level *= decay(leak * (stop - t))
            t = stop
            if t < noise_s:
                continue
            state.budget = -np.log(1.0 - uniform(state))
            polarity = _noise_polarity(middle, noise_hz, state, rates, dim_hz)
        signal = signal_at(t, course)
        if n == events.size:
            events = grown(events)
        event, delay_s = events[n], _delay(signal + rates.eps, state, rates)
        event.t_s, event.x, event.y, event.p = t + delay_s, x, y, polarity
        n += 1
        level = signal + rates.eps
        if rates.refractory_s > 0.0:
            state.dead_until_s = t + rates.refractory_s
        if rates.leak_jitter > 0.0:
            late = max(1.0 + rates.leak_jitter * _normal(state), 0.1)
            leak = state.mean_leak_per_s / late
            state.leak_per_s = leak
    state.level, state.signal, state.time_s = level, receptor(t1, course), t1
    return events, n


@njit(cache=True, nogil=True, error_model="numpy")
def _noise_hz(luminance, state, rates, dim_hz):
    """Return the rate of a pixel's noise events of all causes."""
    shot_hz = rates.shot_hz * (1.0 - SHOT_NOISE_DROP * min(max(luminance, 0.0), 1.0))
    nominal_hz = shot_hz + _dim_hz(luminance, dim_hz)
    return state.noisiness * nominal_hz + state.hot_hz + rates.background_hz


@njit(cache=True, nogil=True, error_model="numpy")
def _dim_hz(luminance, dim_hz):
    """Interpolate the rate of dim-light shot noise in its table over luminance, 0 to 1."""
    at = min(max(luminance, 0.0), 1.0) * (dim_hz.size - 1)
    k = min(np.int64(at), dim_hz.size - 2)
    return dim_hz[k] + (at - k) * (dim_hz[k + 1] - dim_hz[k])


@njit(cache=True, nogil=True, error_model="numpy")
def _noise_polarity(luminance, noise_hz, state, rates, dim_hz):
    """Draw the polarity of a noise event: that of a hot pixel is ON, shot noise is either."""
    draw = uniform(state) * noise_hz - state.hot_hz
    if draw < 0.0:
        return True
    is_dim = draw < state.noisiness * _dim_hz(luminance, dim_hz)
    return uniform(state) < (rates.dim_on_share if is_dim else 0.5)


@njit(cache=True, nogil=True, error_model="numpy")
def _delay(light, state, rates):
    """Draw the time from a crossing to the stamp of its event [s]."""
    lux = rates.lux * light
    delay_s = rates.latency_s + rates.latency_lux_s / lux
    deviation_s = rates.jitter_s + rates.jitter_lux_s / lux
    return delay_s + deviation_s * _normal(state) if deviation_s > 0.0 else delay_s


@njit(cache=True, nogil=True, error_model="numpy")
def _normal(state):
    """Draw from the standard normal distribution (Box and Muller)."""
    radius = np.sqrt(-2.0 * np.log(1.0 - uniform(state)))
    return radius * np.cos(2.0 * np.pi * uniform(state))
