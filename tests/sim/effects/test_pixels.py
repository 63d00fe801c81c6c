"""What a pixel with effects does to light, and when it fires without cause."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from sim.effects.config import SENSOR_PRESETS, SensorEffects
from sim.effects.pixels import EffectsSensor
from sim.sensor.events import SensorConfig, events_from_frames
from tests.sim.scenes import (
    EPS,
    by_pixel,
    counts,
    events_of_crops,
    feed,
    gaps_us,
    passing_square,
    rng,
    smooth_video,
)

SHAPE = (50, 60)
FLICKER_RAD = 1.0  # away from crests, where a threshold may just be reached or not
QUIET = SensorConfig(threshold_on=20.0, threshold_off=20.0)  # only noise makes events


def events_of(
    light: NDArray[Any],
    times_s: NDArray[np.float64],
    effects: SensorEffects,
    config: SensorConfig | None = None,
    seed: int = 1,
) -> NDArray[Any]:
    """Events of a video (n, height, width) of linear light at times (n,) [s]."""
    video = np.ascontiguousarray(light, np.float32)
    about = (config or SensorConfig(), effects, video[0], float(times_s[0]), rng(seed))
    sensor = EffectsSensor(*about, effects_rng=rng(seed + 1000), flicker_rad=FLICKER_RAD)
    feed(sensor, times_s[1:], video[1:])
    return sensor.finish(float(times_s[-1]))


def still_events(
    effects: SensorEffects,
    light: float,
    duration_s: float,
    config: SensorConfig = QUIET,
    shape: tuple[int, int] = SHAPE,
) -> NDArray[Any]:
    """Events of pixels that see one and the same light all along."""
    image = np.full(shape, light, np.float32)
    sensor = EffectsSensor(config, effects, image, 0.0, rng(11), effects_rng=rng(12))
    return sensor.finish(duration_s)


def stepping(before: float, after: float, at_s: float, until_s: float, shape: Any = (1, 1)) -> Any:
    """A video of light that changes once, within a nanosecond, and its times."""
    times_s = np.array([0.0, at_s, at_s + 1e-9, until_s])
    levels = np.array([before, before, after, after], np.float32)
    return np.broadcast_to(levels[:, None, None], (4, *shape)), times_s


FINE = SensorConfig(threshold_on=0.02, threshold_off=0.02)


@pytest.mark.parametrize(
    "effects",
    [
        SensorEffects(latency_s=1e-12),
        # A time constant of 0.2 us.
        SensorEffects(cutoff_hz_per_lux=1e4, cutoff_min_hz=1e6, cutoff_max_hz=1e6),
        SensorEffects(flicker_depth=1e-9),
    ],
)
def test_effects_that_are_next_to_nothing_give_the_ideal_events(effects: SensorEffects) -> None:
    video, times_s = smooth_video(60, 20, 30), 1e-3 * np.arange(60)
    ideal = by_pixel(events_from_frames(video, times_s))
    events = by_pixel(events_of(video, times_s, effects))
    assert len(ideal) > 5000
    np.testing.assert_array_equal(events[["x", "y", "p"]], ideal[["x", "y", "p"]])
    # The time constant, and half a microsecond of rounding each.
    assert np.abs(events["t"] - ideal["t"]).max() <= 2


@pytest.mark.parametrize("name", SENSOR_PRESETS)
def test_crops_give_the_events_of_whole_frames(name: str) -> None:
    preset, (video, times_s) = SENSOR_PRESETS[name], passing_square(0)
    whole = events_of(video, times_s, preset.effects, preset.sensor)
    sensor = EffectsSensor(preset.sensor, preset.effects, video[0], 0.0, rng(1),
                           effects_rng=rng(1001), flicker_rad=FLICKER_RAD)  # fmt: skip
    np.testing.assert_array_equal(events_of_crops(sensor, times_s, video, 0), whole)
    assert len(whole) > 300


@pytest.mark.parametrize(
    ("lux", "light", "expected_hz"),
    [(1.0, 0.4, 12.0), (20.0, 0.4, 240.0), (20.0, 0.2, 120.0), (1e4, 0.4, 3e3), (0.01, 0.4, 5.0)],
)
def test_a_step_is_followed_with_the_time_constant_of_its_light(
    lux: float, light: float, expected_hz: float
) -> None:
    effects = SensorEffects(
        illuminance_lux=lux, cutoff_hz_per_lux=30.0, cutoff_min_hz=5.0, cutoff_max_hz=3000.0
    )
    video, times_s = stepping(light / 2, light, 1.0, 3.0)
    events = events_of(video, times_s, effects, FINE)
    reached = (light / 2 + EPS) * np.exp(0.02 * np.arange(1, len(events) + 1)) - EPS
    left = (light - reached) / (light / 2)
    usable = left > 0.05
    assert usable.sum() > 20
    rate = -np.polyfit(1e-6 * events["t"][usable], np.log(left[usable]), 1)[0]
    # log_eps counts as light, a quarter of a per cent of it; stamps are whole microseconds.
    assert rate / (2 * np.pi) == pytest.approx(expected_hz, rel=0.02)


@pytest.mark.parametrize("lux", [500.0, 5.0])
def test_latency_and_jitter_depend_on_the_light(lux: float) -> None:
    effects = SensorEffects(
        illuminance_lux=lux, latency_s=100e-6, latency_lux_s=1e-3, jitter_s=10e-6, jitter_lux_s=1e-4
    )
    video, times_s = stepping(0.2, 0.3, 1.0, 2.0, SHAPE)
    events = events_of(video, times_s, effects)
    assert len(events) == 3000
    seen_lux = lux * (0.2 + EPS) * np.exp(0.25)  # light at the threshold
    delays_us = events["t"] - 1e6
    expected_us = 100 + 1e3 / seen_lux
    # 3000 draws: deviations of 1.3 % in the deviation, 0.2 % in the mean.
    assert delays_us.mean() == pytest.approx(expected_us, rel=0.02)
    assert delays_us.std() == pytest.approx(expected_us / 10, rel=0.05)


@pytest.mark.parametrize("dead_s", [0.002, 0.01])
def test_no_two_events_of_a_pixel_within_the_dead_time(dead_s: float) -> None:
    preset = SENSOR_PRESETS["davis346"]
    effects = replace(preset.effects, jitter_s=0.0, jitter_lux_s=0.0, latency_lux_s=0.0)
    config = replace(preset.sensor, refractory_s=dead_s)
    video, times_s = smooth_video(150, 20, 30), 1e-3 * np.arange(150)
    events = events_of(video, times_s, effects, config)
    gaps = gaps_us(events)
    assert len(gaps) > 1000
    assert gaps.min() >= round(dead_s * 1e6)


def test_a_signal_that_turns_within_an_interval_passes_its_threshold() -> None:
    """The light falls all along, but the photoreceptor still rises to what it was before."""
    effects = SensorEffects(
        illuminance_lux=1e3, cutoff_hz_per_lux=1.0, cutoff_max_hz=50.0, cutoff_min_hz=50.0
    )
    light = np.array([0.2, 0.2, 0.8, 0.1], np.float32)[:, None, None]
    coarse_s = np.array([0.0, 0.1, 0.1 + 1e-9, 0.11])
    fine_s = np.concatenate([coarse_s[:3], np.linspace(0.1 + 1e-9, 0.11, 500)[1:]])
    fine = np.interp(fine_s, coarse_s, light[:, 0, 0])[:, None, None]
    events = [events_of(each, t, effects) for each, t in ((light, coarse_s), (fine, fine_s))]
    assert len(events[0]) == len(events[1]) >= 2
    np.testing.assert_allclose(events[0]["t"], events[1]["t"], atol=2)  # of 10 ms; rounding


@pytest.mark.parametrize("cutoff_hz", [1e6, 50.0])
def test_flicker_is_what_light_that_swings_would_be(cutoff_hz: float) -> None:
    depth, hz = 0.4, 100.0
    filtered = SensorEffects(
        cutoff_hz_per_lux=1e9, cutoff_min_hz=cutoff_hz, cutoff_max_hz=cutoff_hz
    )
    times_s = np.linspace(0.0, 0.3, 30_001)
    # The pixel starts in the middle of all, as if it had followed the lamps for long.
    gain, lag = 1 / np.hypot(1, hz / cutoff_hz), np.arctan(hz / cutoff_hz)
    swinging = 0.5 * (1.0 + depth * np.cos(2 * np.pi * hz * times_s + FLICKER_RAD))
    swinging[0] = 0.5 * (1.0 + depth * gain * np.cos(FLICKER_RAD - lag))
    by_light = events_of(swinging[:, None, None], times_s, filtered)
    still, ends_s = np.full((2, 1, 1), 0.5), times_s[[0, -1]]
    events = events_of(still, ends_s, replace(filtered, flicker_depth=depth))
    assert len(by_light) == len(events) > 50
    np.testing.assert_array_equal(events["p"], by_light["p"])
    # Of cycles of 10 ms: steps of 10 us between whole microseconds, single precision.
    np.testing.assert_allclose(events["t"], by_light["t"], atol=10)


def test_leaking_pixels_under_faint_flicker_fire_at_the_crests() -> None:
    config = SensorConfig(leak_hz=2.0)
    still, faint = np.full((2, *SHAPE), 0.5), SensorEffects(flicker_depth=0.05)
    events = events_of(still, np.array([0.0, 5.0]), faint, config)
    assert (events["p"] == 1).all()
    # A crest lifts the signal by 0.05 of the 0.25 that leak away in half a second, and the level
    # memorised there is as much higher: the rate stays.
    assert len(events) / 3000 / 5.0 == pytest.approx(2.0, rel=0.05)
    phases = np.exp(1j * (2 * np.pi * 100.0 * 1e-6 * events["t"] + FLICKER_RAD))
    assert np.angle(phases.mean()) == pytest.approx(0.0, abs=0.5)  # crests, a little before


@pytest.mark.parametrize("light", [0.1, 0.9])
@pytest.mark.parametrize(("lux", "falls"), [(0.1, 1.0), (1.0, 10**-0.75), (161.0, 1610**-0.75)])
def test_shot_noise_falls_with_the_light(lux: float, falls: float, light: float) -> None:
    duration_s = 10.0 / falls**0.5
    effects = SensorEffects(illuminance_lux=lux / light, dim_noise_on_hz=5.0, dim_noise_off_hz=3.7)
    events = still_events(effects, light, duration_s)
    on = int((events["p"] == 1).sum())
    # At least 5000 events: a deviation of 1.4 % at most.
    per_pixel = falls * duration_s * 3000
    assert on == pytest.approx(5.0 * per_pixel, rel=0.05)
    assert len(events) - on == pytest.approx(3.7 * per_pixel, rel=0.05)


@pytest.mark.parametrize("light", [0.0, 0.5, 0.999])
def test_shot_noise_of_the_sensor_falls_to_a_quarter_in_full_light(light: float) -> None:
    config = replace(QUIET, shot_noise_hz=2.0)
    events = still_events(SensorEffects(latency_s=1e-9), light, 5.0, config)
    expected = 2.0 * (1.0 - 0.75 * light) * 5.0 * 3000
    assert len(events) == pytest.approx(expected, abs=5 * expected**0.5)
    assert (events["p"] == 1).sum() == pytest.approx(expected / 2, abs=5 * (expected / 2) ** 0.5)


def test_noise_falls_due_alike_whether_or_not_the_light_changes() -> None:
    """Pixels are followed at each change: what they wait for meanwhile must not start anew."""
    config = replace(QUIET, background_hz=3.0)
    times_s = np.linspace(0.0, 5.0, 501)
    light = np.broadcast_to(0.5 + 0.01 * (np.arange(501) % 2)[:, None, None], (501, *SHAPE))
    events = events_of(light, times_s, SensorEffects(latency_s=1e-9), config)
    expected = 3.0 * 5.0 * 3000
    assert len(events) == pytest.approx(expected, abs=5 * expected**0.5)


def test_rates_spread_over_pixels() -> None:
    spread = 0.25
    effects = SensorEffects(illuminance_lux=0.1, dim_noise_on_hz=20.0, noise_spread_decades=spread)
    events = still_events(effects, 0.9, 60.0)
    assert len(events) == pytest.approx(20.0 * 60.0 * 3000, rel=0.05)  # 3000 draws: 1.2 %
    # Counts of a thousand each add 0.014 decades.
    assert np.log10(counts(events, SHAPE)).std() == pytest.approx(np.hypot(spread, 0.014), rel=0.05)


@pytest.mark.parametrize("jitter", [0.0, 0.1, 0.2])
def test_times_between_leak_events_jitter(jitter: float) -> None:
    config = SensorConfig(leak_hz=3.0)
    events = still_events(SensorEffects(leak_jitter=jitter, latency_s=1e-9), 0.5, 10.0, config)
    assert (events["p"] == 1).all()
    assert len(events) == pytest.approx(3.0 * 10.0 * 3000, rel=0.01)
    gaps_s = 1e-6 * gaps_us(events)
    assert gaps_s.mean() == pytest.approx(1 / 3.0, rel=0.01)
    assert gaps_s.std() * 3.0 == pytest.approx(jitter, rel=0.05, abs=1e-5)


def test_hot_clusters() -> None:
    effects = SensorEffects(hot_clusters=40, hot_cluster_hz=100.0)
    events = still_events(effects, 0.5, 10.0, QUIET, (200, 200))
    assert (events["p"] == 1).all()
    fired = counts(events, (200, 200))
    hot = fired.reshape(200, 200) > 0
    assert 40 * 9 * 0.9 < hot.sum() <= 40 * 9  # some overlap
    neighbours = sum(np.roll(hot, shift, axis) for shift in (-1, 1) for axis in (0, 1))
    assert (neighbours[hot] >= 2).all()
    # Log-normal of spread 0.7 about the median.
    rates = fired[fired > 0] / 10.0
    assert np.log(np.median(rates) / 100.0) == pytest.approx(0.0, abs=5 * 1.25 * 0.7 / 360**0.5)
