"""The compiled loops over the pixels of the sensor model, and the buffer of their events."""

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from sim.arrays import IntArray

EVENT_DTYPE = np.dtype([("t", "<i8"), ("x", "<u2"), ("y", "<u2"), ("p", "u1")])
"""One event: `t` [us], pixel column `x`, pixel row `y`, polarity `p` (1 = brighter)."""

_EMITTED = np.dtype([("t_s", "f8"), ("x", "u2"), ("y", "u2"), ("p", "u1")], align=True)


class EventBuffer:
    """A growing buffer of events in the order of their emission."""

    def __init__(self) -> None:
        self.events, self.n = np.empty(1 << 16, _EMITTED), 0

    def follow(self, kernel: Any, *arguments: Any) -> None:
        """Let a kernel append its events."""
        self.events, self.n = kernel(*arguments, self.events, self.n)

    def take(self, before_us: float, width: int, height: int) -> NDArray[Any]:
        """Remove and return the events before a time [us], infinity for all; sizes are in [px].

        They are sorted by time, then row, column and order of emission.
        """
        emitted = self.events[: self.n]
        t_us = np.rint(emitted["t_s"] * 1e6)
        is_taken = t_us < before_us
        taken = np.empty(np.count_nonzero(is_taken), EVENT_DTYPE)
        taken["t"] = t_us[is_taken]
        for name in ("x", "y", "p"):
            taken[name] = emitted[name][is_taken]
        self.n -= len(taken)
        self.events[: self.n] = emitted[~is_taken]
        key = (taken["t"] * height + taken["y"]) * width + taken["x"]
        return np.take(taken, _stable_order(key))


@njit(cache=True, nogil=True)
def grown(events: NDArray[Any]) -> NDArray[Any]:
    """Return a copy of the events with twice the room."""
    more = np.empty(2 * events.size, events.dtype)
    more[: events.size] = events
    return more


def _stable_order(key: IntArray) -> IntArray:
    """Sort like a stable `np.argsort`, but twice as fast where key and index fit one integer."""
    bits = len(key).bit_length()
    if not len(key) or int(np.ptp(key)) >> (63 - bits):
        return np.argsort(key, kind="stable")
    return np.sort((key - key.min()) << bits | np.arange(len(key))) & ((1 << bits) - 1)


NOISE_STATE_DTYPE = np.dtype(
    [
        ("time_s", "f8"),  # up to when this pixel has been followed
        ("dead_until_s", "f8"),  # end of its refractory period
        ("next_s", "f8"),  # when its next noise event is due
        ("hot_hz", "f8"),  # rate of a hot pixel, 0 otherwise
        ("leak_per_s", "f8"),  # how fast its memorised log intensity sinks
        ("random", "u8"),  # state of its own random numbers
    ]
)
SHOT_NOISE_DROP = 0.75  # share of the dark rate that is missing at full light (as in v2e)


@njit(cache=True, nogil=True)
def process_ideal(
    times_s, x0_px, y0_px, luminance, background, time_s, box,
    image, reference, up, down, high, low, eps, events, n,
):  # fmt: skip
    """Follow pixels that respond to light alone; see `sim.sensor.events.Sensor.feed`."""
    height, width = luminance.shape[1:]
    for k in range(times_s.size):
        t0, t1 = time_s, times_s[k]
        cx0, cy0 = x0_px[k], y0_px[k]
        cx1, cy1 = cx0 + width, cy0 + height
        for y in range(min(cy0, box[1]), max(cy1, box[3])):
            in_rows = cy0 <= y < cy1
            for x in range(min(cx0, box[0]), max(cx1, box[2])):
                in_crop = in_rows and cx0 <= x < cx1
                value = luminance[k, y - cy0, x - cx0] if in_crop else background[y, x]
                if value > high[y, x] or value < low[y, x]:
                    i0, i1 = np.float64(image[y, x]), np.float64(value)
                    per_s = (t1 - t0) / (i1 - i0)
                    memory, step_up, step_down = reference[y, x], up[y, x], down[y, x]
                    above, below = high[y, x], low[y, x]
                    while i1 > above or i1 < below:
                        if n == events.size:
                            events = grown(events)
                        polarity = i1 > above
                        memory *= step_up if polarity else step_down
                        # The intensity at which the threshold is crossed.
                        crossing = memory - eps
                        event = events[n]
                        event.t_s = min(max(t0 + (crossing - i0) * per_s, t0), t1)
                        event.x, event.y, event.p = x, y, polarity
                        n += 1
                        above = np.float32(memory * step_up - eps)
                        below = np.float32(memory * step_down - eps)
                    reference[y, x], high[y, x], low[y, x] = memory, above, below
                image[y, x] = value
        box[0], box[1], box[2], box[3] = cx0, cy0, cx1, cy1
        time_s = t1
    return events, n


