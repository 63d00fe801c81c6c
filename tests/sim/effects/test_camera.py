"""Tests a camera's lens, readout and frames, its presets and seeds, and recordings with effects."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from experiments.lab.provenance import plain
from sim.effects.camera import CameraEffects, blurred_crops, blurred_image, point_spread, queued
from sim.effects.config import SENSOR_PRESETS, SensorEffects
from sim.recording import SimConfig, simulate
from sim.render.renderer import Crops
from sim.scene.trajectory import SplineConfig
from sim.sensor.events import SensorConfig
from sim.sensor.frames import FrameConfig
from sim.sensor.kernels import EVENT_DTYPE
from tests.sim.scenes import QUICK, rng, smooth_video, whole_images


def camera_of(effects, frames=None, index=0, seed=0):
    grey = np.full((200, 300), 0.5, np.float32)
    return CameraEffects(effects, SensorConfig(), frames or FrameConfig(), grey, seed, index)


@pytest.mark.parametrize("blur_px", [0.3, 0.5, 1.5])
def test_a_point_is_spread_by_the_blur(blur_px):
    weights = point_spread(blur_px)
    at = np.arange(len(weights)) - len(weights) // 2
    # Light beyond four deviations is cut off, which is two whole pixels for a blur of 0.5 px.
    assert (weights * at**2).sum() == pytest.approx(blur_px**2, rel=0.02)
    point = np.zeros((41, 51), np.float32)
    point[20, 25] = 1.0
    image = blurred_image(point, blur_px)
    assert image.sum() == pytest.approx(1.0, abs=1e-6)
    np.testing.assert_allclose(image.sum(axis=1)[20 + at[::-1]], weights, atol=1e-6)


def test_crops_are_blurred_as_the_whole_image_is():
    wall = smooth_video(1, 40, 50)[0]
    image = wall.copy()
    image[12:20, 15:30] = 0.9
    blurred = blurred_image(wall, 0.8)
    crops = Crops(np.zeros(1), np.array([14]), np.array([11]), image[None, 11:22, 14:33].copy())
    result = blurred_crops(crops, 0.8, wall, blurred)
    (whole,) = whole_images([result], result.times_s, blurred)
    np.testing.assert_allclose(whole, blurred_image(image, 0.8), atol=2e-6)  # single precision


def test_frames_have_noise_that_grows_with_the_light():
    effects = SensorEffects(frame_read_noise=0.008, frame_full_well_e=2000.0)
    frames = []
    take = camera_of(effects).through_noise(lambda _, image: frames.append(image))
    for k, level in enumerate((0, 64, 128, 192)):
        take(k, np.full((200, 300), level, np.uint8))
    for level, frame in zip((64, 128, 192), frames[1:], strict=True):
        expected = 255.0 * np.sqrt(0.008**2 + level / 255.0 / 2000.0)
        # There are 60,000 pixels; rounding to whole levels adds a variance of 1/12.
        assert frame.std() == pytest.approx(np.hypot(expected, 12**-0.5), rel=0.03)
        assert frame.mean() == pytest.approx(level, abs=0.1)
    assert frames[0].min() == 0  # nothing is darker than black


def test_lamps_light_frames_as_their_exposures_catch_them():
    config = FrameConfig(rate_hz=40.0, exposure_s=0.002)
    camera, levels = camera_of(SensorEffects(flicker_depth=0.3), config), list[float]()
    take = camera.through_noise(lambda _, image: levels.append(image.mean()))
    for k in range(40):
        take(k, np.full((200, 300), 100, np.uint8))
    times_s = np.arange(40) / 40.0 + np.linspace(0.0, 0.002, 101)[:, None]
    light = 1.0 + 0.3 * np.cos(2 * np.pi * 100.0 * times_s + camera.flicker_rad)
    np.testing.assert_allclose(levels, 100.0 * light.mean(axis=0), atol=0.6)


def test_phases_of_frames_differ_between_cameras():
    effects = SensorEffects(frame_phase_spread=1.0)
    config = FrameConfig(rate_hz=25.0)
    starts_s = np.array(
        [[camera_of(effects, config, i, seed).frame_start_s for i in (0, 1)] for seed in range(200)]
    )
    # Phases are uniform over the period of 40 ms: 200 draws, of deviation 11.5 ms, per camera.
    assert 0.0 <= starts_s.min() <= starts_s.max() < 0.04
    np.testing.assert_allclose(starts_s.mean(axis=0), 0.02, atol=5 * 0.0115 / 200**0.5)
    assert abs(np.corrcoef(starts_s.T)[0, 1]) < 0.3


def test_a_configuration_without_effects_is_written_as_before():
    assert "effects" not in plain(SimConfig())
    acting = plain(SimConfig(effects=SensorEffects(blur_px=0.5)))["effects"]
    assert acting["blur_px"] == 0.5
    assert "scan_s" not in acting  # an effect that older results do not state
    assert plain(SensorEffects(scan_s=1e-3))["scan_s"] == 1e-3


def test_an_effect_leaves_what_is_not_its_own():
    """Each sensor draws from its own stream: less light in camera 2 does not affect camera 1."""
    effects = SensorEffects(illuminance_lux=50.0, cutoff_hz_per_lux=30.0)
    one, two, with_gaps = (
        simulate(replace(QUICK, spline=SplineConfig(0.4), effects=each), 0)
        for each in (
            effects, replace(effects, camera2_light=0.1), replace(effects, frame_gap_s=0.01)
        )
    )  # fmt: skip
    np.testing.assert_array_equal(one.cameras[0].events, two.cameras[0].events)
    assert len(one.cameras[1].events) > len(two.cameras[1].events)
    assert np.isin(with_gaps.cameras[0].events, one.cameras[0].events).all()
    assert len(with_gaps.cameras[0].events) < len(one.cameras[0].events)


def test_the_page_names_every_effect_and_preset():
    page = (Path(__file__).parents[3] / "docs" / "sensor.md").read_text(encoding="utf-8")
    names = (*vars(SensorEffects()), *SENSOR_PRESETS)
    assert not [name for name in names if f"`{name}`" not in page]


def events_at(times_us):
    events = np.zeros(len(times_us), EVENT_DTYPE)
    events["t"] = np.sort(times_us)
    events["x"] = np.arange(len(times_us)) % 346
    return events


def test_a_burst_is_stamped_late_and_then_dropped():
    burst = events_at(np.full(1000, 5000))
    delivered = queued(burst, readout_hz=1e5, queue=299)
    # One event is read out, 299 wait in the queue, the others are lost; a readout takes 10 us.
    np.testing.assert_array_equal(delivered["t"], 5000 + 10 * np.arange(300))
    np.testing.assert_array_equal(delivered["x"], burst["x"][:300])


@pytest.mark.parametrize("load", [0.5, 0.8])
def test_events_wait_as_in_a_queue_with_random_arrivals(load):
    """Mean wait of an M/D/1 queue: load / (2 (1 - load)) services (Pollaczek, Khinchin)."""
    service_us = 50.0
    arrivals_us = np.cumsum(rng(1).exponential(service_us / load, 400_000)).astype(np.int64)
    delivered = queued(events_at(arrivals_us), 1e6 / service_us, 10**6)
    wait_us = (delivered["t"] - arrivals_us).mean()
    # 400,000 arrivals, whose waits are correlated over 1 / (1 - load)^2 of them.
    assert wait_us == pytest.approx(service_us * load / (2 * (1 - load)), rel=0.03)
    assert (np.diff(delivered["t"]) >= service_us - 1).all()


@pytest.mark.parametrize(("gap_s", "rate_hz"), [(0.005, 25.0), (0.025, 25.0), (0.01, 50.0)])
def test_frames_blind_the_events_while_they_are_read_out(gap_s, rate_hz):
    effects = SensorEffects(frame_gap_s=gap_s, frame_phase_spread=1.0)
    camera = camera_of(effects, FrameConfig(rate_hz, exposure_s=0.004), index=1, seed=3)
    events = events_at(rng(1).integers(0, 20_000_000, 200_000))
    left = camera.read_out(events, 20.0)
    assert 1 - len(left) / len(events) == pytest.approx(gap_s * rate_hz, rel=0.05)
    since_s = 1e-6 * left["t"] - camera.frame_start_s - 0.004
    assert (since_s % (1 / rate_hz))[since_s > 0.0].min() >= gap_s - 2e-6  # whole microseconds
    assert (since_s < 0.0).any()  # before the first frame there is nothing to be read out


@pytest.mark.parametrize("scan_s", [200e-6, 1e-3, 1 / 3000])
def test_events_of_a_sensor_that_is_scanned_bear_the_times_of_its_scans(scan_s):
    events = events_at(rng(3).integers(0, 900_000, 5000))
    stamped = camera_of(SensorEffects(scan_s=scan_s)).read_out(events.copy(), 1.0)
    np.testing.assert_array_equal(stamped["x"], events["x"])  # none is lost or overtaken
    scans = 1e-6 * stamped["t"] / scan_s
    np.testing.assert_allclose(scans, np.rint(scans), atol=0.5e-6 / scan_s)  # whole microseconds
    waited_us = stamped["t"] - events["t"]
    assert 0 <= waited_us.min() <= waited_us.max() <= np.ceil(1e6 * scan_s)
    # The 5000 waits are uniform over a period.
    assert waited_us.mean() == pytest.approx(5e5 * scan_s, rel=5 / 8660**0.5 + 0.005)


def test_nothing_is_recorded_before_the_start_or_after_the_end():
    camera = camera_of(SensorEffects(jitter_s=1e-3))
    events = events_at(np.array([-3, 0, 7, 1_000_000, 1_000_001]))
    assert camera.read_out(events, 1.0)["t"].tolist() == [0, 7, 1_000_000]
