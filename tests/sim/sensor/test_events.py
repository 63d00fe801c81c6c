from dataclasses import replace

import numpy as np
import pytest

from sim.errors import SimError
from sim.sensor.events import PRESETS, Sensor, SensorConfig, events_from_frames
from sim.sensor.kernels import EVENT_DTYPE
from tests.sim.sensor.videos import (
    EPS,
    IDEAL,
    SLOW,
    reference_levels,
    rng,
    smooth_video,
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
