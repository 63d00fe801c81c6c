from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from sim.errors import SimError
from sim.sensor.events import EVENT_DTYPE, PRESETS, Sensor, SensorConfig, events_from_frames

EPS = 1e-3
IDEAL = SensorConfig()
ZERO = np.zeros(1, np.int64)
# The general loop in place of the one for ideal pixels, with noise too rare to be seen.
SLOW = SensorConfig(refractory_s=1e-15)


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def smooth_video(n: int, height: int, width: int, seed: int = 0) -> NDArray[np.float32]:
    """Blobs that drift over each other: every pixel brightens and darkens by many thresholds."""
    y, x = np.mgrid[:height, :width]
    t = np.arange(n)[:, None, None] / n
    phase = rng(seed).uniform(0, 2 * np.pi, 3)
    waves = (
        np.sin(0.31 * x + 9 * t + phase[0])
        + np.sin(0.23 * y - 7 * t + phase[1])
        + np.sin(0.11 * (x + y) + 13 * t + phase[2])
    )
    return (0.5 + 0.1666 * waves).astype(np.float32)


def step_video(before: float, after: float, n: int = 2) -> NDArray[np.float32]:
    """One pixel that changes once, after the first frame."""
    video = np.full((n, 1, 1), after, np.float32)
    video[0] = before
    return video


def reference_levels(
    events: NDArray[Any], thresholds_on: Any, thresholds_off: Any, shape: tuple[int, int]
) -> NDArray[np.float64]:
    """What the events add up to at each pixel, in log intensity."""
    change = np.zeros(shape)
    x, y = events["x"], events["y"]
    on = events["p"] == 1
    step = np.where(
        on,
        np.broadcast_to(thresholds_on, shape)[y, x],
        -np.broadcast_to(thresholds_off, shape)[y, x],
    )
    np.add.at(change, (y, x), step)
    return change


def spread_px(video: NDArray[Any], seed: int) -> list[tuple[NDArray[np.int64], ...]]:
    """Random rectangles around the places where each frame differs from the first one."""
    generator = rng(seed)
    boxes = []
    for frame in video:
        ys, xs = np.nonzero(frame != video[0])
        low = np.array([xs.min(), ys.min()]) if len(xs) else np.array([3, 3])
        high = np.array([xs.max(), ys.max()]) + 1 if len(xs) else np.array([4, 4])
        margin = generator.integers(0, 3, (2, 2))
        size = np.array(frame.shape[::-1])
        boxes.append((np.maximum(low - margin[0], 0), np.minimum(high + margin[1], size)))
    return boxes


def feed_crop(sensor: Sensor, time_s: float, frame: NDArray[Any], box: Any) -> None:
    (x0, y0), (x1, y1) = box
    crop = np.ascontiguousarray(frame[None, y0:y1, x0:x1])
    sensor.feed(np.array([time_s]), np.array([x0]), np.array([y0]), crop)


# --- What events mean --------------------------------------------------------------------------


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


def test_time_reversed_light_reverses_the_events() -> None:
    """Down by as much as up: what comes back gives the same events mirrored, one level on."""
    video = smooth_video(40, 8, 9)
    times_s = 0.001 * np.arange(40)
    forth = events_from_frames(video, times_s)
    both = events_from_frames(np.concatenate([video, video[-2::-1]]), 0.001 * np.arange(79), IDEAL)
    back = both[len(forth) :]
    # Turning round costs each pixel at most one event.
    assert abs(len(back) - len(forth)) <= 8 * 9
    assert (back["p"] == 1).sum() == pytest.approx((forth["p"] == 0).sum(), abs=8 * 9)


