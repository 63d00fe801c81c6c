"""Events of what is no part of anything that moves, to be added to those of a camera."""

import numpy as np
from numpy.typing import NDArray

from ssac.events import events_from_arrays
from ssac.track.observation import Observation
from tests.ssac.synthetic import HEIGHT, WIDTH, Scene, make_events


def merged(*parts: NDArray[np.void]) -> NDArray[np.void]:
    """Merge events in order of time."""
    events = np.concatenate(parts)
    return np.asarray(events[np.argsort(events["t"], kind="stable")])


def pixel_events(
    x: int, y: int, n: int, duration_us: int = 1_000_000, first_us: int = 0
) -> NDArray[np.void]:
    """Events of one pixel at random times."""
    rng = np.random.default_rng(x + 1000 * y)
    t = first_us + np.sort(rng.integers(0, duration_us, n))
    return events_from_arrays(t, np.full(n, x), np.full(n, y), np.ones(n, int))


def lamp(
    x: int, y: int, size_px: int, duration_us: int, hz: float = 100.0, first_us: int = 0
) -> NDArray[np.void]:
    """Events of a square lamp on the mains, an ON and an OFF event a flicker and pixel."""
    rng = np.random.default_rng(x + 1000 * y)
    n = round(2e-6 * hz * duration_us)
    steps = first_us + np.linspace(0, duration_us, n, endpoint=False).astype(int)
    parts = []
    for column in range(x, x + size_px):
        for row in range(y, y + size_px):
            t = steps + rng.integers(0, 500, n)
            parts.append(
                events_from_arrays(t, np.full(n, column), np.full(n, row), np.arange(n) % 2)
            )
    return merged(*parts)


def noise(width: int, height: int, hz: float, duration_us: int, seed: int = 0) -> NDArray[np.void]:
    """Events of all pixels at random times."""
    rng = np.random.default_rng(seed)
    n = rng.poisson(1e-6 * hz * width * height * duration_us)
    t = np.sort(rng.integers(0, duration_us, n))
    return events_from_arrays(
        t, rng.integers(0, width, n), rng.integers(0, height, n), rng.integers(0, 2, n)
    )


def noisy_flight(scene: Scene, t_d_s: float) -> list[Observation]:
    """Observe a flight with two cameras that make noise, and frames that flicker alike."""
    rng = np.random.default_rng(0)
    images = np.cumsum(rng.integers(0, 40, (300, 4, 5)), axis=0).astype(np.uint8)
    cameras = []
    for k, events in enumerate(make_events(scene, 1, t_d_s, size_m=0.4)):
        first_us, last_us = events["t"][[0, -1]]
        extra = noise(WIDTH, HEIGHT, 0.01, int(last_us - first_us), seed=k)
        extra["t"] += first_us
        times_s = 0.02 * np.arange(300) + k * t_d_s
        cameras.append(Observation(merged(events, extra), images, times_s))
    return cameras
