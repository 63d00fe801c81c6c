"""Events of clutter, noise and further objects, to be added to those of a camera."""

import numpy as np

from ssac import Observation
from ssac.events import events_from_arrays
from tests.ssac.synthetic import HEIGHT, WIDTH, events_at, make_events, make_scene


def merged(*parts):
    return mixed(*parts)[0]


def pixel_events(x, y, n, duration_us=1_000_000):
    t = np.sort(np.random.default_rng(x + 1000 * y).integers(0, duration_us, n))
    return events_from_arrays(t, np.full(n, x), np.full(n, y), np.ones(n, int))


def lamp(x, y, size_px, duration_us):
    """Events of a square lamp on the mains: one ON and one OFF event per flicker and pixel."""
    rng = np.random.default_rng(x + 1000 * y)
    n = round(2e-4 * duration_us)  # 100 flickers a second
    steps = np.linspace(0, duration_us, n, endpoint=False).astype(int)
    parts = []
    for column, row in np.ndindex(size_px, size_px):
        t = steps + rng.integers(0, 500, n)
        place = np.full(n, x + column), np.full(n, y + row)
        parts.append(events_from_arrays(t, *place, np.arange(n) % 2))
    return merged(*parts)


def noise(width, height, hz, duration_us, seed=0):
    rng = np.random.default_rng(seed)
    n = rng.poisson(1e-6 * hz * width * height * duration_us)
    t = np.sort(rng.integers(0, duration_us, n))
    return events_from_arrays(t, *(rng.integers(0, most, n) for most in (width, height, 2)))


def noisy_flight(scene, t_d_s):
    """Observe a flight in fluctuating light, by events and frames of cameras that make noise."""
    rng = np.random.default_rng(0)
    images = np.cumsum(rng.integers(0, 40, (300, 4, 5)), axis=0).astype(np.uint8)
    shares = rng.uniform(0.2, 1.0, round(scene.duration_s / 0.05) + 1)
    cameras = []
    for k, events in enumerate(make_events(scene, 1, t_d_s, size_m=0.4)):
        bins = ((1e-6 * events["t"] - k * t_d_s) / 0.05).astype(int)
        events = events[rng.random(len(events)) < shares[bins]]
        first_us, last_us = events["t"][[0, -1]]
        extra = noise(WIDTH, HEIGHT, 0.01, int(last_us - first_us), seed=k)
        extra["t"] += first_us
        times_s = 0.02 * np.arange(300) + k * t_d_s
        cameras.append(Observation(merged(events, extra), images, times_s))
    return cameras


T_D_S, DURATION_S, SIZE_M = 0.05, 8.0, 0.4


def flight(seed, share=1.0, angle_deg=90.0):
    """Events of both cameras of one flight, at a share of the ordinary rate."""
    scene = make_scene(seed, angle_deg, DURATION_S)
    return make_events(scene, seed, T_D_S, 25_000.0 * share, SIZE_M)


def mixed(*streams):
    """Merge one camera's events of several things; also return the index of each event's thing."""
    events = np.concatenate(streams)
    thing = np.repeat(np.arange(len(streams)), [len(stream) for stream in streams])
    order = np.argsort(events["t"], kind="stable")
    return events[order], thing[order]


def branches(seed):
    """Events of four things that sway a few pixels about their places."""
    rng = np.random.default_rng((seed, 2))
    n = int(20_000 * DURATION_S)
    times_s, branch = np.sort(rng.uniform(0.0, DURATION_S, n)), rng.integers(4, size=n)
    places = rng.uniform([40, 40], [WIDTH - 40, HEIGHT - 40], (4, 2))
    sways = rng.uniform(2.0, 6.0, (4, 2))
    phases = 2.0 * np.pi * (0.8 * times_s + branch / 4)
    points = places[branch] + sways[branch] * np.sin(phases)[:, None] + rng.normal(0, 5, (n, 2))
    return events_at(times_s, points)
