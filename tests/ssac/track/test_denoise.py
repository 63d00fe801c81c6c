import numpy as np
import pytest
from scipy.spatial import cKDTree

from ssac.config import N_MIN
from ssac.events import EVENT_DTYPE, events_from_arrays
from ssac.track.denoise import (
    LEAST_NEIGHBOURS,
    NEAR_NEIGHBOURS,
    NEAR_PX,
    PAPER_NEIGHBOURS,
    PAPER_PX,
    least_neighbours,
    radius_filter,
    without_noise,
)
from tests.ssac.cluttered import merged

WIDTH, HEIGHT = 64, 48


def _random_events(n, duration_us, seed=0, first_us=0):
    rng = np.random.default_rng(seed)
    t = np.sort(rng.integers(0, duration_us, n)) + first_us
    return events_from_arrays(
        t, rng.integers(0, WIDTH, n), rng.integers(0, HEIGHT, n), rng.integers(0, 2, n)
    )


def _tree_filter(events, radius_px, ms_per_unit, n_neighbours):
    """Filter by a k-d tree; whole numbers keep distances on the boundary exact."""
    us_per_px = 1000 * ms_per_unit
    t = events["t"] - events["t"][0]
    points = np.column_stack([t, events["x"] * us_per_px, events["y"] * us_per_px])
    n_found = cKDTree(points).query_ball_point(points, radius_px * us_per_px, return_length=True)
    return events[n_found - 1 >= n_neighbours]


@pytest.mark.parametrize(
    ("radius_px", "ms_per_unit", "n_neighbours"),
    [
        (5.0, 1.0, 20),
        (4.3, 1.0, 12),
        (3.0, 2.0, 8),
        (2.5, 0.5, 2),
        (1.4, 3.0, 2),
        (1.0, 4.0, 1),  # the core is as large as the ball
        (0.5, 4.0, 1),
        (12.0, 1.0, 100),
    ],
)
@pytest.mark.parametrize("first_us", [0, 1_700_000_000_000_000])
def test_equals_a_k_d_tree(radius_px, ms_per_unit, n_neighbours, first_us):
    events = _random_events(8000, 40_000, first_us=first_us)
    kept = radius_filter(events, radius_px, ms_per_unit, n_neighbours)
    expected = _tree_filter(events, radius_px, ms_per_unit, n_neighbours)
    assert 0 < len(expected) < len(events)
    np.testing.assert_array_equal(kept, expected)


def test_equals_a_k_d_tree_with_events_at_one_instant_and_on_the_boundary():
    # Times in whole milliseconds put many neighbours at exactly 5 units (3-4-0, 0-3-4, ...).
    events = _random_events(6000, 40)
    events["t"] *= 1000
    np.testing.assert_array_equal(radius_filter(events), _tree_filter(events, 5.0, 1.0, 20))


@pytest.mark.parametrize("gap_us", [4000, 9000, 60_000, 10_000_000_000])
def test_equals_a_k_d_tree_across_gaps_in_time(gap_us):
    # Bursts of very unlike density: what is left of one must not count in the next.
    bursts, first_us = [], 0
    for n, duration_us in ((9000, 12_000), (40, 3000), (12_000, 5000), (3000, 30_000)):
        bursts.append(_random_events(n, duration_us, n, first_us))
        first_us += duration_us + gap_us
    events = np.concatenate(bursts)
    np.testing.assert_array_equal(radius_filter(events), _tree_filter(events, 5.0, 1.0, 20))


