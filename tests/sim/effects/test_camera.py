"""Lens and frames; configurations and presets; what a seed draws; recordings with effects."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from experiments.lab.provenance import plain
from sim.effects.camera import CameraEffects, blurred_crops, blurred_image, point_spread
from sim.effects.config import SENSOR_PRESETS, SensorEffects, sensor_preset
from sim.errors import SimError
from sim.recorded import Recording
from sim.recording import SimConfig, simulate
from sim.render.config import RenderConfig
from sim.render.renderer import Crops
from sim.scene.trajectory import SplineConfig
from sim.sensor.events import SensorConfig
from sim.sensor.frames import FrameConfig, FrameExposer, frame_times_us
from tests.sim.sensor.videos import smooth_video

SHORT = SimConfig(
    spline=SplineConfig(0.4), frames=FrameConfig(25.0), render=RenderConfig(check=False)
)


class Kept(list[NDArray[np.uint8]]):
    """Keeps copies of the frames it is given."""

    def __setitem__(self, k: int, image: NDArray[np.uint8], /) -> None:  # type: ignore[override]
        self.append(image.copy())


def camera_of(effects: SensorEffects, frames: FrameConfig, index: int = 0, seed: int = 0,
              image: NDArray[np.float32] | None = None) -> CameraEffects:  # fmt: skip
    grey = np.full((200, 300), 0.5, np.float32) if image is None else image
    return CameraEffects(effects, SensorConfig(), frames, grey, seed, index)


@pytest.mark.parametrize("blur_px", [0.3, 0.5, 1.5])
def test_a_point_is_spread_by_the_blur(blur_px: float) -> None:
    weights = point_spread(blur_px)
    at = np.arange(len(weights)) - len(weights) // 2
    # What lies beyond four deviations, and so two whole pixels of 0.5 px, is cut off.
    assert (weights * at**2).sum() == pytest.approx(blur_px**2, rel=0.02)
    point = np.zeros((41, 51), np.float32)
    point[20, 25] = 1.0
    image = blurred_image(point, blur_px)
    assert image.sum() == pytest.approx(1.0, abs=1e-6)
    np.testing.assert_allclose(image.sum(axis=1)[20 + at[::-1]], weights, atol=1e-6)


def test_crops_are_blurred_as_the_whole_image_is() -> None:
    wall = smooth_video(1, 40, 50)[0]
    image = wall.copy()
    image[12:20, 15:30] = 0.9
    blurred = blurred_image(wall, 0.8)
    crops = Crops(np.zeros(1), np.array([14]), np.array([11]), image[None, 11:22, 14:33].copy())
    result = blurred_crops(crops, 0.8, wall, blurred)
    whole = blurred.copy()
    x0, y0 = result.x0_px[0], result.y0_px[0]
    height, width = result.luminance.shape[1:]
    whole[y0 : y0 + height, x0 : x0 + width] = result.luminance[0]
    np.testing.assert_allclose(whole, blurred_image(image, 0.8), atol=2e-6)  # single precision


def test_frames_have_noise_that_grows_with_the_light() -> None:
    effects = SensorEffects(frame_read_noise=0.008, frame_full_well_e=2000.0)
    frames, camera = Kept(), camera_of(effects, FrameConfig())
    images = camera.images(frames)
    for k, level in enumerate((0, 64, 128, 192)):
        images[k] = np.full((200, 300), level, np.uint8)
    for level, frame in zip((64, 128, 192), frames[1:], strict=True):
        expected = 255.0 * np.sqrt(0.008**2 + level / 255.0 / 2000.0)
        # 60,000 pixels; rounding to whole levels adds a twelfth.
        assert frame.std() == pytest.approx(np.hypot(expected, 12**-0.5), rel=0.03)
        assert frame.mean() == pytest.approx(level, abs=0.1)
    assert frames[0].min() == 0  # nothing is darker than black


def test_lamps_light_frames_as_their_exposures_catch_them() -> None:
    effects = SensorEffects(flicker_depth=0.3)
    config = FrameConfig(rate_hz=40.0, exposure_s=0.002)
    frames, camera = Kept(), camera_of(effects, config)
    images = camera.images(frames)
    for k in range(40):
        images[k] = np.full((200, 300), 100, np.uint8)
    times_s = np.arange(40) / 40.0 + np.linspace(0.0, 0.002, 101)[:, None]
    light = 1.0 + 0.3 * np.cos(2 * np.pi * 100.0 * times_s + camera.flicker_rad)
    expected = 100.0 * light.mean(axis=0)
    np.testing.assert_allclose([frame.mean() for frame in frames], expected, atol=0.6)  # levels


def test_phases_of_frames_differ_between_cameras() -> None:
    effects = SensorEffects(frame_phase_spread=1.0)
    config = FrameConfig(rate_hz=25.0)
    starts_s = np.array(
        [[camera_of(effects, config, i, seed).frame_start_s for i in (0, 1)] for seed in range(200)]
    )
    # Evenly over the period of 40 ms: 200 draws, of deviation 11.5 ms, for each camera.
    assert starts_s.min() >= 0.0
    assert starts_s.max() < 0.04
    np.testing.assert_allclose(starts_s.mean(axis=0), 0.02, atol=5 * 0.0115 / 200**0.5)
    assert abs(np.corrcoef(starts_s.T)[0, 1]) < 0.3


def test_a_frame_that_starts_late_shows_the_light_of_its_stamp() -> None:
    config, start_s = FrameConfig(rate_hz=20.0, exposure_s=0.01), 0.0123
    times_us = frame_times_us(config, 1.0, start_s)
    frames = Kept()
    dark = np.zeros((2, 3), np.float32)
    exposer = FrameExposer(config, dark, len(times_us), frames, start_s)
    times_s = np.linspace(0.0, 1.0, 101)
    zeros = np.zeros(101, np.int64)
    ramp = np.broadcast_to(times_s[:, None, None], (101, 2, 3)).astype(np.float32)
    exposer.feed(times_s, zeros, zeros, np.ascontiguousarray(ramp))
    exposer.finish()
    assert len(frames) == len(times_us) == 20
    shown = np.array([frame[0, 0] for frame in frames]) / 255.0
    np.testing.assert_allclose(shown, 1e-6 * times_us, atol=0.6 / 255)  # whole levels


@pytest.mark.parametrize("name", vars(SensorEffects()))
@pytest.mark.parametrize("value", [-0.1, float("nan"), float("inf")])
def test_effects_are_not_negative(name: str, value: float) -> None:
    with pytest.raises(SimError, match=f"effects: {name} must be 0 or a positive number"):
        SensorEffects(**{name: value})


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"illuminance_lux": 0.0}, "illuminance_lux must be a positive number"),
        ({"cutoff_max_hz": 0.0}, "cutoff_max_hz must be a positive number"),
        ({"cutoff_min_hz": 9e3}, "cutoff_min_hz must be at most cutoff_max_hz"),
        ({"flicker_depth": 1.0}, "flicker_depth must be less than 1"),
        ({"flicker_hz": 0.0}, "flicker_hz must be a positive number"),
        ({"frame_phase_spread": 1.5}, "frame_phase_spread is a share"),
        ({"readout_queue": 0}, "readout_queue must be 1 or more"),
    ],
)
def test_impossible_effects_are_refused(wrong: dict[str, float], message: str) -> None:
    with pytest.raises(SimError, match=message):
        SensorEffects(**wrong)  # type: ignore[arg-type]


def test_an_unknown_preset_is_refused() -> None:
    with pytest.raises(SimError, match=r"one of davis346, davis346-dim, .* got 'davis'"):
        sensor_preset("davis")


def test_camera_2_may_see_another_light() -> None:
    effects = SensorEffects(illuminance_lux=100.0, camera2_light=0.2)
    assert effects.of_camera(0).illuminance_lux == 100.0
    assert effects.of_camera(1).illuminance_lux == 20.0


def test_a_configuration_without_effects_is_written_as_before() -> None:
    assert "effects" not in plain(SimConfig())
    acting = plain(SimConfig(effects=SensorEffects(blur_px=0.5)))["effects"]
    assert acting["blur_px"] == 0.5
    assert "scan_s" not in acting  # which is newer than results that state their configuration
    assert plain(SensorEffects(scan_s=1e-3))["scan_s"] == 1e-3


def recorded(effects: SensorEffects, seed: int = 0) -> Recording:
    return simulate(replace(SHORT, effects=effects), seed)


def test_an_effect_leaves_what_is_not_its_own() -> None:
    """Sensors draw from streams of their own: less light in camera 2 is none in camera 1."""
    effects = SensorEffects(illuminance_lux=50.0, cutoff_hz_per_lux=30.0)
    one, two = recorded(effects), recorded(replace(effects, camera2_light=0.1))
    np.testing.assert_array_equal(one.cameras[0].events, two.cameras[0].events)
    assert len(one.cameras[1].events) > len(two.cameras[1].events)
    with_gaps = recorded(replace(effects, frame_gap_s=0.01))
    assert np.isin(with_gaps.cameras[0].events, one.cameras[0].events).all()
    assert len(with_gaps.cameras[0].events) < len(one.cameras[0].events)


def test_one_seed_one_recording() -> None:
    preset = SENSOR_PRESETS["davis346-dim"]
    config = replace(SHORT, sensor=preset.sensor, effects=preset.effects)
    one, again, other = simulate(config, 1), simulate(config, 1), simulate(config, 2)
    for a, b, c in zip(one.cameras, again.cameras, other.cameras, strict=True):
        np.testing.assert_array_equal(a.events, b.events)
        np.testing.assert_array_equal(a.frames.images, b.frames.images)
        np.testing.assert_array_equal(a.frames.times_us, b.frames.times_us)
        assert (np.diff(a.events["t"]) >= 0).all()
        assert len(a.events) != len(c.events) or (a.events != c.events).any()
        assert len(a.events) > 500


def test_the_page_names_every_effect_and_preset() -> None:
    page = (Path(__file__).parents[3] / "docs" / "sensor.md").read_text(encoding="utf-8")
    shared = ("illuminance_lux", "camera2_light")
    missing = [name for name in (*vars(SensorEffects()), *SENSOR_PRESETS) if f"`{name}`" not in page
               and not (name in shared and name in page)]  # fmt: skip
    assert not missing
