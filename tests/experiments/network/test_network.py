"""What networks of cameras are measured on, and what is made of the rows."""

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from experiments.lab.cache import recording_key
from experiments.lab.files import read_table, save_csv
from experiments.lab.study import check_runs
from experiments.network.cameras import ANGLE_DEG, N_CAMERAS, FourCameras, Truth
from experiments.network.four import LEVEL, camera_cells, camera_table, four_cameras
from experiments.network.long_flights import FRAMES_HZ, NOISE_PX, network_growth, write_tracks
from experiments.network.measure import CameraRow, path_off_best_point_m
from sim.recording import SimConfig
from ssac.files.rigs import load_rig
from ssac.files.track_files import load_track
from ssac.network.tum import Path as SpacePath


def test_the_cameras_are_60_deg_apart_and_the_first_two_those_of_two_cameras() -> None:
    rig = FourCameras().scene(0).rig
    ahead = np.array([camera.T_C_W[2, :3] for camera in rig.cameras])
    cosines = np.sum(ahead[1:] * ahead[:-1], axis=1)
    assert np.rad2deg(np.arccos(cosines)) == pytest.approx([ANGLE_DEG] * (N_CAMERAS - 1))
    two = SimConfig(angle_deg=ANGLE_DEG).scene(0).rig
    for camera, other in zip(rig.cameras, two.cameras, strict=False):
        np.testing.assert_allclose(camera.T_C_W, other.T_C_W, atol=1e-12)  # rounding
    assert recording_key(FourCameras(), 0) != recording_key(SimConfig(angle_deg=ANGLE_DEG), 0)


def test_a_path_of_another_point_of_the_body_is_off_by_its_lever_arm_alone() -> None:
    rng = np.random.default_rng(0)
    times_s = np.arange(0.0, 4.0, 0.01)
    true_m = np.column_stack([np.sin(times_s), np.cos(1.7 * times_s), np.sin(2.3 * times_s)])
    turns = Rotation.from_euler("zy", np.column_stack([2.0 * times_s, np.sin(3.0 * times_s)]))
    truth = Truth(times_s, true_m, turns.as_quat(), [], [])
    frame, arm_m = Rotation.from_rotvec(rng.normal(size=3)), np.array([0.02, -0.01, 0.03])
    seen = frame.apply(true_m + turns.apply(arm_m)) / 3.0 + [1.0, 2.0, 3.0]
    # The rounds in turn converge to it, by some factor each.
    assert path_off_best_point_m(SpacePath(times_s, seen), true_m, truth) < 1e-4
    noisy = seen + rng.normal(0.0, 0.01, seen.shape)  # 30 mm in metres
    off_m = path_off_best_point_m(SpacePath(times_s, noisy), true_m, truth)
    assert off_m == pytest.approx(0.03 * np.sqrt(3.0), rel=0.1)  # of 1200 numbers: 2 %, thrice


def test_the_table_counts_what_intervals_hold(tmp_path) -> None:
    cells = camera_cells(2)
    rows = []
    for cell in cells:
        is_off = cell.flight == 1 and cell.camera == 2
        row = CameraRow(
            "ok",
            t_d_error_ms=float(cell.camera),
            t_d_normalised=2.5 if is_off else 0.5,
            skew_normalised=0.1,
            r_mahalanobis=2.5,
            t_mahalanobis=2.5,
        )
        rows.append({**cell.columns, **vars(row)})
    runs = pd.DataFrame(rows)
    runs.insert(0, "cell", range(len(runs)))
    save_csv(tmp_path / "runs.csv", runs)
    runs = read_table((tmp_path / "runs.csv").read_text())
    check_runs(four_cameras(2), runs)
    table = camera_table(runs)
    assert list(table["told"]) == [6, 6]  # the first camera is the reference
    assert list(table["t_d_held"]) == [5, 5]
    # 2.5 deviations are within the region of 95 % of three numbers, not of two.
    assert list(table["r_held"]) == [6, 6]
    assert list(table["t_held"]) == [0, 0]
    assert table["t_d_error_ms_most"].max() == N_CAMERAS
    assert 0.0 < LEVEL < 1.0


def test_tracks_of_long_flights_are_of_one_path_and_of_their_clocks(tmp_path) -> None:
    files, clocks = write_tracks(tmp_path, 5.0)
    rig = load_rig(tmp_path / "rig.yaml", (1, len(files)))
    assert rig.cam1.readout_s == 0.0
    for file, clock in zip(files, clocks, strict=True):
        track = load_track(file)
        times_s = clock.cam1_from_cam2(track.times_s)
        assert times_s[0] < 1.1 / FRAMES_HZ
        assert np.median(np.diff(times_s)) == pytest.approx(1.0 / FRAMES_HZ, rel=1e-3)
        bends_px = np.diff(track.points_px, 3, axis=0)
        # Third differences of white noise have 20 times its variance; the path bends far less.
        assert np.std(bends_px) == pytest.approx(np.sqrt(20.0) * NOISE_PX, rel=0.1)


def test_a_flight_that_cannot_be_solved_is_a_row_that_says_so() -> None:
    said = []
    table = network_growth((-1.0,), said.append)
    assert len(said) == 1
    assert table["status"][0].startswith("not measured")