def test_inverted_contrast_swaps_polarities() -> None:
    """Mirrored log intensity: ON and OFF at the same pixels, one for one."""
    log_light = -1.5 + smooth_video(30, 8, 9)
    video, inverted = (np.exp(sign * (log_light + 1.0) - 1.2) - EPS for sign in (1.0, -1.0))
    times_s = 0.001 * np.arange(30)
    a = events_from_frames(video.astype(np.float32), times_s)
    b = events_from_frames(inverted.astype(np.float32), times_s)
    for p in (0, 1):
        counts = [
            np.bincount(e["y"] * 9 + e["x"], e["p"] == q, minlength=72)
            for e, q in ((a, p), (b, 1 - p))
        ]
        # Light, not its logarithm, is linear between instants; at an instant a level may be just
        # reached or just missed.
        assert np.abs(counts[0] - counts[1]).sum() <= 2
    assert len(a) > 200


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


# --- Crops -------------------------------------------------------------------------------------


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


# --- Noise -------------------------------------------------------------------------------------


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
    per_pixel = np.bincount(events["y"] * 60 + events["x"], minlength=3000)
    # Of a Poisson count of mean m the variance is m, known here to sqrt(2 / 3000).
    assert per_pixel.var() == pytest.approx(expected / 3000, rel=5 * (2.5 / 3000) ** 0.5)


@pytest.mark.parametrize("light", [0.0, 1.0])
def test_background_activity_does_not_depend_on_light(light: float) -> None:
    events = still_events(SensorConfig(background_hz=1.5), light, duration_s=4.0)
    assert_poisson(len(events), 1.5 * 4.0 * 3000)


@pytest.mark.parametrize("light", [0.0, 0.6])
@pytest.mark.parametrize("mismatch", [0.0, 0.03])
def test_leak_events_are_on_and_regular(light: float, mismatch: float) -> None:
    config = SensorConfig(leak_hz=3.0, threshold_mismatch=mismatch)
    events = still_events(config, light, duration_s=4.0)
    assert (events["p"] == 1).all()
    # Every pixel fires each 1/3 s, from a random phase on: 12 times in 4 s, to round-off.
    per_pixel = np.bincount(events["y"] * 60 + events["x"], minlength=3000)
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
    per_pixel = np.bincount(events["y"] * 100 + events["x"], minlength=10_000)
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
    by_pixel = events[np.lexsort((events["t"], events["x"], events["y"]))]
    same = (np.diff(by_pixel["x"]) == 0) & (np.diff(by_pixel["y"]) == 0)
    gaps_us = np.diff(by_pixel["t"])[same]
    assert len(gaps_us) > 1000
    # Whole microseconds: rounding two times that are the dead time apart keeps the difference.
    assert gaps_us.min() >= round(config.refractory_s * 1e6)


def test_a_pixel_memorises_anew_at_the_end_of_its_dead_time() -> None:
    """ESIM counts the thresholds passed in the dead time; a real pixel sleeps through them."""
    dead_s = 0.01
    times_s = np.linspace(0.0, 1.0, 101)
    light = 0.1 + 0.8 * times_s
    config = SensorConfig(refractory_s=dead_s)
    events = events_from_frames(light[:, None, None], times_s, config)
    expected_s = []
    level = 0.1 + EPS
    while level * np.exp(0.25) - EPS <= 0.9:
        crossing_s = (level * np.exp(0.25) - EPS - 0.1) / 0.8
        expected_s.append(crossing_s)
        level = 0.1 + 0.8 * (crossing_s + dead_s) + EPS
    np.testing.assert_allclose(events["t"], 1e6 * np.array(expected_s), atol=0.6)  # us, float32


def test_a_step_within_the_dead_time_is_lost() -> None:
    light = np.array([0.1, 0.2, 0.8, 0.8, 0.8], np.float32)[:, None, None]
    times_s = np.array([0.0, 0.001, 0.002, 0.5, 0.6])
    events = events_from_frames(light, times_s, SensorConfig(refractory_s=0.1))
    assert len(events) == 1
    assert events["p"] == 1


