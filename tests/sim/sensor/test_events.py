"""Events are what thresholds make of light, and of noise, whole or in crops, in order."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from sim.sensor.events import PRESETS, Sensor, SensorConfig, events_from_frames
from sim.sensor.kernels import EventBuffer
from tests.sim.scenes import (
    EPS,
    IDEAL,
    SLOW,
    ZERO,
    by_pixel,
    counts,
    events_of_crops,
    feed,
    feed_crop,
    gaps_us,
    passing_square,
    reference_levels,
    rng,
    smooth_video,
    step_video,
)


@pytest.mark.parametrize("config", [
    *(replace(config, threshold_on=on, threshold_off=off)
      for config in (IDEAL, SLOW) for on, off in ((0.25, 0.25), (0.1, 0.3))),
    SensorConfig(threshold_mismatch=0.05),
])  # fmt: skip
def test_events_rebuild_the_log_image(config: SensorConfig) -> None:
    """Each pixel by its own threshold, the same at all times."""
    video, times_s = smooth_video(60, 20, 30), 0.001 * np.arange(60)
    given = video.copy()
    sensor = Sensor(config, video[0], 0.0, rng(5))
    on, off = config.threshold_on, config.threshold_off
    if config.threshold_mismatch:
        on, off = np.log(sensor._up), -np.log(sensor._down)
        # 600 draws of each: 5 standard errors.
        assert on.mean() == pytest.approx(0.25, abs=5 * 0.05 / 600**0.5)
        assert on.std() == pytest.approx(0.05, rel=5 / 1200**0.5)
        assert abs(np.corrcoef(on.ravel(), off.ravel())[0, 1]) < 5 / 600**0.5
    feed(sensor, times_s[1:], video[1:])
    events = sensor.finish(times_s[-1])
    np.testing.assert_array_equal(video, given)
    log_light = np.log(video.astype(np.float64) + EPS)
    for k in range(60):
        # Times are rounded to 1 us: those up to half of it later belong to the instant.
        before = events[events["t"] <= 1000 * k]
        error = log_light[k] - log_light[0] - reference_levels(before, on, off, (20, 30))
        # float32 light and 1 us of a change of at most 40 thresholds per second.
        assert (error < on + 1e-4).all()
        assert (error > -off - 1e-4).all()
    assert len(events) > 10 * 20 * 30


@pytest.mark.parametrize("config", [IDEAL, SLOW], ids=["ideal", "general"])
@pytest.mark.parametrize(("before", "after"), [(0.1, 0.9), (0.9, 0.1), (0.0, 1.0), (1.0, 0.0)])
def test_crossings_of_a_linear_ramp(config: SensorConfig, before: float, after: float) -> None:
    """I(t) = I0 + (I1 - I0) t passes (I0 + eps) exp(+- k C) - eps at a time in closed form."""
    duration_s = 0.5
    video = step_video(before, after)
    events = events_from_frames(video, np.array([2.0, 2.0 + duration_s]), config)
    sign = 1.0 if after > before else -1.0
    n = int(abs(np.log((after + EPS) / (before + EPS))) / 0.25)
    levels = (before + EPS) * np.exp(sign * 0.25 * np.arange(1, n + 1)) - EPS
    times_us = 1e6 * (2.0 + duration_s * (levels - before) / (after - before))
    assert len(events) == n
    # Rounding to microseconds, and float32 light: 6e-8 of half a second.
    np.testing.assert_allclose(events["t"], times_us, atol=0.5 + 0.05)


@pytest.mark.parametrize("name", [*PRESETS, "slow"])
def test_both_loops_and_many_events(name: str) -> None:
    """The event buffer starts with room for 65,536."""
    config = PRESETS.get(name, SLOW)
    video = smooth_video(200, 40, 50)
    times_s = 1e-3 * np.arange(200)
    events = events_from_frames(video, times_s, replace(config, threshold_on=0.02), rng(3))
    assert len(events) > 1.5 * 65_536
    assert np.diff(events["t"]).min() >= 0


def test_the_general_loop_without_noise_is_the_ideal_one() -> None:
    video, times_s = smooth_video(80, 20, 30), 1e-3 * np.arange(80)
    ideal, general = (by_pixel(events_from_frames(video, times_s, c)) for c in (IDEAL, SLOW))
    np.testing.assert_array_equal(ideal[["x", "y", "p"]], general[["x", "y", "p"]])
    # One memorises the level, the other the light when it passed it: equal to rounding.
    assert np.abs(ideal["t"] - general["t"]).max() <= 1


def test_light_exactly_on_a_threshold_is_no_division_by_zero() -> None:
    """By rounding, light may be within a threshold when it moves and beyond it when still."""
    generator = rng(0)
    for seed in range(3000):
        before, after = generator.random(2).astype(np.float32)
        contrast = abs(np.log((float(after) + EPS) / (float(before) + EPS)))
        config = SensorConfig(max(contrast, 0.02), max(contrast, 0.02), background_hz=3.0)
        video = step_video(before, after, 4)
        events_from_frames(video, np.arange(4.0), config, rng(seed))


def test_videos_of_any_type_and_layout() -> None:
    video, times_s = smooth_video(20, 10, 12), 0.04 * np.arange(20)
    expected = events_from_frames(video, times_s)
    twice = np.repeat(np.repeat(video, 2, axis=1), 2, axis=2)
    backwards = np.ascontiguousarray(video[:, ::-1])[:, ::-1]
    same = (video.astype(np.float64), np.asfortranarray(video), twice[:, ::2, ::2], backwards)
    for given in same:
        np.testing.assert_array_equal(events_from_frames(given, times_s), expected)
    for dtype in (np.uint8, np.uint16):
        codes = np.rint(video * np.iinfo(dtype).max).astype(dtype)
        light = codes.astype(np.float32) / np.float32(np.iinfo(dtype).max)
        of_light = events_from_frames(light, times_s)
        np.testing.assert_array_equal(events_from_frames(codes, times_s), of_light)


@pytest.mark.parametrize("name", PRESETS)
@pytest.mark.parametrize("seed", [0, 1])
def test_crops_give_the_events_of_whole_frames(name: str, seed: int) -> None:
    video, times_s = passing_square(seed)
    whole = events_from_frames(video, times_s, PRESETS[name], rng(seed))
    sensor = Sensor(PRESETS[name], video[0], 0.0, rng(seed))
    np.testing.assert_array_equal(events_of_crops(sensor, times_s, video, seed), whole)
    assert len(whole) > 1000


@pytest.mark.parametrize("name", PRESETS)
@pytest.mark.parametrize("step_s", [1e-3, 0.7e-6])
def test_events_may_be_taken_as_they_settle(name: str, step_s: float) -> None:
    """One instant at a time or many; also where many feeds fall into one microsecond."""
    config = PRESETS[name]
    video, times_s = smooth_video(50, 12, 15), step_s * np.arange(50)
    whole = events_from_frames(video, times_s, config, rng(1))
    sensor, taken = Sensor(config, video[0], 0.0, rng(1)), []
    for part in (*(slice(k, k + 1) for k in range(1, 20)), slice(20, 45), slice(45, 50)):
        feed(sensor, times_s[part], video[part])
        taken.append(sensor.take_settled())
        if len(taken[-1]):
            assert taken[-1]["t"][-1] < np.rint(1e6 * times_s[part][-1])
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


WIDTH, HEIGHT = 7, 5


# A microsecond is shared by many events, and in the last case time, pixel and index do not fit one
# number of 64 bits: 51, 6 and 9 bits.
@pytest.mark.parametrize("span_s", [1e-5, 1.0, 2e9])
@pytest.mark.parametrize("n", [0, 1, 300])
def test_by_time_row_column_and_order_of_emission(span_s: float, n: int) -> None:
    """Those that stay are taken next."""
    t_s = span_s * (rng(n).integers(0, 10, n) / 10 - 0.3)
    about = np.stack([rng(n + 1).integers(0, high, n) for high in (WIDTH, HEIGHT, 2)])
    buffer = EventBuffer()
    buffer.n = n
    for name, values in zip(("t_s", "x", "y", "p"), (t_s, *about), strict=True):
        buffer.events[name][:n] = values
    rows = np.column_stack([np.rint(1e6 * t_s).astype(np.int64), *about])
    expected = rows[np.lexsort((rows[:, 1], rows[:, 2], rows[:, 0]))]  # a stable sort
    until_us = 0.25e6 * span_s
    first, second = (buffer.take(us, WIDTH, HEIGHT) for us in (until_us, np.inf))
    assert (first["t"] < until_us).all()
    assert (second["t"] >= until_us).all()
    taken = np.concatenate([first, second])
    np.testing.assert_array_equal(np.stack([taken[name] for name in "txyp"], axis=1), expected)
    assert buffer.n == 0


# --- Noise, leaks, hot pixels and dead times ---------------------------------------------------


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


@pytest.mark.parametrize(
    "config",
    [
        SensorConfig(refractory_s=0.002),
        SensorConfig(refractory_s=0.002, shot_noise_hz=300.0, leak_hz=20.0),
        SensorConfig(refractory_s=0.01, hot_pixel_share=0.5, hot_pixel_hz=200.0),
    ],
)
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
