import numpy as np
import pytest
from scipy.spatial import cKDTree

from ssac.events import EVENT_DTYPE, events_from_arrays
from ssac.track.denoise import radius_filter, remove_hot_pixels

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
    [(5.0, 1.0, 20), (3.0, 2.0, 8), (2.5, 0.5, 2), (0.5, 4.0, 1), (12.0, 1.0, 100)],
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
    assert len(remove_hot_pixels(none, WIDTH, HEIGHT)) == 0


def _merged(*parts):
    events = np.concatenate(parts)
    return events[np.argsort(events["t"], kind="stable")]


def _pixel_events(x, y, n):
    t = np.sort(np.random.default_rng(x + 100 * y).integers(0, 1_000_000, n))
    return events_from_arrays(t, np.full(n, x), np.full(n, y), np.ones(n, int))


@pytest.mark.parametrize(
    "pixels",
    [[(10, 10)], [(10, 10), (11, 10)], [(0, 0), (63, 47)], [(30, 5), (31, 6)]],
)
def test_hot_pixels_go_and_background_noise_stays(pixels):
    noise = _random_events(3000, 1_000_000)
    hot = _merged(*(_pixel_events(x, y, 800) for x, y in pixels))
    kept = remove_hot_pixels(_merged(noise, hot), WIDTH, HEIGHT)
    at_hot = np.isin(noise["y"] * WIDTH + noise["x"], [y * WIDTH + x for x, y in pixels])
    np.testing.assert_array_equal(np.sort(kept), np.sort(noise[~at_hot]))


def test_the_object_stays():
    # A thin bar that sweeps, and then stands still and flickers for most of the recording.
    sweep = [_pixel_events(x, y, 6) for x in range(5, 50) for y in range(10, 25)]
    stand = [_pixel_events(50, y, 700) for y in range(10, 25)]
    events = _merged(*sweep, *stand)
    np.testing.assert_array_equal(remove_hot_pixels(events, WIDTH, HEIGHT), events)
