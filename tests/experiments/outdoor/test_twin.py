"""The outdoor twin on true tracks, which takes no rendering: geometry, RTK, and what is found."""

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from experiments.outdoor.flights import (
    BASELINE_M,
    LEVER_ARM_M,
    SKEW_PPM,
    T_D_S,
    Truth,
    calibrated,
    outdoor_config,
    rtk_of,
    seed_of,
)
from experiments.outdoor.outdoor_command import oracle_table
from experiments.outdoor.twin import COLUMNS, twin_row
from sim.scene.rig import two_view_rig
from sim.scene.trajectory import random_spline
from ssac.clock import Clock

DURATION_S = 60.0
CONFIG = outdoor_config(DURATION_S)


@pytest.fixture(scope="module")
def rig():
    return two_view_rig(
        CONFIG.angle_deg, CONFIG.distance_m, CONFIG.focal_px, CONFIG.resolution,
        CONFIG.principal_point,
    )  # fmt: skip


@pytest.fixture(scope="module")
def truth(rig):
    trajectory = random_spline(CONFIG.spline, np.random.default_rng(3))
    times_s = np.linspace(0.0, DURATION_S, 200 * 60 + 1)
    poses = trajectory.poses(times_s)
    centres_px = [camera.project(poses[:, :3, 3]) for camera in rig.cameras]
    clock = Clock(T_D_S, SKEW_PPM, DURATION_S / 2.0)
    quaternions = Rotation.from_matrix(poses[:, :3, :3]).as_quat()
    return Truth(times_s, poses[:, :3, 3], quaternions, tuple(centres_px), *rig.extrinsics(), clock)


def test_the_set_up_is_the_papers(rig, truth):
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


def test_rtk_is_the_antenna_on_a_clock_of_its_own(truth):
    rtk = rtk_of(truth, 0)
    assert np.diff(rtk.times_s) == pytest.approx(0.2, abs=0.0051)  # to the truth's next 5 ms
    scene_s = Clock(18.4, 5.0).cam1_from_cam2(rtk.times_s)
    k = np.rint(200.0 * scene_s).astype(int)
    arms_m = Rotation.from_quat(truth.quaternions[k]).apply(LEVER_ARM_M)
    noise_m = rtk.positions_m - truth.positions_m[k] - arms_m
    np.testing.assert_allclose(np.std(noise_m, axis=0), (0.01, 0.01, 0.02), rtol=0.15)  # of 300
    assert not np.array_equal(rtk_of(truth, 1).positions_m, rtk.positions_m)


def test_a_calibration_errs_and_is_the_same_again():
    first, second, _ = calibrated(CONFIG, 0)
    assert first.focal_px != second.focal_px
    assert abs(first.focal_px / CONFIG.focal_px - 1.0) < 0.005  # five deviations
    assert calibrated(CONFIG, 0)[:2] == (first, second)


def test_what_is_true_is_found_and_errors_are_within_their_deviations(truth, tmp_path):
    row = twin_row(tmp_path, CONFIG, truth, 0, "all_true")
    assert row["status"] == "ok", row["reason"]
    # Tracks are exact to the file's 1e-4 px, but points are interpolated between 20 ms.
    assert row["t_d_error_ms"] < 0.1
    assert row["skew_error_ppm"] < 2.0
    assert row["rmse_m"] < 0.04  # RTK's noise alone is 0.024 m
    assert row["icp_rmse_m"] < row["rmse_m"]
    assert row["scale_error_percent"] < 0.1
    assert row["coverage"] > 0.8


def test_the_oracle_table_has_the_means_of_what_was_answered():
    rows = [dict.fromkeys(COLUMNS, 1.0) | {"kind": kind} for kind in ("a", "a", "b")]
    rows[0]["rmse_m"], rows[2]["rmse_m"] = 3.0, np.nan
    table = oracle_table(pd.DataFrame(rows, columns=COLUMNS)).set_index("kind")
    assert table.loc["a", "rmse_m"] == 2.0
    assert list(table.answered) == [2, 0]
    assert list(table["of"]) == [2, 1]


def test_flights_are_different():
    assert len({seed_of(k) for k in range(10)}) == 10