@pytest.mark.parametrize("gap_us", [0, 4000, 10_000_000_000])
@pytest.mark.parametrize(
    ("radius_px", "n_neighbours"), [(3.0, 12), (3.0, 5), (2.5, 1), (5.0, 20), (1.0, 1)]
)
def test_either_way_leaves_the_same(radius_px, n_neighbours, gap_us):
    events = _random_events(20_000, 60_000, seed=5)  # of which balls hold from none to many
    some = events["x"] < 20
    events["x"][some], events["y"][some] = events["x"][some] // 4, events["y"][some] // 4
    events["t"][len(events) // 2 :] += gap_us
    fast = radius_filter(events, radius_px, n_neighbours=n_neighbours, mostly_noise=True)
    assert np.array_equal(fast, radius_filter(events, radius_px, n_neighbours=n_neighbours))
    assert 0 < len(fast) < len(events)


def test_neighbours_must_be_as_many_as_asked():
    events = events_from_arrays(np.arange(21), [3] * 21, [4] * 21, [1] * 21)
    assert len(radius_filter(events)) == 21
    assert len(radius_filter(events[:20])) == 0


def test_filtering_what_is_dense_changes_nothing_and_leaves_the_input_alone():
    events = _random_events(60_000, 40_000)
    copy = events.copy()
    np.testing.assert_array_equal(radius_filter(events), events)
    np.testing.assert_array_equal(events, copy)


def test_no_events():
    none = np.empty(0, EVENT_DTYPE)
    assert len(radius_filter(none)) == 0
    assert len(without_noise(none, WIDTH, HEIGHT)[0]) == 0


def test_noise_alone_leaves_at_most_an_event_in_a_window():
    for hz in (0.2, 2.0, 10.0):
        n = least_neighbours(hz, WIDTH * HEIGHT, PAPER_PX, 1000)
        noise = _random_events(round(hz * WIDTH * HEIGHT * 20), 20_000_000)
        # One in each of the 500 windows is the limit, and Poisson's deviation of 500 is 22; the
        # events of one ball are kept together, so three times that.
        assert len(radius_filter(noise, n_neighbours=n)) < 500 + 3 * 22
        assert n >= LEAST_NEIGHBOURS
        assert least_neighbours(hz, WIDTH * HEIGHT, PAPER_PX, 6) <= 6


def _small_object(n, seed=3):
    """Events of something 3 px wide that goes round in 10 s, and where it is."""
    rng = np.random.default_rng(seed)
    t = np.sort(rng.integers(0, 10_000_000, n))
    turn = 2e-6 * np.pi * t / 2.0
    x, y = 32 + 20 * np.cos(turn), 24 + 15 * np.sin(2 * turn)
    return events_from_arrays(
        t,
        np.rint(x + rng.uniform(-1.5, 1.5, n)).astype(int),
        np.rint(y + rng.uniform(-1.5, 1.5, n)).astype(int),
        rng.integers(0, 2, n),
    )


def test_a_thin_object_needs_fewer_neighbours_and_a_dense_one_those_of_the_paper():
    noise = _random_events(round(0.2 * WIDTH * HEIGHT * 10), 10_000_000)
    thin, dense = _small_object(15_000), _small_object(200_000)
    left, found = without_noise(merged(thin, noise), WIDTH, HEIGHT)
    assert (found.radius_px, found.n_neighbours) == (PAPER_PX, LEAST_NEIGHBOURS)
    assert found.is_adapted
    # 60 events in 40 ms: a quarter of them, but at least 20.
    assert found.n_min == 20
    assert abs(len(left) - len(thin)) < 0.1 * len(thin)  # the paper's 20 leave none
    assert len(radius_filter(merged(thin, noise))) < 0.1 * len(thin)
    left, found = without_noise(merged(dense, noise), WIDTH, HEIGHT)
    assert (found.n_neighbours, found.n_min, found.is_adapted) == (PAPER_NEIGHBOURS, N_MIN, False)
    np.testing.assert_array_equal(left, radius_filter(merged(dense, noise)))


def test_much_noise_takes_the_near_ball():
    noise = _random_events(round(10.0 * WIDTH * HEIGHT * 10), 10_000_000)
    dense = _small_object(200_000)
    left, found = without_noise(merged(dense, noise), WIDTH, HEIGHT)
    assert (found.radius_px, found.n_neighbours, found.n_min) == (NEAR_PX, NEAR_NEIGHBOURS, N_MIN)
    far = radius_filter(merged(dense, noise))
    assert len(dense) < len(left) < len(far)  # less of the noise beside the object is left


def test_what_is_asked_for_is_done():
    thin = _small_object(15_000)
    left, found = without_noise(thin, WIDTH, HEIGHT, n_neighbours=9)
    assert (found.radius_px, found.n_neighbours) == (PAPER_PX, 9)
    np.testing.assert_array_equal(left, radius_filter(thin, n_neighbours=9))
