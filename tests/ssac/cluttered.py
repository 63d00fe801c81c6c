"""Events of what is no part of anything that moves, to be added to those of a camera."""

import numpy as np
from numpy.typing import NDArray

from ssac.events import events_from_arrays


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
