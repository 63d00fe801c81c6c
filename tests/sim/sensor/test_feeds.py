"""Whole frames or crops, at once or bit by bit: the events are the same."""

import numpy as np
import pytest

from sim.sensor.events import PRESETS, Sensor, events_from_frames
from tests.sim.sensor.videos import ZERO, feed_crop, rng, smooth_video, spread_px


@pytest.mark.parametrize("name", PRESETS)
@pytest.mark.parametrize("seed", [0, 1])
def test_crops_give_the_events_of_whole_frames(name: str, seed: int) -> None:
    """A square passes a textured wall; it comes in, goes, and comes back elsewhere."""
    config = PRESETS[name]
    n, height, width = 120, 30, 40
    wall = smooth_video(1, height, width, seed)[0]
    video = np.repeat(wall[None], n, axis=0)
    for k in range(n):
        if k % 60 > 5 and k % 60 < 50:
            x, y = (k % 60) - 10, 8 + k // 8
            video[k, max(y, 0) : y + 7, max(x, 0) : max(x + 9, 0)] = 0.1
    assert (video[0] == wall).all()
    times_s = 1e-3 * np.arange(n)
    whole = events_from_frames(video, times_s, config, rng(seed))
    boxes = spread_px(video, seed)
    by_instant = Sensor(config, wall, 0.0, rng(seed))
    for k in range(1, n):
        # An instant without the square may be left out when those around it are without as well.
        if (video[k - 1 : k + 2] != wall).any():
            feed_crop(by_instant, times_s[k], video[k], boxes[k])
    np.testing.assert_array_equal(by_instant.finish(times_s[-1]), whole)
    assert len(whole) > 1000


@pytest.mark.parametrize("name", PRESETS)
def test_one_feed_or_many(name: str) -> None:
    config = PRESETS[name]
    video, times_s = smooth_video(50, 12, 15), 1e-3 * np.arange(50)
    zeros = np.zeros(49, np.int64)
    once = Sensor(config, video[0], 0.0, rng(1))
    once.feed(times_s[1:], zeros, zeros, video[1:])
    often = Sensor(config, video[0], 0.0, rng(1))
    for part in (slice(1, 2), slice(2, 30), slice(30, 50)):
        n = len(times_s[part])
        often.feed(times_s[part], zeros[:n], zeros[:n], video[part])
    np.testing.assert_array_equal(once.finish(0.06), often.finish(0.06))


@pytest.mark.parametrize("name", PRESETS)
@pytest.mark.parametrize("step_s", [1e-3, 0.7e-6])
def test_events_may_be_taken_as_they_settle(name: str, step_s: float) -> None:
    """Also where many instants, and so feeds, fall into one microsecond."""
    config = PRESETS[name]
    video, times_s = smooth_video(50, 12, 15), step_s * np.arange(50)
    whole = events_from_frames(video, times_s, config, rng(1))
    sensor, taken = Sensor(config, video[0], 0.0, rng(1)), []
    for k in range(1, 50):
        sensor.feed(times_s[k : k + 1], ZERO, ZERO, video[k : k + 1])
        taken.append(sensor.take_settled())
        if len(taken[-1]):
            assert taken[-1]["t"][-1] < np.rint(1e6 * times_s[k])
    taken.append(sensor.finish(times_s[-1]))
    np.testing.assert_array_equal(np.concatenate(taken), whole)
    left_for_the_end = len(taken[-1]) / len(whole)
    assert (left_for_the_end < 0.2) == config.is_ideal_in_time


@pytest.mark.parametrize("name", PRESETS)
def test_a_start_that_is_not_the_background(name: str) -> None:
    """The drone is in view from the first instant on, and then gone."""
    wall = smooth_video(1, 20, 25, 4)[0]
    video = np.repeat(wall[None], 3, axis=0)
    video[0, 3:9, 4:11] = 0.05
    times_s = np.array([0.0, 0.01, 0.02])
    whole = events_from_frames(video, times_s, PRESETS[name], rng(2))
    sensor = Sensor(PRESETS[name], video[0], 0.0, rng(2), background=wall)
    for k in (1, 2):
        feed_crop(sensor, times_s[k], video[k], ((17, 13), (19, 18)))
    np.testing.assert_array_equal(sensor.finish(0.02), whole)
    on_pixels = whole[whole["p"] == 1]
    assert len(np.unique(on_pixels["y"] * 25 + on_pixels["x"])) >= 42
