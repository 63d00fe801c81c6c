"""The outdoor twin and its study: set-up, true tracks, one short flight and its tables."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from experiments.lab.recorded import FlightTruth
from experiments.lab.results import Results
from experiments.studies import outdoor
from experiments.studies.outdoor import KINDS, OutdoorCell
from ssac.clock import Clock
from tests.experiments.command import run
from tests.experiments.reported import true_flight

(STUDY,) = outdoor.STUDIES


def test_what_is_true_is_found_within_its_deviations(tmp_path, truth, monkeypatch) -> None:
    monkeypatch.setattr(outdoor, "truths_of", lambda folders: (truth,))
    row = outdoor.outdoor_row(OutdoorCell(0, "all_true", DURATION_S), (tmp_path,))
    assert row.status == "ok", row.reason
    # Tracks are exact to the file's 1e-4 px, but points are interpolated over 20 ms.
    assert row.t_d_error_ms < 0.1
    assert row.skew_error_ppm < 2.0
    assert row.rmse_m < 0.04  # RTK's noise alone is 0.024 m
    assert row.icp_rmse_m < row.rmse_m
    assert row.scale_error_percent < 0.1
    assert row.coverage > 0.8


@pytest.mark.render
def test_a_short_flight_gives_both_tables(tmp_path: Path) -> None:
    folders = ("--out", tmp_path, "--cache", tmp_path / "cache")
    run("outdoor", "--flights", 1, "--duration", 10, "--workers", 1, *folders)
    recordings = (tmp_path / "cache" / "recordings").iterdir()
    assert sum(path.is_dir() for path in recordings) == 2  # one of them is of the third camera
    runs, means = (Results(tmp_path).table(name) for name in ("outdoor", "outdoor_oracle"))
    assert list(runs) == list(STUDY.runs.columns)
    assert list(runs["kind"]) == list(means["kind"]) == list(KINDS)
    # 10 s may be too little motion for the pose, which is then refused and says why.
    assert runs.loc[runs["rmse_m"].isna(), "reason"].notna().all()
    is_drawn = runs.set_index("kind")["rmse_m"].notna()["two_at_once"]
    assert (tmp_path / "outdoor.png").exists() == is_drawn


DURATION_S = 60.0
CONFIG = outdoor.outdoor_config(DURATION_S)
SCENE = CONFIG.scene(3)


@pytest.fixture(scope="module")
def truth() -> FlightTruth:
    times_s = np.linspace(0.0, DURATION_S, 200 * 60 + 1)
    return true_flight(SCENE, times_s, Clock(outdoor.T_D_S, outdoor.SKEW_PPM, DURATION_S / 2.0))


def test_the_set_up_is_the_papers(truth: FlightTruth) -> None:
    assert truth.baseline_m == pytest.approx(outdoor.BASELINE_M)
    for camera in SCENE.rig.cameras:
        centre = np.linalg.inv(camera.T_C_W)[:3, 3]
        distances_m = np.linalg.norm(truth.positions_m - centre, axis=1)
        # 15 to 60 m, but for the tails of a random flight.
        assert 10.0 < distances_m.min() < distances_m.max() < 65.0
    positions_px, last_px = np.array(truth.centres_px), np.array(CONFIG.resolution) - 1.0
    assert np.mean(np.all((positions_px >= 0.0) & (positions_px <= last_px), axis=(0, 2))) > 0.8


def test_rtk_is_the_antenna_on_a_clock_of_its_own(truth: FlightTruth) -> None:
    rtk = outdoor.rtk_of(truth, 0)
    assert np.diff(rtk.times_s) == pytest.approx(0.2, abs=0.0051)  # on the truth's 5 ms grid
    k = np.rint(200.0 * Clock(18.4, 5.0).cam1_from_cam2(rtk.times_s)).astype(int)
    arms_m = Rotation.from_quat(truth.quaternions[k]).apply(outdoor.LEVER_ARM_M)
    noise_m = rtk.positions_m - truth.positions_m[k] - arms_m
    np.testing.assert_allclose(np.std(noise_m, axis=0), (0.01, 0.01, 0.02), rtol=0.15)  # of 300
    assert not np.array_equal(outdoor.rtk_of(truth, 1).positions_m, rtk.positions_m)


def test_calibrations_err_each_by_its_own_and_are_the_same_again() -> None:
    cameras = outdoor.calibrated(CONFIG, 0)
    assert len({(one.focal_px, one.principal_point) for one in cameras}) == 3
    assert all(abs(one.focal_px / CONFIG.focal_px - 1.0) < 0.005 for one in cameras)  # 5 deviations
    assert outdoor.calibrated(CONFIG, 0) == cameras != outdoor.calibrated(CONFIG, 1)
