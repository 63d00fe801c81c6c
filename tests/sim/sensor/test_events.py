"""Events are what thresholds make of light, whole or in crops, and come out in order."""

from dataclasses import replace

import numpy as np
import pytest

from sim.sensor.events import PRESETS, Sensor, SensorConfig, events_from_frames
from sim.sensor.kernels import EventBuffer
from tests.sim.scenes import (
    EPS,
    IDEAL,
    SLOW,
    ZERO,
    by_pixel,
    events_of_crops,
    feed,
    feed_crop,
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
def test_one_feed_or_many(name: str) -> None:
    video, times_s = smooth_video(50, 12, 15), 1e-3 * np.arange(50)
    once, often = (Sensor(PRESETS[name], video[0], 0.0, rng(1)) for _ in range(2))
    feed(once, times_s[1:], video[1:])
    for part in (slice(1, 2), slice(2, 30), slice(30, 50)):
        feed(often, times_s[part], video[part])
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
