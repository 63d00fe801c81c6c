"""The outdoor twin's set-up, its RTK and its calibration."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from experiments.lab.recorded import FlightTruth
from experiments.worlds.outdoor import (
    BASELINE_M,
    LEVER_ARM_M,
    SKEW_PPM,
    T_D_S,
    calibrated,
    outdoor_config,
    rtk_of,
    seed_of,
)
from sim.scene.rig import Rig, two_view_rig
from sim.scene.trajectory import random_spline
from ssac.clock import Clock

DURATION_S = 60.0
CONFIG = outdoor_config(DURATION_S)


def outdoor_rig() -> Rig:
    return two_view_rig(
        CONFIG.angle_deg,
        distance_m=CONFIG.distance_m,
        focal_px=CONFIG.focal_px,
        resolution=CONFIG.resolution,
        principal_point=CONFIG.principal_point,
    )


def outdoor_truth() -> FlightTruth:
    """The truth of a flight, which takes no rendering."""
    rig = outdoor_rig()
    trajectory = random_spline(CONFIG.spline, np.random.default_rng(3))
    times_s = np.linspace(0.0, DURATION_S, 200 * 60 + 1)
    poses = trajectory.poses(times_s)
    centres_px = tuple(camera.project(poses[:, :3, 3]) for camera in rig.cameras)
    quaternions = Rotation.from_matrix(poses[:, :3, :3]).as_quat()
    clock = Clock(T_D_S, SKEW_PPM, DURATION_S / 2.0)
    return FlightTruth(
        times_s, poses[:, :3, 3], quaternions, centres_px,
        tuple(rig.relative_pose(0, k) for k in range(2)), *rig.extrinsics(), clock,
    )  # fmt: skip


@pytest.fixture(scope="module")
def truth() -> FlightTruth:
    return outdoor_truth()


def test_the_set_up_is_the_papers(truth: FlightTruth) -> None:
    rig = outdoor_rig()
    assert rig.extrinsics()[2] == pytest.approx(BASELINE_M)
    for camera in rig.cameras:
        centre = np.linalg.inv(camera.T_C_W)[:3, 3]
        distances_m = np.linalg.norm(truth.positions_m - centre, axis=1)
        assert distances_m.min() > 10.0  # 15 to 60 m, but for the tails of a random flight
        assert distances_m.max() < 65.0
    seen = [
        np.all((px >= 0.0) & (px <= np.array(CONFIG.resolution) - 1.0), axis=1)
        for px in truth.centres_px
    ]
    assert np.mean(seen[0] & seen[1]) > 0.8


def test_rtk_is_the_antenna_on_a_clock_of_its_own(truth: FlightTruth) -> None:
    rtk = rtk_of(truth, 0)
    assert np.diff(rtk.times_s) == pytest.approx(0.2, abs=0.0051)  # to the truth's next 5 ms
    scene_s = Clock(18.4, 5.0).cam1_from_cam2(rtk.times_s)
    k = np.rint(200.0 * scene_s).astype(int)
    arms_m = Rotation.from_quat(truth.quaternions[k]).apply(LEVER_ARM_M)
    noise_m = rtk.positions_m - truth.positions_m[k] - arms_m
    np.testing.assert_allclose(np.std(noise_m, axis=0), (0.01, 0.01, 0.02), rtol=0.15)  # of 300
    assert not np.array_equal(rtk_of(truth, 1).positions_m, rtk.positions_m)


def test_calibrations_err_each_by_its_own_and_are_the_same_again() -> None:
    cameras = calibrated(CONFIG, 0)
    assert len({(one.focal_px, one.principal_point) for one in cameras}) == 3
    for one in cameras:
        assert abs(one.focal_px / CONFIG.focal_px - 1.0) < 0.005  # five deviations
    assert calibrated(CONFIG, 0) == cameras
    assert len({seed_of(flight) for flight in range(10)}) == 10
