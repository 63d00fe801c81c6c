"""Networks of cameras: their flights and tracks, and the errors of their solutions."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from experiments.lab.recorded import FlightTruth
from experiments.studies import network
from experiments.studies.network import GrowthCell
from sim.scene.rig import kalibr_yaml
from ssac.clock import Clock
from ssac.files.rigs import load_rig
from ssac.files.track_files import load_track
from ssac.network.tum import Path as SpacePath
from tests.experiments.reported import true_flight


def test_true_tracks_are_solved_and_errors_are_as_stated(tmp_path: Path) -> None:
    config = network.FOUR_CAMERAS
    scene = config.scene(5)
    (tmp_path / "rig.yaml").write_text(kalibr_yaml(scene.rig, with_extrinsics=False))
    times_s = np.arange(0.0, config.spline.duration_s, 0.005)
    flown = network.Flown(tmp_path, true_flight(scene, times_s, Clock()))
    cells = [cell for cell in network.cells(1) if cell.kind == network.TRUE_TRACKS]
    first, *others = (network.camera_row(cell, flown) for cell in cells)
    assert len(flown.found) == 1  # cells of a kind share one solution
    for row in others:
        assert row.status == "ok", row.reason
        # Points are interpolated over 10 ms and rounded to 1e-4 px; about 1e-3 px is stated.
        assert row.t_d_error_ms < 0.1
        assert row.r_error_deg < 0.05
        for name in ("t_d_normalised", "skew_normalised", "r_mahalanobis", "t_mahalanobis"):
            # Exact tracks leave errors far below their stated deviations, and never above.
            assert 0.0 < abs(getattr(row, name)) < 1.0, name
    assert first.path_rmse_mm < 1.0
    assert first.path_rmse_mm <= first.path_max_mm
    assert first.path_point_rmse_mm <= first.path_rmse_mm * 1.001
    assert 0.9 < first.path_seen < 1.01  # at most a step more than the flight
    assert first.path_held > 0.5


def test_a_path_of_another_point_of_the_body_is_off_by_its_lever_arm_alone() -> None:
    rng, times_s = np.random.default_rng(0), np.arange(0.0, 4.0, 0.01)
    true_m = np.column_stack([np.sin(times_s), np.cos(1.7 * times_s), np.sin(2.3 * times_s)])
    turns = Rotation.from_euler("zy", np.column_stack([2.0 * times_s, np.sin(3.0 * times_s)]))
    unused = (), (), np.eye(3), np.zeros(3), 1.0, Clock()
    truth = FlightTruth(times_s, true_m, turns.as_quat(), *unused)
    frame, arm_m = Rotation.from_rotvec(rng.normal(size=3)), np.array([0.02, -0.01, 0.03])
    seen = frame.apply(true_m + turns.apply(arm_m)) / 3.0 + [1.0, 2.0, 3.0]
    # The alternating rounds converge linearly.
    assert network.path_off_best_point_m(SpacePath(times_s, seen), true_m, truth) < 1e-4
    noisy = seen + rng.normal(0.0, 0.01, seen.shape)  # 30 mm in metres
    off_m = network.path_off_best_point_m(SpacePath(times_s, noisy), true_m, truth)
    assert off_m == pytest.approx(0.03 * np.sqrt(3.0), rel=0.1)  # 1200 numbers: 2 %, three times


def test_tracks_of_long_flights_are_of_one_path_and_of_their_clocks(tmp_path: Path) -> None:
    files, clocks = network.write_tracks(tmp_path, 5.0)
    assert load_rig(tmp_path / "rig.yaml", (1, len(files))).cam1.readout_s == 0.0
    for file, clock in zip(files, clocks, strict=True):
        track = load_track(file)
        times_s = clock.cam1_from_cam2(track.times_s)
        assert times_s[0] < 1.1 / network.FRAMES_HZ
        assert np.median(np.diff(times_s)) == pytest.approx(1.0 / network.FRAMES_HZ, rel=1e-3)
        bends_px = np.diff(track.points_px, 3, axis=0)
        # Third differences of white noise have 20 times its variance; the path bends far less.
        assert np.std(bends_px) == pytest.approx(np.sqrt(20.0) * network.NOISE_PX, rel=0.1)


def test_a_flight_before_many_cameras_is_solved_and_timed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(network, "N_FRAME_CAMERAS", 4)  # six pairs, not 28
    row = network.growth_row(GrowthCell(20.0), None)
    assert row.status == "ok", row.reason
    assert 0.0 < row.network_s < row.wall_s
    # Four cameras state 0.2 ms and some mm for 20 s. The limits are five times as much or more.
    assert row.t_d_error_ms < 2.0
    assert row.path_rmse_m < 0.05
    (study,) = network.GROWTH
    assert set(study.runs.columns) <= {*GrowthCell(20.0).columns, *vars(row)}