def test_thresholds_do_not_change_with_time() -> None:
    """Each pixel's events lie one and the same step of log intensity apart, but not all pixels'."""
    video = np.empty((2, 10, 12), np.float32)
    video[0], video[1] = 0.02, 1.0
    config = SensorConfig(threshold_mismatch=0.05)
    events = events_from_frames(video, np.array([0.0, 1.0]), config, rng(3))
    steps = []
    for y, x in np.ndindex(10, 12):
        at_s = 1e-6 * events["t"][(events["y"] == y) & (events["x"] == x)]
        log_light = np.log(0.02 + 0.98 * np.concatenate([[0.0], at_s]) + EPS)
        # Half a microsecond at the start, where log intensity changes by 47 a second.
        np.testing.assert_allclose(np.diff(log_light), np.diff(log_light)[0], atol=5e-5)
        steps.append(np.diff(log_light)[0])
    assert np.std(steps) == pytest.approx(0.05, rel=5 / 240**0.5)  # 120 draws


def test_seeds() -> None:
    config = PRESETS["davis346"]
    video, times_s = smooth_video(50, 20, 30), 1e-2 * np.arange(50)
    a, b, c = (events_from_frames(video, times_s, config, rng(seed)) for seed in (1, 1, 2))
    np.testing.assert_array_equal(a, b)
    assert len(a) != len(c) or (a != c).any()


def test_light_exactly_on_a_threshold_is_no_division_by_zero() -> None:
    """By rounding, light may be within a threshold when it moves and beyond it when still."""
    generator = rng(0)
    for seed in range(3000):
        before, after = generator.random(2).astype(np.float32)
        contrast = abs(np.log((float(after) + EPS) / (float(before) + EPS)))
        config = SensorConfig(max(contrast, 0.02), max(contrast, 0.02), background_hz=3.0)
        video = step_video(before, after, 4)
        events_from_frames(video, np.arange(4.0), config, rng(seed))


# --- A user's own video ------------------------------------------------------------------------


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


@pytest.mark.parametrize(
    ("shape", "times_s"),
    [((3, 4), [0, 1, 2]), ((3, 4, 5, 3), [0, 1, 2]), ((3, 4, 5), [0, 1]), ((1, 4, 5), [0])],
)
def test_shapes_that_do_not_fit(shape: tuple[int, ...], times_s: list[float]) -> None:
    with pytest.raises(SimError, match=r"expected an array \(n, height, width\) and n >= 2 times"):
        events_from_frames(np.zeros(shape, np.float32), np.array(times_s))


@pytest.mark.parametrize("times_s", [[0, 2, 1], [0, 1, 1], [0, np.nan, 2], [0, 1, np.inf]])
def test_times_that_do_not_increase(times_s: list[float]) -> None:
    with pytest.raises(SimError, match="times must be finite and increase"):
        events_from_frames(np.zeros((3, 4, 5), np.float32), np.array(times_s))


@pytest.mark.parametrize("value", [-0.01, 1.01, 200.0, np.nan, np.inf])
@pytest.mark.parametrize("k", [0, 2])
def test_light_out_of_range(value: float, k: int) -> None:
    video = np.full((3, 4, 5), 0.5)
    video[k, 1, 2] = value
    with pytest.raises(SimError, match=r"expected linear intensities in \[0, 1\]"):
        events_from_frames(video, np.arange(3.0))


@pytest.mark.parametrize("name", ["threshold_on", "threshold_off", "log_eps"])
@pytest.mark.parametrize("value", [0.0, -0.1, np.nan, np.inf])
def test_thresholds_must_be_positive(name: str, value: float) -> None:
    with pytest.raises(SimError, match=f"sensor: {name} must be a positive number"):
        SensorConfig(**{name: value})


@pytest.mark.parametrize(
    "name",
    ["threshold_mismatch", "refractory_s", "leak_hz", "shot_noise_hz", "background_hz",
     "hot_pixel_share", "hot_pixel_hz"],
)  # fmt: skip
@pytest.mark.parametrize("value", [-0.1, np.nan, np.inf])
def test_noise_must_not_be_negative(name: str, value: float) -> None:
    with pytest.raises(SimError, match=f"sensor: {name} must be 0 or a positive number"):
        SensorConfig(**{name: value})


def test_hot_pixels_are_a_share() -> None:
    with pytest.raises(SimError, match="hot_pixel_share is a share of 1"):
        SensorConfig(hot_pixel_share=1.5)
