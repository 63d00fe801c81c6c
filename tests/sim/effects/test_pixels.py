"""What a pixel with effects does to light: limits, the photoreceptor's course, stamps, flicker."""

from dataclasses import replace

import numpy as np
import pytest

from sim.effects.config import SENSOR_PRESETS, SensorEffects
from sim.effects.pixels import EffectsSensor
from sim.sensor.events import SensorConfig, events_from_frames
from tests.sim.effects.lights import FLICKER_RAD, SHAPE, events_of, stepping
from tests.sim.sensor.videos import EPS, feed_crop, rng, smooth_video, spread_px

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
    ideal = events_from_frames(video, times_s)
    events = events_of(video, times_s, effects)
    assert len(events) == len(ideal) > 5000
    order = [np.lexsort((each["t"], each["x"], each["y"])) for each in (ideal, events)]
    for name in ("x", "y", "p"):
        np.testing.assert_array_equal(events[name][order[1]], ideal[name][order[0]])
    # The time constant, and half a microsecond of rounding each.
    assert np.abs(events["t"][order[1]] - ideal["t"][order[0]]).max() <= 2


@pytest.mark.parametrize("name", SENSOR_PRESETS)
def test_crops_give_the_events_of_whole_frames(name: str) -> None:
    preset = SENSOR_PRESETS[name]
    n, height, width = 80, 30, 40
    wall = smooth_video(1, height, width)[0]
    video = np.repeat(wall[None], n, axis=0)
    for k in range(8, 70):
        video[k, 8 + k // 8 : 15 + k // 8, max(k // 2 - 5, 0) : k // 2 + 4] = 0.1
    times_s = 1e-3 * np.arange(n)
    whole = events_of(video, times_s, preset.effects, preset.sensor)
    about = (preset.sensor, preset.effects, wall, 0.0, rng(1))
    by_crops = EffectsSensor(
        *about, background=wall, effects_rng=rng(1001), flicker_rad=FLICKER_RAD
    )
    boxes = spread_px(video, 0)
    for k in range(1, n):
        if (video[k - 1 : k + 2] != wall).any():
            feed_crop(by_crops, times_s[k], video[k], boxes[k])
    np.testing.assert_array_equal(by_crops.finish(times_s[-1]), whole)
    assert len(whole) > 300


@pytest.mark.parametrize(
    ("lux", "light", "expected_hz"),
    [
        (1.0, 0.4, 12.0),
        (20.0, 0.4, 240.0),
        (20.0, 0.2, 120.0),
        (1e4, 0.4, 3000.0),
        (0.01, 0.4, 5.0),
    ],
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


@pytest.mark.parametrize("ratio", [0.3, 1.0, 3.0])
def test_a_sine_loses_amplitude_as_a_low_pass_of_first_order_says(ratio: float) -> None:
    cutoff_hz, depth, duration_s = 100.0, 0.2, 0.5
    effects = SensorEffects(illuminance_lux=1000.0, cutoff_hz_per_lux=30.0, cutoff_max_hz=cutoff_hz)
    hz = ratio * cutoff_hz
    times_s = np.linspace(0.0, duration_s, int(400 * hz * duration_s))
    light = 0.5 * (1.0 + depth * np.sin(2 * np.pi * hz * times_s))
    config = SensorConfig(threshold_on=0.005, threshold_off=0.005)
    events = events_of(light[:, None, None], times_s, effects, config)
    settled = events[events["t"] > 5e6 / (2 * np.pi * cutoff_hz)]
    level = np.cumsum(np.where(settled["p"] == 1, 0.005, -0.005))
    # Log of 1 + a over 1 - a is the swing; it is seen to a threshold at either end.
    amplitude = np.tanh((level.max() - level.min() + 0.005) / 2)
    assert amplitude / depth == pytest.approx(1 / np.hypot(1, ratio), rel=0.05)


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


def test_a_jitter_alone_is_symmetric() -> None:
    video, times_s = stepping(0.2, 0.3, 1.0, 2.0, SHAPE)
    events = events_of(video, times_s, SensorEffects(jitter_s=50e-6))
    assert (events["t"] - 1e6).mean() == pytest.approx(0.0, abs=5 * 50 / 3000**0.5)


@pytest.mark.parametrize("dead_s", [0.002, 0.01])
def test_no_two_events_of_a_pixel_within_the_dead_time(dead_s: float) -> None:
    preset = SENSOR_PRESETS["davis346"]
    effects = replace(preset.effects, jitter_s=0.0, jitter_lux_s=0.0, latency_lux_s=0.0)
    config = replace(preset.sensor, refractory_s=dead_s)
    video, times_s = smooth_video(150, 20, 30), 1e-3 * np.arange(150)
    events = events_of(video, times_s, effects, config)
    by_pixel = events[np.lexsort((events["t"], events["x"], events["y"]))]
    same = (np.diff(by_pixel["x"]) == 0) & (np.diff(by_pixel["y"]) == 0)
    gaps_us = np.diff(by_pixel["t"])[same]
    assert len(gaps_us) > 1000
    assert gaps_us.min() >= round(dead_s * 1e6)


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


@pytest.mark.parametrize(("depth", "steps"), [(0.1, 0), (0.2, 1), (0.3, 2)])
def test_flicker_makes_as_many_events_as_its_swing_has_thresholds(depth: float, steps: int) -> None:
    effects = SensorEffects(flicker_depth=depth)
    events = events_of(np.full((2, 10, 10), 0.5), np.array([0.0, 2.0]), effects)
    swing = np.log((1 + depth) / (1 - depth))
    assert steps == np.floor(swing / 0.25)
    late = events[events["t"] >= 1_000_000]
    assert len(late) == 100 * 100 * 2 * steps
    if steps:
        binned = np.histogram(late["t"], bins=10_000, range=(1e6, 2e6))[0]
        spectrum = np.abs(np.fft.rfft(binned))[1:1000]
        assert (np.argmax(spectrum) + 1) % 100 == 0  # lines at 100 Hz and its multiples


@pytest.mark.parametrize("cutoff_hz", [1e6, 50.0])
def test_flicker_is_what_light_that_swings_would_be(cutoff_hz: float) -> None:
    depth, hz = 0.4, 100.0
    filtered = SensorEffects(
        cutoff_hz_per_lux=1e9, cutoff_min_hz=cutoff_hz, cutoff_max_hz=cutoff_hz
    )
    times_s = np.linspace(0.0, 0.3, 30_001)
    # The pixel starts in the middle of all, as if it had followed the lamps for long.
    gain = 1 / np.hypot(1, hz / cutoff_hz)
    lag = np.arctan(hz / cutoff_hz)
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
    events = events_of(
        np.full((2, *SHAPE), 0.5), np.array([0.0, 5.0]), SensorEffects(flicker_depth=0.05), config
    )
    assert (events["p"] == 1).all()
    # A crest lifts the signal by 0.05 of the 0.25 that leak away in half a second, and the level
    # memorised there is as much higher: the rate stays.
    assert len(events) / 3000 / 5.0 == pytest.approx(2.0, rel=0.05)
    phases = np.exp(1j * (2 * np.pi * 100.0 * 1e-6 * events["t"] + FLICKER_RAD))
    assert np.angle(phases.mean()) == pytest.approx(0.0, abs=0.5)  # crests, a little before