@njit(cache=True, nogil=True)
def process_noisy(
    times_s, x0_px, y0_px, luminance, background, time_s, box,
    image, reference, up, down, noise, eps, refractory_s, shot_hz, background_hz,
    events, n,
):  # fmt: skip
    """Follow pixels that also leak, emit noise events and have a refractory period."""
    height, width = luminance.shape[1:]
    for k in range(times_s.size):
        cx0, cy0 = x0_px[k], y0_px[k]
        cx1, cy1 = cx0 + width, cy0 + height
        for y in range(min(cy0, box[1]), max(cy1, box[3])):
            for x in range(min(cx0, box[0]), max(cx1, box[2])):
                in_crop = cy0 <= y < cy1 and cx0 <= x < cx1
                light = luminance[k, y - cy0, x - cx0] if in_crop else background[y, x]
                value = np.float64(light)
                # First the constant light since the pixel was last followed, then the interval.
                for part in range(2):
                    end = time_s if part == 0 else times_s[k]
                    t0 = noise[y, x].time_s
                    if end <= t0:
                        continue
                    i0 = np.float64(image[y, x])
                    i1 = i0 if part == 0 else value
                    noise[y, x].time_s = end
                    # Most pixels emit no event; only the others need `_follow`.
                    level = reference[y, x] * decay(noise[y, x].leak_per_s * (end - t0))
                    if (
                        level * down[y, x] <= i1 + eps <= level * up[y, x]
                        and noise[y, x].next_s > end
                        and noise[y, x].dead_until_s <= t0
                    ):
                        reference[y, x] = level
                        continue
                    events, n = _follow(
                        y, x, t0, end, i0, i1, reference, up, down, noise, eps, refractory_s,
                        shot_hz, background_hz, events, n,
                    )  # fmt: skip
                image[y, x] = value
        box[0], box[1], box[2], box[3] = cx0, cy0, cx1, cy1
        time_s = times_s[k]
    return events, n


@njit(cache=True, nogil=True)
def _follow(
    y, x, t0, t1, i0, i1, reference, up, down, noise, eps, refractory_s, shot_hz, background_hz,
    events, n,
):  # fmt: skip
    """Follow one pixel from t0 to t1 while its light goes linearly from i0 to i1."""
    state = noise[y, x]
    slope = (i1 - i0) / (t1 - t0)
    leak = state.leak_per_s
    level = reference[y, x]
    t = t0
    while True:
        if state.dead_until_s > t:
            if state.dead_until_s > t1:
                break
            t = state.dead_until_s
            level = i0 + slope * (t - t0) + eps
        crossing_s, polarity = _next_crossing(
            t, t1, i0 + slope * (t - t0), i1, level, up[y, x], down[y, x], leak, eps
        )
        while state.next_s < t:  # noise due during the dead time is lost
            state.next_s += _waiting_time(state, shot_hz, background_hz)
        event_s = min(crossing_s, state.next_s)
        if event_s > t1:
            level *= decay(leak * (t1 - t))
            break
        light = i0 + slope * (event_s - t0)
        if state.next_s <= crossing_s:
            state.next_s += _waiting_time(state, shot_hz, background_hz)
            total_hz = shot_hz + background_hz + state.hot_hz
            draw = uniform(state) * total_hz
            if draw < state.hot_hz:
                polarity = True
            elif draw < total_hz - shot_hz * SHOT_NOISE_DROP * min(max(light, 0.0), 1.0):
                polarity = uniform(state) < 0.5
            else:  # bright light has less shot noise: this one does not happen
                level *= decay(leak * (event_s - t))
                t = event_s
                continue
        if n == events.size:
            events = grown(events)
        event = events[n]
        event.t_s, event.x, event.y, event.p = event_s, x, y, polarity
        n += 1
        level = light + eps
        t = event_s
        if refractory_s > 0.0:
            state.dead_until_s = event_s + refractory_s
    reference[y, x] = level
    return events, n


@njit(cache=True, nogil=True)
def _next_crossing(t, t1, light, light_1, level, up, down, leak, eps):
    """Find when the light next passes a threshold: (time [s], is ON), infinity if not before t1."""
    shrink = decay(leak * (t1 - t))
    for polarity in (True, False):
        step = up if polarity else down
        at_0, at_1 = level * step - eps, level * shrink * step - eps
        passed = light_1 > at_1 if polarity else light_1 < at_1
        if not passed:
            continue
        if light == light_1:
            # Only the memorised level moves: it decays, so only the ON threshold can come closer.
            # Without a leak, light passes the threshold by rounding alone.
            distance = np.log(level * step / (light + eps))
            return t + (max(0.0, distance / leak) if leak > 0.0 else 0.0), polarity
        share = (at_0 - light) / ((light_1 - light) - (at_1 - at_0))
        return t + min(max(share, 0.0), 1.0) * (t1 - t), polarity
    return np.inf, False


@njit(cache=True, nogil=True)
def decay(x):
    """Return exp(-x); between two instants x is tiny, and the series is exact to rounding."""
    return 1.0 - x * (1.0 - 0.5 * x * (1.0 - x / 3.0)) if x < 1e-4 else np.exp(-x)


@njit(cache=True, nogil=True)
def _waiting_time(state, shot_hz, background_hz):
    return -np.log(1.0 - uniform(state)) / (shot_hz + background_hz + state.hot_hz)


@njit(cache=True, nogil=True)
def uniform(state):
    """Draw from [0, 1): SplitMix64 (Steele et al., OOPSLA 2014), one stream for each pixel."""
    state.random += np.uint64(0x9E3779B97F4A7C15)
    z = state.random
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    z = z ^ (z >> np.uint64(31))
    return np.float64(z >> np.uint64(11)) * (1.0 / (1 << 53))
