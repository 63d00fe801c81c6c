"""What fires by itself is masked, and nothing that moves is."""

import numpy as np
import pytest

from ssac.events import EVENT_DTYPE, events_from_arrays
from ssac.track.clutter import activity, masked_pixels
from tests.ssac.cluttered import lamp, merged, noise, pixel_events

WIDTH, HEIGHT = 96, 80
LONG_US = 6_000_000


def mask_of(events):
    return masked_pixels(activity(events, WIDTH, HEIGHT))


def pixels(*squares):
    found = np.zeros((HEIGHT, WIDTH), bool)
    for x, y, size_px in squares:
        found[y : y + size_px, x : x + size_px] = True
    return found


def blob(path, n=60_000, size_px=6.0, seed=0):
    """Events of something whose middle is at path(t) of times [s] -> (x, y) [px]."""
    rng = np.random.default_rng(seed)
    t = np.sort(rng.integers(0, LONG_US, n))
    x, y = (
        np.clip(np.rint(at + rng.normal(0.0, 0.3 * size_px, n)), 0, most - 1).astype(int)
        for at, most in zip(path(1e-6 * t), (WIDTH, HEIGHT), strict=True)
    )
    return events_from_arrays(t, x, y, rng.integers(0, 2, n))


def flight(t_s):
    return 48 + 30 * np.sin(2.3 * t_s), 40 + 25 * np.sin(3.1 * t_s)


def hover(t_s):
    """Three seconds at one place, within 1.5 px of it, and away in between."""
    away = np.clip(np.abs((t_s % 3.0) - 1.5) - 0.75, 0.0, None)
    return 48 + 60 * away + 1.5 * np.sin(7.0 * t_s), 40 + 1.5 * np.cos(5.0 * t_s)


def to_and_fro(t_s):
    """Back at every pixel of a short way several times a second."""
    return 48 + 6 * np.sin(12.0 * t_s), 40 + 4 * np.sin(17.0 * t_s)


def still(t_s):
    """All along at one place, but for a tremble."""
    return 48 + 1.5 * np.sin(7.0 * t_s), 40 + 1.5 * np.cos(5.0 * t_s)


@pytest.mark.parametrize("path", [flight, hover, to_and_fro, still])
@pytest.mark.parametrize("hz", [0.0, 10.0])
def test_what_moves_is_not_masked(path, hz):
    assert not mask_of(merged(blob(path), noise(WIDTH, HEIGHT, hz, LONG_US))).any()


@pytest.mark.parametrize("size_px", [3, 6, 12])
@pytest.mark.parametrize("hz", [0.0, 10.0])
def test_a_lamp_is_masked_whole_and_nothing_else(size_px, hz):
    # Once alone in its corner, and once where the object passes.
    for x, y in ((3, 60), (40, 35)):
        flicker = lamp(x, y, size_px, LONG_US)
        found = mask_of(merged(blob(flight), flicker, noise(WIDTH, HEIGHT, hz, LONG_US)))
        np.testing.assert_array_equal(found, pixels((x, y, size_px)))


def test_clusters_of_hot_pixels_are_masked_whole():
    places = [(5, 5), (30, 60), (80, 20)]
    hot = [
        pixel_events(x + i, y + j, 100 * 6, LONG_US)
        for x, y in places
        for i in range(3)
        for j in range(3)
    ]
    found = mask_of(merged(blob(flight), *hot, noise(WIDTH, HEIGHT, 0.2, LONG_US)))
    np.testing.assert_array_equal(found, pixels(*((x, y, 3) for x, y in places)))


def test_a_gap_in_the_recording_changes_nothing():
    events = merged(lamp(40, 35, 6, LONG_US), blob(flight))
    late = events.copy()
    late["t"] += 3_600_000_000
    np.testing.assert_array_equal(mask_of(merged(events, late)), pixels((40, 35, 6)))


def test_short_recordings_do_not_tell_a_lamp():
    assert not mask_of(lamp(40, 35, 6, 1_500_000)).any()
    assert mask_of(lamp(40, 35, 6, 3_000_000)).any()


@pytest.mark.parametrize(
    "lone", [[(10, 10)], [(10, 10), (11, 10)], [(0, 0), (63, 47)], [(30, 5), (31, 6)]]
)
def test_lone_hot_pixels_are_masked_in_short_recordings_too(lone):
    hot = merged(*(pixel_events(x, y, 800) for x, y in lone))
    found = mask_of(merged(noise(WIDTH, HEIGHT, 1.0, 1_000_000), hot))
    np.testing.assert_array_equal(found, pixels(*((x, y, 1) for x, y in lone)))


def test_a_bar_that_stands_and_flickers_stays():
    # A thin bar that sweeps, and then stands still and flickers for most of a short recording.
    sweep = [pixel_events(x, y, 6) for x in range(5, 50) for y in range(10, 25)]
    stand = [pixel_events(50, y, 700) for y in range(10, 25)]
    assert not mask_of(merged(*sweep, *stand)).any()


@pytest.mark.parametrize("hz", [0.2, 1.0, 10.0])
def test_the_background_is_that_of_ordinary_pixels(hz):
    rng = np.random.default_rng(1)
    n = 20 * WIDTH * HEIGHT  # every pixel again and again in the first 20 ms
    start = events_from_arrays(
        np.sort(rng.integers(0, 20_000, n)),
        rng.integers(0, WIDTH, n),
        rng.integers(0, HEIGHT, n),
        rng.integers(0, 2, n),
    )
    parts = blob(flight), lamp(3, 60, 12, LONG_US), noise(WIDTH, HEIGHT, hz, LONG_US), start
    found = activity(merged(*parts), WIDTH, HEIGHT)
    # The middle of the object's and the lamp's squares with the others: 7 of 30 squares, a quarter
    # of the deviation; and a Poisson number's median is 1/3 below its mean, at 0.2 Hz 1/3 of 5.
    of_square = hz * 25.6
    assert found.background_hz == pytest.approx(hz, rel=0.3 / of_square + 0.35 / of_square**0.5)


def test_no_background_and_no_mask_of_a_clean_recording():
    assert activity(blob(flight), WIDTH, HEIGHT).background_hz == 0.0
    assert not mask_of(blob(flight)).any()
    assert not mask_of(np.empty(0, EVENT_DTYPE)).any()
