"""What the readout makes of events: gaps, a queue that stamps late and then drops."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from sim.effects.camera import CameraEffects, queued, without_gaps
from sim.effects.config import SensorEffects
from sim.errors import SimError
from sim.recording import SimConfig
from sim.sensor.events import SensorConfig
from sim.sensor.frames import FrameConfig
from sim.sensor.kernels import EVENT_DTYPE
from tests.sim.sensor.videos import rng

GREY = np.full((20, 30), 0.5, np.float32)


def events_at(times_us: NDArray[Any]) -> NDArray[Any]:
    events = np.zeros(len(times_us), EVENT_DTYPE)
    events["t"] = np.sort(times_us)
    events["x"] = np.arange(len(times_us)) % 346
    return events


def test_a_burst_is_stamped_late_and_then_dropped() -> None:
    burst = events_at(np.full(1000, 5000))
    delivered = queued(burst, readout_hz=1e5, queue=299)
    # One is read out, as many wait as may, the others are lost; 10 us each.
    np.testing.assert_array_equal(delivered["t"], 5000 + 10 * np.arange(300))
    np.testing.assert_array_equal(delivered["x"], burst["x"][:300])


def test_a_readout_that_is_not_busy_changes_nothing() -> None:
    events = events_at(20 * np.arange(1000))
    np.testing.assert_array_equal(queued(events, 1e5, 1), events)


@pytest.mark.parametrize("load", [0.5, 0.8])
def test_events_wait_as_in_a_queue_with_random_arrivals(load: float) -> None:
    """Mean wait of an M/D/1 queue: load / (2 (1 - load)) services (Pollaczek, Khinchin)."""
    service_us = 50.0
    arrivals_us = np.cumsum(rng(1).exponential(service_us / load, 400_000)).astype(np.int64)
    delivered = queued(events_at(arrivals_us), 1e6 / service_us, 10**6)
    wait_us = (delivered["t"] - arrivals_us).mean()
    # 400,000 arrivals, whose waits are correlated over 1 / (1 - load)^2 of them.
    assert wait_us == pytest.approx(service_us * load / (2 * (1 - load)), rel=0.03)
    assert (np.diff(delivered["t"]) >= service_us - 1).all()


@pytest.mark.parametrize("load", [1.25, 3.0])
def test_what_is_too_much_for_the_readout_is_dropped(load: float) -> None:
    arrivals_us = np.cumsum(rng(2).exponential(10.0 / load, 100_000)).astype(np.int64)
    delivered = queued(events_at(arrivals_us), 1e5, 50)
    assert len(delivered) / len(arrivals_us) == pytest.approx(1 / load, rel=0.02)
    # At most as many wait as may: the last of them is stamped so much after it came.
    came = np.searchsorted(arrivals_us, delivered["t"] - 50 * 10 - 1)
    assert (np.diff(delivered["t"]) >= 9).all()
    assert came[-1] > 0.99 * len(arrivals_us)


@pytest.mark.parametrize(("gap_s", "rate_hz"), [(0.005, 25.0), (0.025, 25.0), (0.01, 50.0)])
def test_frames_blind_the_events_while_they_are_read_out(gap_s: float, rate_hz: float) -> None:
    effects = SensorEffects(frame_gap_s=gap_s, frame_phase_spread=1.0)
    frames = FrameConfig(rate_hz=rate_hz, exposure_s=0.004)
    camera = CameraEffects(effects, SensorConfig(), frames, GREY, seed=3, index=1)
    events = events_at(rng(1).integers(0, 20_000_000, 200_000))
    left = camera.read_out(events, 20.0)
    assert 1 - len(left) / len(events) == pytest.approx(gap_s * rate_hz, rel=0.05)
    since_s = 1e-6 * left["t"] - camera.frame_start_s - 0.004
    assert (since_s % (1 / rate_hz))[since_s > 0.0].min() >= gap_s - 2e-6  # whole microseconds
    assert (since_s < 0.0).any()  # before the first frame there is nothing to be read out


def test_no_gap_without_frames() -> None:
    effects = SensorEffects(frame_gap_s=0.01)
    camera = CameraEffects(effects, SensorConfig(), FrameConfig(rate_hz=0.0), GREY, 0, 0)
    events = events_at(1000 * np.arange(1000))
    np.testing.assert_array_equal(camera.read_out(events, 1.0), events)
    np.testing.assert_array_equal(without_gaps(events, np.empty(0), 1e3), events)


@pytest.mark.parametrize("scan_s", [200e-6, 1e-3, 1 / 3000])
def test_events_of_a_sensor_that_is_scanned_bear_the_times_of_its_scans(scan_s: float) -> None:
    events = events_at(rng(3).integers(0, 900_000, 5000))
    camera = CameraEffects(SensorEffects(scan_s=scan_s), SensorConfig(), FrameConfig(), GREY, 0, 0)
    stamped = camera.read_out(events.copy(), 1.0)
    np.testing.assert_array_equal(stamped["x"], events["x"])  # none is lost or overtaken
    scans = 1e-6 * stamped["t"] / scan_s
    np.testing.assert_allclose(scans, np.rint(scans), atol=0.5e-6 / scan_s)  # whole microseconds
    waited_us = stamped["t"] - events["t"]
    assert waited_us.min() >= 0
    assert waited_us.max() <= np.ceil(1e6 * scan_s)
    # Evenly over a period, of 5000 draws.
    assert waited_us.mean() == pytest.approx(5e5 * scan_s, rel=5 / 8660**0.5 + 0.005)


def test_nothing_is_recorded_before_the_start_or_after_the_end() -> None:
    camera = CameraEffects(SensorEffects(jitter_s=1e-3), SensorConfig(), FrameConfig(), GREY, 0, 0)
    events = events_at(np.array([-3, 0, 7, 1_000_000, 1_000_001]))
    assert camera.read_out(events, 1.0)["t"].tolist() == [0, 7, 1_000_000]


def test_gaps_must_leave_events() -> None:
    with pytest.raises(SimError, match=r"frame_gap_s must be less than 1 / rate_hz .* 0.04 s"):
        SimConfig(frames=FrameConfig(25.0), effects=SensorEffects(frame_gap_s=0.04))
