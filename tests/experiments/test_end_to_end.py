"""Simulated recordings, noise and distortion included, through the estimators, against the truth.

Flights of 10 s, rendered coarsely. On such short ones the means of the windows stray by 0.5 px from
the image of a fixed point, the same way for seconds, which leaves errors of up to 0.6 ms, 0.8 deg
and 0.5 deg in these recordings (`ssac tables` measures them over many flights of 20 s); the
tolerances are twice that.
"""

from dataclasses import replace

import numpy as np
import pytest

from experiments.lab.bridge import observations, rig_of
from experiments.lab.score import angle_between_deg, rotation_angle_deg, score
from sim.recorded import Recording
from sim.recording import SimConfig, simulate
from sim.render.config import SamplingConfig
from sim.scene.trajectory import SplineConfig
from sim.sensor.events import PRESETS
from sim.sensor.frames import FrameConfig
from ssac import joint, joint_known, ssac, ssac_known
from ssac.config import Config
from ssac.pipeline.api import usable_events
from ssac.track.observation import Observation

pytestmark = pytest.mark.render

T_D_S, R_DEG, T_DEG = 1.2e-3, 1.6, 1.0

SHORT = SimConfig(
    t_d_s=0.05,
    spline=SplineConfig(duration_s=10.0),
    sampling=SamplingConfig(max_step_px=1.0),
    frames=FrameConfig(rate_hz=0.0),
    sensor=PRESETS["davis346"],
)
CLEAN = Config(denoise=False)  # the fixtures have done it


@pytest.fixture(scope="session", params=[30.0, 90.0, 150.0], ids="{:g}deg".format)
def flight(request):
    return denoised(simulate(replace(SHORT, angle_deg=request.param), seed=1))


@pytest.fixture(scope="session")
def flight_at_90():
    return denoised(simulate(SHORT, seed=2))


def denoised(recording: Recording):
    """The recording, and what both cameras recorded without noise events."""
    cameras = observations(recording)
    events = usable_events(*cameras, rig_of(recording), Config())
    return recording, [Observation(left) for left in events]


def shifted(camera: Observation, shift_s: float) -> Observation:
    events = camera.events.copy()
    events["t"] += round(shift_s * 1e6)
    return Observation(events)


def between(camera: Observation, start_s: float, end_s: float) -> Observation:
    t_us = camera.events["t"]
    return Observation(camera.events[(t_us >= start_s * 1e6) & (t_us < end_s * 1e6)])


def assert_close(estimate, recording, t_d_s):
    truth = recording.truth
    assert estimate.status == "ok", estimate.reason
    errors = score(estimate, t_d_s, truth.R, truth.t)
    assert errors.t_d_error_ms < 1e3 * T_D_S
    assert errors.r_error_deg < R_DEG
    assert errors.t_error_deg < T_DEG


@pytest.mark.parametrize("t_d_s", [0.005, 0.05, 0.5, -0.3])
def test_offset_and_pose(flight, t_d_s):
    recording, (cam1, cam2) = flight
    cam2 = shifted(cam2, t_d_s - recording.truth.t_d_s)
    for method in (ssac, joint):
        assert_close(method(cam1, cam2, rig_of(recording), CLEAN), recording, t_d_s)


@pytest.mark.parametrize("t_d_s", [0.05, -0.5])
def test_offset_with_known_extrinsics(flight, t_d_s):
    recording, (cam1, cam2) = flight
    cam2 = shifted(cam2, t_d_s - recording.truth.t_d_s)
    rig = rig_of(recording, with_extrinsics=True)
    for method in (ssac_known, joint_known):
        assert_close(method(cam1, cam2, rig, CLEAN), recording, t_d_s)


def test_swapped_cameras(flight):
    recording, (cam1, cam2) = flight
    rig = rig_of(recording)
    swapped = replace(rig, cam1=rig.cam2, cam2=rig.cam1)
    for method in (ssac, joint):
        there, back = method(cam1, cam2, rig, CLEAN), method(cam2, cam1, swapped, CLEAN)
        # Other sample times, and for `ssac` distances in the other image: the two differ by less
        # than the errors that either may have.
        assert back.t_d_s == pytest.approx(-there.t_d_s, abs=T_D_S)
        assert rotation_angle_deg(back.R @ there.R) < R_DEG
        assert angle_between_deg(back.t, -there.R.T @ there.t) < T_DEG


@pytest.mark.parametrize("t_d_s", [0.05, -0.3])
def test_recordings_of_unequal_length_and_start(flight_at_90, t_d_s):
    recording, (cam1, cam2) = flight_at_90
    cam2 = shifted(cam2, t_d_s - recording.truth.t_d_s)
    cam1, cam2 = between(cam1, 1.5, 20.0), between(cam2, 0.0, 8.5)  # 7 s in common
    for method in (ssac, joint):
        assert_close(method(cam1, cam2, rig_of(recording), CLEAN), recording, t_d_s)


def test_a_clock_that_shows_the_time_of_day(flight_at_90):
    recording, (cam1, cam2) = flight_at_90
    start_s = 1.7e9
    estimate = joint(shifted(cam1, start_s), shifted(cam2, start_s), rig_of(recording), CLEAN)
    assert_close(estimate, recording, recording.truth.t_d_s)


def test_events_as_recorded_are_denoised_on_the_way(flight_at_90):
    recording, (cam1, cam2) = flight_at_90
    raw = observations(recording)
    assert len(cam1.events) < len(raw[0].events)
    rig = rig_of(recording)
    whole, apart = joint(*raw, rig), joint(cam1, cam2, rig, CLEAN)
    assert whole.t_d_s == apart.t_d_s
    assert np.array_equal(whole.R, apart.R)


@pytest.mark.parametrize(
    ("model", "coefficients"),
    [("radtan", (-0.2, 0.05, 0.001, -0.001)), ("equidistant", (0.05, -0.02, 0.005, -0.001))],
)
def test_distortion(model, coefficients):
    config = replace(SHORT, distortion_model=model, distortion_coeffs=coefficients)
    recording, cameras = denoised(simulate(config, seed=1))
    rig = rig_of(recording)
    assert rig.cam1.distortion_model == model
    for method in (ssac, joint):
        assert_close(method(*cameras, rig, CLEAN), recording, config.t_d_s)
    # With the lens ignored the lines of the same pairs are curved: the test would notice.
    ideal = replace(rig.cam1, distortion_model="none", distortion_coeffs=())
    ignored = ssac(*cameras, replace(rig, cam1=ideal, cam2=ideal), CLEAN)
    corrected = ssac(*cameras, rig, CLEAN)
    assert ignored.d_avg_px > corrected.d_avg_px
