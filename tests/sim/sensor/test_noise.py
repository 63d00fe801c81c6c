"""Noise, leaks, hot pixels and dead times: rates, and what they leave of the light."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from sim.sensor.events import Sensor, SensorConfig, events_from_frames
from tests.sim.scenes import EPS, ZERO, counts, gaps_us, rng, smooth_video


def still_events(
    config: SensorConfig, light: float, duration_s: float, shape: tuple[int, int] = (50, 60)
) -> NDArray[Any]:
    image = np.full(shape, light, np.float32)
    return Sensor(config, image, 0.0, rng(11)).finish(duration_s)


def assert_poisson(count: int, expected: float) -> None:
    assert abs(count - expected) < 5.0 * expected**0.5  # five standard deviations, fixed seed


@pytest.mark.parametrize("light", [0.0, 0.5, 1.0])
def test_shot_noise_falls_to_a_quarter_in_full_light(light: float) -> None:
    events = still_events(SensorConfig(shot_noise_hz=2.0), light, duration_s=5.0)
    expected = 2.0 * (1.0 - 0.75 * light) * 5.0 * 3000
    assert_poisson(len(events), expected)
    assert_poisson(int((events["p"] == 1).sum()), expected / 2)
    times = np.histogram(events["t"], bins=10, range=(0, 5_000_000))[0]
    assert np.abs(times - expected / 10).max() < 5.0 * (expected / 10) ** 0.5
    per_pixel = counts(events, (50, 60))
    # Of a Poisson count of mean m the variance is m, known here to sqrt(2 / 3000).
    assert per_pixel.var() == pytest.approx(expected / 3000, rel=5 * (2.5 / 3000) ** 0.5)


@pytest.mark.parametrize("light", [0.0, 0.6])
@pytest.mark.parametrize("mismatch", [0.0, 0.03])
def test_leak_events_are_on_and_regular(light: float, mismatch: float) -> None:
    config = SensorConfig(leak_hz=3.0, threshold_mismatch=mismatch)
    events = still_events(config, light, duration_s=4.0)
    assert (events["p"] == 1).all()
    # Every pixel fires each 1/3 s, from a random phase on: 12 times in 4 s, to round-off.
    per_pixel = counts(events, (50, 60))
    assert set(per_pixel) <= {11, 12, 13}
    assert len(events) == pytest.approx(12 * 3000, abs=30)
    first = events[events["y"] * 60 + events["x"] == 1234]
    assert np.abs(np.diff(first["t"]) - 1e6 / 3).max() <= 1
    phases = np.histogram(events["t"] % 333_333, bins=10)[0]
    assert np.abs(phases - 3600).max() < 5 * 12 * 300**0.5  # 300 pixels, 12 events each


def test_leaking_pixels_that_see_change_stay_within_a_threshold() -> None:
    """The level that leaks is never further from the light than the threshold."""
    config = SensorConfig(leak_hz=5.0)
    video, times_s = smooth_video(100, 20, 30), 5e-3 * np.arange(100)
    sensor = Sensor(config, video[0], 0.0, rng(1))
    for k in range(1, 100):
        sensor.feed(times_s[k : k + 1], ZERO, ZERO, video[k : k + 1])
        distance = np.log((video[k] + EPS) / sensor._reference)
        # Between instants both light and the leak's exponential are taken as linear.
        assert np.abs(distance).max() < 0.25 + 1e-3
    assert (sensor.finish(0.5)["p"] == 0).any()


def test_hot_pixels() -> None:
    config = SensorConfig(hot_pixel_share=0.02, hot_pixel_hz=40.0)
    events = still_events(config, 0.5, duration_s=10.0, shape=(100, 100))
    per_pixel = counts(events, (100, 100))
    hot = per_pixel[per_pixel > 0] / 10.0
    assert (events["p"] == 1).all()
    assert abs(len(hot) - 200) < 5 * 200**0.5  # a draw per pixel
    # Log-normal of spread 0.7 about the median.
    assert np.log(np.median(hot) / 40.0) == pytest.approx(0.0, abs=5 * 1.25 * 0.7 / 200**0.5)
    assert np.log(hot).std() == pytest.approx(0.7, abs=5 * 0.7 / 400**0.5)


@pytest.mark.parametrize("config", [
    SensorConfig(refractory_s=0.002),
    SensorConfig(refractory_s=0.002, shot_noise_hz=300.0, leak_hz=20.0),
    SensorConfig(refractory_s=0.01, hot_pixel_share=0.5, hot_pixel_hz=200.0),
])  # fmt: skip
def test_no_two_events_of_a_pixel_within_the_dead_time(config: SensorConfig) -> None:
    video, times_s = smooth_video(150, 20, 30), 1e-3 * np.arange(150)
    events = events_from_frames(video, times_s, config)
    gaps = gaps_us(events)
    assert len(gaps) > 1000
    # Whole microseconds: rounding two times that are the dead time apart keeps the difference.
    assert gaps.min() >= round(config.refractory_s * 1e6)


def test_a_pixel_memorises_anew_at_the_end_of_its_dead_time() -> None:
    """ESIM counts the thresholds passed in the dead time; a real pixel sleeps through them."""
    dead_s, times_s = 0.01, np.linspace(0.0, 1.0, 101)
    light = 0.1 + 0.8 * times_s[:, None, None]
    events = events_from_frames(light, times_s, SensorConfig(refractory_s=dead_s))
    expected_s, level = [], 0.1 + EPS
    while level * np.exp(0.25) - EPS <= 0.9:
        crossing_s = (level * np.exp(0.25) - EPS - 0.1) / 0.8
        expected_s.append(crossing_s)
        level = 0.1 + 0.8 * (crossing_s + dead_s) + EPS
    np.testing.assert_allclose(events["t"], 1e6 * np.array(expected_s), atol=0.6)  # us, float32
