"""Clouds that drift make the events that their light says, and no others."""

import numpy as np
import pytest

from sim.disturb import (
    CLOUD_LUMINANCE,
    SKY_LUMINANCE,
    SPOTS_PX,
    View,
    clouds,
    cloudy_sky,
)
from sim.sensor.events import SensorConfig

VIEW = View(120, 90, 2.0)


def test_a_sky_has_blue_and_white_and_is_one_again_beyond_its_border() -> None:
    sky = cloudy_sky(VIEW, np.random.default_rng(0))
    assert sky.shape == (256, 256)
    low, high = (np.float32(light) for light in (SKY_LUMINANCE, CLOUD_LUMINANCE))
    assert sky.min() >= low * (1.0 - 1e-6)  # single precision
    assert sky.max() <= high * (1.0 + 1e-6)
    clear, white = np.mean(sky < 1.01 * low), np.mean(sky > 0.99 * high)
    assert min(clear, white) > 0.05
    # A step over the border is one like any other.
    for steps in (np.diff(sky, axis=0), np.diff(sky, axis=1)):
        across = sky[0] - sky[-1] if steps.shape[0] < 256 else sky[:, 0] - sky[:, -1]
        # Unrelated borders differ by some seven times as much; edges of clouds lie unevenly.
        assert np.sqrt(np.mean(across**2)) < 3.0 * np.sqrt(np.mean(steps**2))


def test_large_spots_are_stronger_than_small_ones() -> None:
    sky = np.log(cloudy_sky(View(346, 260, 1.0), np.random.default_rng(3)))
    power = np.abs(np.fft.rfft2(sky - sky.mean())) ** 2
    waves = np.hypot(np.fft.fftfreq(len(sky))[:, None], np.fft.rfftfreq(len(sky)))
    coarse = power[(waves > 1.0 / SPOTS_PX) & (waves < 2.0 / SPOTS_PX)].mean()
    fine = power[(waves > 8.0 / SPOTS_PX) & (waves < 16.0 / SPOTS_PX)].mean()
    # Kolmogorov's 8^(-11/3) is 1/2048; where clear and white cut it off, edges weaken the fall.
    assert 1 / 4096 < fine / coarse < 1 / 128


@pytest.mark.parametrize("drift_px_s", [3.0, 12.0])
def test_events_add_up_to_the_change_of_light(drift_px_s: float) -> None:
    events = clouds(VIEW, drift_px_s, np.random.default_rng(5))
    change = np.zeros((VIEW.height, VIEW.width))
    sign = 2.0 * events["p"].astype(float) - 1.0
    np.add.at(change, (events["y"], events["x"]), SensorConfig().threshold_on * sign)
    # From blue to white at most, and what a pixel remembers may be a threshold beside either.
    most = np.log(CLOUD_LUMINANCE / SKY_LUMINANCE) + 2.0 * SensorConfig().threshold_on
    assert np.abs(change).max() <= most
    assert np.abs(change).max() > SensorConfig().threshold_on


def test_clouds_twice_as_fast_make_twice_the_events_all_along() -> None:
    slow, fast = (clouds(VIEW, speed, np.random.default_rng(7)) for speed in (4.0, 8.0))
    # The same sky over half the way; what comes into view later differs from place to place.
    first = fast[fast["t"] < 1e6]
    assert len(first) == pytest.approx(len(slow), rel=0.02)  # frames lie elsewhere
    # No burst at the start: pixels remember what they saw before.
    assert np.mean(slow["t"] < 2e5) == pytest.approx(0.1, abs=0.03)
