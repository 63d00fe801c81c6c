"""Events are what thresholds make of light, whole or in crops, and come out in order."""

from dataclasses import replace

import numpy as np
import pytest

from sim.sensor.events import PRESETS, Sensor, SensorConfig, events_from_frames
from sim.sensor.kernels import EVENT_DTYPE, EventBuffer
from tests.sim.sensor.videos import (
    EPS,
    IDEAL,
    SLOW,
    ZERO,
    feed_crop,
    reference_levels,
    rng,
    smooth_video,
    spread_px,
    step_video,
)


@pytest.mark.parametrize("config", [IDEAL, SLOW], ids=["ideal", "general"])
@pytest.mark.parametrize("threshold", [(0.25, 0.25), (0.1, 0.3)])
def test_events_rebuild_the_log_image(config: SensorConfig, threshold: tuple[float, float]) -> None:
    on, off = threshold
    config = replace(config, threshold_on=on, threshold_off=off)
    video = smooth_video(60, 20, 30)
    times_s = 0.001 * np.arange(60)
    events = events_from_frames(video, times_s, config)
    log_light = np.log(video.astype(np.float64) + EPS)
    for k in range(60):
        # Times are rounded to 1 us: those up to half of it later belong to the instant.
        before = events[events["t"] <= 1000 * k]
        error = log_light[k] - log_light[0] - reference_levels(before, on, off, (20, 30))
        # float32 light and 1 us of a change of at most 40 thresholds per second.
        assert error.max() < on + 1e-4
        assert error.min() > -off - 1e-4
    assert len(events) > 10 * 20 * 30


def test_events_rebuild_the_log_image_with_mismatch() -> None:
    """Each pixel by its own threshold, the same at all times."""
    config = SensorConfig(threshold_mismatch=0.05)
    video = smooth_video(60, 20, 30)
    times_s = 0.001 * np.arange(60)
    sensor = Sensor(config, video[0], 0.0, rng(5))
    on, off = np.log(sensor._up), -np.log(sensor._down)
    sensor.feed(times_s[1:], np.zeros(59, np.int64), np.zeros(59, np.int64), video[1:])
    events = sensor.finish(times_s[-1])
    log_light = np.log(video.astype(np.float64) + EPS)
    for k in (20, 40, 59):
        before = events[events["t"] <= 1000 * k]
        error = log_light[k] - log_light[0] - reference_levels(before, on, off, (20, 30))
        assert (error < on + 1e-4).all()
        assert (error > -off - 1e-4).all()
    # 600 draws of each: 5 standard errors.
    assert on.mean() == pytest.approx(0.25, abs=5 * 0.05 / 600**0.5)
    assert on.std() == pytest.approx(0.05, rel=5 / 1200**0.5)
    assert abs(np.corrcoef(on.ravel(), off.ravel())[0, 1]) < 5 / 600**0.5


@pytest.mark.parametrize("config", [IDEAL, SLOW], ids=["ideal", "general"])
@pytest.mark.parametrize("contrast", [0.24, 0.26, 0.74, 0.76, 2.6])
@pytest.mark.parametrize("polarity", [0, 1])
def test_a_step_gives_one_event_per_threshold(
    config: SensorConfig, contrast: float, polarity: int
) -> None:
    dark, bright = 0.05, (0.05 + EPS) * np.exp(contrast) - EPS
    before, after = (dark, bright) if polarity else (bright, dark)
    events = events_from_frames(step_video(before, after), np.array([0.0, 1.0]), config)
    assert events.dtype == EVENT_DTYPE
    assert len(events) == int(contrast / 0.25)
    assert (events["p"] == polarity).all()


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


@pytest.mark.parametrize("parts", [2, 3, 17])
def test_a_ramp_may_be_cut_into_instants(parts: int) -> None:
    ramp = np.linspace(0.1, 0.9, parts + 1, dtype=np.float32)[:, None, None]
    times_s = np.linspace(0.0, 0.5, parts + 1)
    whole = events_from_frames(ramp[[0, -1]], times_s[[0, -1]])
    cut = events_from_frames(ramp, times_s)
    np.testing.assert_array_equal(cut["p"], whole["p"])
    assert np.abs(cut["t"] - whole["t"]).max() <= 1  # float32 light, then microseconds


def test_still_light_gives_no_events() -> None:
    video = np.repeat(smooth_video(1, 8, 9), 5, axis=0)
    for config in (IDEAL, SLOW, SensorConfig(threshold_mismatch=0.1)):
        assert len(events_from_frames(video, np.arange(5.0), config)) == 0


