"""What `ssac compare` says of paths whose difference is known."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ssac.clock import Clock
from ssac.network.comparison import compare
from ssac.network.tum import Path, write_path
from tests.ssac.command import read_json, run
from tests.ssac.network.test_align import FRAME, flight

CLOCK = Clock(31.4, 20.0, 50.0)
NOISE_M = 0.03
RATE_HZ = 20.0


def _truth(duration_s=100.0):
    times_s = np.arange(0.0, duration_s, 0.2)
    return Path(CLOCK.cam2_from_cam1(times_s), flight(duration_s, 7)(times_s))


def _estimate(noise_m=NOISE_M, span_s=(10.0, 90.0), seed=0):
    times_s = np.arange(*span_s, 1.0 / RATE_HZ)
    noise_m = np.random.default_rng(seed).normal(0.0, noise_m, (len(times_s), 3))
    return Path(times_s, FRAME.inverse().apply(flight(100.0, 7)(times_s) + noise_m))


def test_the_error_is_that_of_the_noise():
    found = compare(_estimate(), _truth())
    in_time, as_shape = found.in_time, found.as_shape
    # Every fourth sample is met on the point; 400 of three coordinates are known to 3 %, and the
    # similarity takes 9 of 1200 degrees of freedom. Three deviations.
    assert in_time.rmse_m == pytest.approx(np.sqrt(3.0) * NOISE_M, rel=0.09)
    assert in_time.coverage == 1.0
    assert len(in_time.distances_m) == 400
    assert in_time.explained == pytest.approx(1.0, abs=1e-4)  # 5 cm in 10 m
    assert in_time.similarity.scale == pytest.approx(FRAME.scale, rel=0.002)  # 3 cm in some 10 m
    # The nearest point leaves the error along the path out: two of three coordinates are left.
    assert as_shape.rmse_m == pytest.approx(np.sqrt(2.0) * NOISE_M, rel=0.06)


def test_where_the_truth_has_no_samples_the_estimate_is_not_off_nor_the_other_way_round():
    truth, estimate = _truth(), _estimate()
    kept = (np.abs(truth.times_s - 81.4) > 3.0) & (truth.times_s < 111.4)  # 50 s and 80 s of it
    holed = Path(truth.times_s[kept], truth.positions_m[kept])
    as_shape = compare(estimate, holed).as_shape
    whole = estimate.times_s[(np.abs(estimate.times_s - 50.0) > 3.0) & (estimate.times_s < 80.0)]
    # Steps of the truth, 0.2 s, on both sides of the gap and at the end.
    assert len(as_shape.distances_m) == pytest.approx(len(whole), abs=4 * 3)
    assert as_shape.rmse_m == pytest.approx(np.sqrt(2.0) * NOISE_M, rel=0.06)  # as without holes
    kept = (estimate.times_s < 30.0) | (estimate.times_s > 50.0)
    found = compare(Path(estimate.times_s[kept], estimate.positions_m[kept]), truth)
    assert found.in_time.coverage == pytest.approx(0.75, abs=0.01)  # 60 of 80 s


def test_a_wrong_clock_shows_in_time_and_not_as_a_shape():
    estimate = _estimate(0.0)
    late_s = 0.1 * np.sin(estimate.times_s)  # no shift nor rate explains it
    found = compare(replace(estimate, times_s=estimate.times_s + late_s), _truth())
    assert found.in_time.rmse_m > 0.05  # 0.07 s rms at over 1 m/s
    assert found.as_shape.rmse_m < 0.02  # what interpolation between 20 and 5 Hz leaves


def test_a_wrong_scale_costs_where_it_is_held():
    truth, estimate = _truth(), _estimate(0.0)
    metric = replace(estimate, positions_m=1.05 * FRAME.scale * estimate.positions_m)
    assert compare(metric, truth).in_time.rmse_m < 0.02
    held = compare(metric, truth, with_scale=False)
    assert held.in_time.similarity.scale == held.as_shape.similarity.scale == 1.0
    spread_m = np.sqrt(np.sum(np.var(truth.positions_m, axis=0)))
    assert held.in_time.rmse_m == pytest.approx(0.05 * spread_m, rel=0.2)  # of 80 of the 100 s


def test_shapes_are_compared_where_there_are_no_times():
    estimate, truth = _estimate(span_s=(0.0, 99.0)), _truth()
    found = compare(replace(estimate, times_s=np.full(len(estimate), np.nan)), truth)
    assert found.in_time is None
    assert found.as_shape.rmse_m == pytest.approx(np.sqrt(2.0) * NOISE_M, rel=0.06)
    turn = Rotation.from_matrix(found.as_shape.similarity.R.T @ FRAME.R)
    assert np.degrees(turn.magnitude()) < 0.3


def test_the_command_prints_and_writes_what_it_found(tmp_path):
    write_path(tmp_path / "path.tum", _estimate())
    write_path(tmp_path / "truth.csv", _truth())
    args = tmp_path / "path.tum", tmp_path / "truth.csv"
    outputs = "--json", tmp_path / "out.json", "--plot", tmp_path / "out.png"
    code, out, err = run("compare", *args, *outputs)
    assert code == 0, err
    assert "at equal times RMSE 0.05" in out
    assert (tmp_path / "out.png").read_bytes().startswith(b"\x89PNG")
    told = read_json(tmp_path / "out.json")
    assert told["in_time"]["n_samples"] == 400
    clock = Clock(*(told["in_time"][key] for key in ("shift_s", "rate_ppm", "t_ref_s")))
    # 5 cm a sample at some 2 m/s: 25 ms, of 400.
    np.testing.assert_allclose(clock.cam2_from_cam1(50.0), CLOCK.cam2_from_cam1(50.0), atol=0.005)
    assert json.dumps(told["as_shape"])


@pytest.mark.parametrize(
    ("args", "reason"),
    [
        (("path.tum", "none.csv"), "no such file"),
        (("path.tum", "rest.csv"), "no shift at which"),
        (("path.tum", "point.csv"), "the truth has 1 points, and at least 3"),
        (("point.csv", "truth.csv"), "the estimate has 1 points, and at least 3"),
        (("path.tum", "truth.csv", "--json", "a.png", "--plot", "a.png"), "for two outputs"),
        (("path.tum", "truth.csv", "--scale", "big"), "expected unknown or known"),
        (("path.tum", "truth.csv", "--json", "truth.csv"), "would be lost"),
        (("path.tum", "truth.csv", "--plot", "out.jpeg"), "ending in .png"),
        (("path.tum", "truth.csv", "--lever-arm", "0", "0", "1"), "no attitude"),
    ],
)
def test_bad_input_is_one_line(tmp_path, args, reason):
    write_path(tmp_path / "path.tum", _estimate())
    write_path(tmp_path / "truth.csv", _truth())
    write_path(tmp_path / "rest.csv", Path(np.arange(99.0), np.ones((99, 3))))
    write_path(tmp_path / "point.csv", Path(np.zeros(1), np.ones((1, 3))))
    files = ".tum", ".csv", ".jpeg", ".png"
    there = [tmp_path / arg if arg.endswith(files) else arg for arg in args]
    code, out, err = run("compare", *there)
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert reason in err
