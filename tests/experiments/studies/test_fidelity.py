"""Events against those of another rendering."""

import numpy as np
import pytest

from experiments.studies.fidelity import DENSER, MATCH_WINDOW_US, compare_events, reference_config
from sim.recording import SimConfig
from sim.sensor.kernels import EVENT_DTYPE


def random_events(n: int, seed: int) -> np.ndarray:
    """Events of one pixel and polarity are at least two match windows apart."""
    rng = np.random.default_rng(seed)
    events = np.zeros(n, EVENT_DTYPE)
    events["t"] = np.arange(n) * 50
    pixels = rng.permutation(np.arange(n) % (4 * MATCH_WINDOW_US // 50))
    events["x"], events["y"], events["p"] = pixels % 20, pixels // 20, rng.integers(0, 2)
    keys = events["x"] + 20 * events["y"]
    for key in np.unique(keys):
        (own,) = np.nonzero(keys == key)
        events["t"][own] = np.arange(len(own)) * 3 * MATCH_WINDOW_US + events["t"][own[0]]
    return np.sort(events, order="t")


def test_the_same_events_are_the_same() -> None:
    events = random_events(2000, 0)
    result = compare_events(events, events)
    assert (result.median_us, result.p95_us, result.spurious, result.missing) == (0, 0, 0, 0)


def test_a_shift_is_measured() -> None:
    events = random_events(2000, 1)
    late = events.copy()
    late["t"] += 120
    result = compare_events(late, events)
    assert (result.median_us, result.p95_us, result.spurious, result.missing) == (120, 120, 0, 0)


def test_extra_and_lost_events_are_counted() -> None:
    events = random_events(2000, 2)
    extra = events[:100].copy()
    extra["x"] += 200  # pixels of which the reference has nothing
    more = compare_events(np.sort(np.concatenate([events, extra]), order="t"), events)
    assert more.spurious == pytest.approx(100 / 2100)
    assert more.missing == 0.0
    fewer = compare_events(events[500:], events)
    assert fewer.spurious == 0.0
    assert fewer.missing == pytest.approx(500 / 2000)


def test_other_polarity_or_a_late_time_is_no_counterpart() -> None:
    events = random_events(500, 3)
    other = events.copy()
    other["p"] = 1 - other["p"]
    other["t"][0] += 0
    both = compare_events(np.concatenate([events[:1], other[1:]]), events)
    assert both.spurious == pytest.approx(499 / 500)


def test_the_reference_is_denser_in_time_and_space() -> None:
    config = SimConfig()
    dense = reference_config(config)
    assert dense.sampling.max_step_px * DENSER == config.sampling.max_step_px
    assert dense.render.lattice.samples_per_pixel >= 256
    assert dense.spline == config.spline