def test_events_are_sorted_by_time_then_pixel() -> None:
    events = events_from_frames(smooth_video(30, 12, 15), 1e-5 * np.arange(30))
    order = np.lexsort((events["x"], events["y"], events["t"]))
    np.testing.assert_array_equal(order, np.arange(len(events)))
    assert len(np.unique(events["t"])) < len(events)


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
    ideal, general = (events_from_frames(video, times_s, config) for config in (IDEAL, SLOW))
    assert len(ideal) == len(general)
    by_pixel = [e[np.lexsort((e["t"], e["x"], e["y"]))] for e in (ideal, general)]
    for name in ("x", "y", "p"):
        np.testing.assert_array_equal(by_pixel[0][name], by_pixel[1][name])
    # One memorises the level, the other the light when it passed it: equal to rounding.
    assert np.abs(by_pixel[0]["t"] - by_pixel[1]["t"]).max() <= 1


def test_light_exactly_on_a_threshold_is_no_division_by_zero() -> None:
    """By rounding, light may be within a threshold when it moves and beyond it when still."""
    generator = rng(0)
    for seed in range(3000):
        before, after = generator.random(2).astype(np.float32)
        contrast = abs(np.log((float(after) + EPS) / (float(before) + EPS)))
        config = SensorConfig(max(contrast, 0.02), max(contrast, 0.02), background_hz=3.0)
        video = step_video(before, after, 4)
        events_from_frames(video, np.arange(4.0), config, rng(seed))


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float64, np.float32])
def test_videos_of_any_type(dtype: type) -> None:
    video = smooth_video(20, 10, 12)
    if np.issubdtype(dtype, np.integer):
        given = np.rint(video * np.iinfo(dtype).max).astype(dtype)
        as_light = given.astype(np.float32) / np.float32(np.iinfo(dtype).max)
    else:
        given = video.astype(dtype)
        as_light = video
    times_s = 0.04 * np.arange(20)
    np.testing.assert_array_equal(
        events_from_frames(given, times_s), events_from_frames(as_light, times_s)
    )


def test_videos_in_any_layout() -> None:
    video, times_s = smooth_video(20, 10, 12), 0.04 * np.arange(20)
    expected = events_from_frames(video, times_s)
    np.testing.assert_array_equal(events_from_frames(np.asfortranarray(video), times_s), expected)
    twice = np.repeat(np.repeat(video, 2, axis=1), 2, axis=2)
    np.testing.assert_array_equal(events_from_frames(twice[:, ::2, ::2], times_s), expected)
    backwards = np.ascontiguousarray(video[:, ::-1])[:, ::-1]
    np.testing.assert_array_equal(events_from_frames(backwards, times_s), expected)


def test_arguments_stay_as_they_are() -> None:
    video = smooth_video(5, 10, 12)
    copy = video.copy()
    sensor = Sensor(IDEAL, video[0], 0.0, rng())
    sensor.feed(np.arange(1.0, 5.0), np.zeros(4, np.int64), np.zeros(4, np.int64), video[1:])
    np.testing.assert_array_equal(video, copy)


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


WIDTH, HEIGHT = 7, 5


def filled(t_s: np.ndarray, seed: int) -> tuple[EventBuffer, np.ndarray]:
    """Fill a buffer with events at random pixels; returns t [us], x, y and p too, (n, 4)."""
    rng, n = np.random.default_rng(seed), len(t_s)
    about = np.stack([rng.integers(0, high, n) for high in (WIDTH, HEIGHT, 2)])
    buffer = EventBuffer()
    buffer.n = n
    buffer.t_s[:n] = t_s
    buffer.x[:n], buffer.y[:n], buffer.p[:n] = about
    return buffer, np.column_stack([np.rint(1e6 * t_s).astype(np.int64), *about])


# A microsecond is shared by many events, and in the last case time, pixel and index do not fit one
# number of 64 bits: 51, 6 and 9 bits.
@pytest.mark.parametrize("span_s", [1e-5, 1.0, 2e9])
@pytest.mark.parametrize("n", [0, 1, 300])
def test_by_time_row_column_and_order_of_emission(span_s: float, n: int) -> None:
    t_s = span_s * (np.random.default_rng(n).integers(0, 10, n) / 10 - 0.3)
    buffer, rows = filled(t_s, n)
    taken = buffer.take(np.inf, WIDTH, HEIGHT)
    expected = rows[np.lexsort((rows[:, 1], rows[:, 2], rows[:, 0]))]  # a stable sort
    np.testing.assert_array_equal(np.stack([taken[name] for name in "txyp"], axis=1), expected)
    assert buffer.n == 0


def test_those_that_stay_are_taken_next() -> None:
    t_s = np.random.default_rng(1).uniform(0.0, 1e-3, 500)
    buffer, rows = filled(t_s, 1)
    first, second = buffer.take(400.0, WIDTH, HEIGHT), buffer.take(np.inf, WIDTH, HEIGHT)
    assert first["t"].max() < 400
    assert second["t"].min() >= 400
    taken = np.concatenate([first, second])
    expected = rows[np.lexsort((rows[:, 1], rows[:, 2], rows[:, 0]))]
    np.testing.assert_array_equal(np.stack([taken[name] for name in "txyp"], axis=1), expected)
