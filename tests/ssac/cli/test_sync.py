"""`ssac sync`: what it finds, prints and writes."""

from pathlib import Path

import numpy as np
import pytest

from ssac import sync
from ssac.cli.exits import NO_ESTIMATE
from ssac.clock import Clock
from ssac.files.event_files import load_events
from ssac.files.hdf5 import save_events_h5
from ssac.files.rigs import load_rig
from ssac.files.whole_file import FIGURE_SUFFIXES
from tests.recorded import DURATION_S, T_D_S
from tests.ssac.bags import arrays, mono, write_bag
from tests.ssac.cluttered import lamp, merged
from tests.ssac.command import read_json, run_sync
from tests.ssac.synthetic import HEIGHT, WIDTH, angle_deg, rotation_angle_deg

TOLERANCE_S = 3e-3  # 8 s of noisy synthetic pixels: about 1 ms
KEYS = {"t_d_s", "t_d_std_s", "R", "t", "status", "reason", "method", "n_samples", "d_avg_px"}


@pytest.fixture(scope="module")
def joint_run(recorded):
    out, synced = recorded / "joint.json", recorded / "synced.h5"
    options = ("--rig", recorded / "rig.yaml", "--json", out, "--write-synced", synced)
    return run_sync(*recorded.pair, *options), read_json(out), synced


def test_offset_and_pose_are_found(joint_run, recorded):
    result, found, _ = joint_run
    assert result.exit_code == 0, result.stderr
    assert set(found) >= KEYS
    assert "the outline does not close" in found["note"]  # of a cloud of pixels
    assert (found["status"], found["reason"], found["method"]) == ("ok", "", "tangency")
    assert abs(found["t_d_s"] - T_D_S) < TOLERANCE_S
    assert 0.0 < found["t_d_std_s"] < TOLERANCE_S
    assert rotation_angle_deg(np.array(found["R"]), recorded.scene.R) < 3.0
    assert angle_deg(np.array(found["t"]), recorded.scene.t) < 3.0
    assert found["n_samples"] > 200
    assert found["d_avg_px"] < 1.5  # tangents of a cloud of pixels, not of an outline


def test_results_are_on_stdout_and_progress_on_stderr(joint_run):
    result, found, synced = joint_run
    shown_ms = f"{1e3 * found['t_d_s']:.3f} ms"
    assert f"t_d = {shown_ms}" in result.stdout
    assert f"camera 2's clock shows {shown_ms} more than camera 1's; subtract it" in result.stdout
    assert f"{found['n_samples']} pairs of tangents to the outline" in result.stdout
    for part in ("read", "denoise", "estimate", "write"):
        assert part not in result.stdout
        assert any(line.startswith(part) and " s  " in line for line in result.stderr.splitlines())
    assert str(synced) in result.stderr


def test_synced_events_are_whole_and_on_the_clock_of_camera_1(joint_run, recorded):
    _, found, synced = joint_run
    before, after = load_events(recorded / "cam2.h5").events, load_events(synced).events
    clock = Clock(found["t_d_s"], found["skew_ppm"], found["t_ref_s"])
    expected_us = 1e6 * clock.cam1_from_cam2(before["t"] / 1e6)
    # Half a microsecond by rounding, and the last digits of a float.
    assert np.abs(after["t"] - expected_us).max() <= 0.5 + 1e-6
    assert all(np.array_equal(before[field], after[field]) for field in "xyp")


def test_swapped_cameras_have_the_opposite_sign(recorded):
    cam1, cam2 = recorded.pair
    result = run_sync(cam2, cam1, "--rig", recorded / "rig.yaml", "--method", "joint")
    assert result.exit_code == 0
    assert "t_d = -" in result.stdout
    assert "less than camera 1's; add it to camera 2's timestamps" in result.stdout


NAMES = {"cam1", "cam2", "rig", "seconds"}


@pytest.mark.parametrize("suffix", [".bag", ".mcap"])
def test_bags_give_what_the_files_give_that_they_were_made_of(suffix, recorded, tmp_path):
    out, bag = tmp_path / "out.json", tmp_path / f"flight{suffix}"
    cam1, cam2 = (load_events(path).events for path in recorded.pair)
    write_bag(bag, {"/cam2/events": mono(cam2), "/cam1/events": arrays(cam1)})
    args = ("--rig", recorded / "rig.yaml", "--method", "joint", "--json", out)
    assert run_sync(*recorded.pair, *args).exit_code == 0
    expected = read_json(out)
    for cameras in (
        (bag, "--topics", "/cam1/events", "/cam2/events"),
        (bag, bag, "--topics", "cam1/events", "cam2/events"),
        (bag / "cam1/events", bag / "cam2/events"),
        (recorded / "cam1.h5", bag / "cam2/events"),
    ):
        assert run_sync(*cameras, *args).exit_code == 0
        found = read_json(out)
        assert {key for key in found | expected if found[key] != expected[key]} <= NAMES


def test_the_rig_that_is_written_gives_the_same_offset_with_its_extrinsics(recorded, tmp_path):
    out, rig = tmp_path / "out.json", tmp_path / "found.yaml"
    args = ("--rig", recorded / "rig.yaml", "--json", out, "--write-rig", rig, "--distance", 7)
    assert run_sync(*recorded.pair, *args).exit_code == 0
    found = read_json(out)
    assert found["distance_m"] == 7.0
    T_2_1 = load_rig(rig).T_2_1
    np.testing.assert_array_equal(T_2_1[:3, :3], found["R"])
    np.testing.assert_allclose(T_2_1[:3, 3], 7.0 * np.array(found["t"]), rtol=1e-12)
    assert f"timeshift_cn_cnm1: {found['t_d_s']!r}\n" in rig.read_text()
    known = run_sync(*recorded.pair, "--rig", rig, "--known-extrinsics", "--json", out)
    assert known.exit_code == 0
    assert f"as given in {rig}" in known.stdout
    again = read_json(out)
    assert again["method"] == "tangency-known"
    np.testing.assert_allclose(again["t"], found["t"], atol=1e-12)
    # The pose that fits best is not given up: the offset stays where it was, to its deviation.
    assert abs(again["t_d_s"] - found["t_d_s"]) < found["t_d_std_s"]


def test_a_folder_as_it_was_simulated_is_enough(recorded, tmp_path):
    out = tmp_path / "out.json"
    known = ("--known-extrinsics",), "rig_extrinsics.yaml"
    for method, rig in ((("--method", "ssac"), "rig.yaml"), known):
        assert run_sync(recorded.folder, *method, "--json", out).exit_code == 0
        found = read_json(out)
        args = (*recorded.pair, "--rig", recorded / rig, *method, "--json", out)
        assert run_sync(*args).exit_code == 0
        assert {**read_json(out), "seconds": 0} == {**found, "seconds": 0}


@pytest.mark.parametrize("method", ["ssac", "albl", "zncc_e", "zncc_f", "event_rate"])
def test_an_offset_without_a_deviation_comes_with_no_advice_to_apply_it(method, recorded, tmp_path):
    out, synced = tmp_path / "out.json", tmp_path / "synced.h5"
    args = ("--rig", recorded / "rig.yaml", "--method", method, "--json", out)
    result = run_sync(*recorded.pair, *args, "--write-synced", synced)
    assert result.exit_code == 0, result.stderr
    assert f"{synced}, by an offset of unknown accuracy\n" in result.stderr
    assert ("denoise" in result.stderr) == (method != "zncc_f")
    note = f"{method} states no standard deviation"
    assert "ms, of unknown accuracy\n" in result.stdout
    assert f"note           {note}" in result.stdout
    assert "subtract" not in result.stdout
    found = read_json(out)
    assert found["note"].startswith(note)
    assert found["status"] == "ok"
    assert found["t_d_s"] is not None
    missing = ("t_d_std_s", "covariance")
    if method not in ("ssac", "albl"):  # what a method does not estimate is null
        missing += ("R", "t", "n_samples", "d_avg_px")
    assert [found[key] for key in missing] == [None] * len(missing)


def test_no_reliable_estimate_says_why(recorded, tmp_path):
    out, synced, plot = tmp_path / "out.json", tmp_path / "synced.h5", tmp_path / "figures"
    outputs = ("--json", out, "--write-synced", synced, "--plot", plot)
    args = ("--rig", recorded / "rig.yaml", "--search", "-1", "0.02", *outputs)
    result = run_sync(*recorded.pair, *args)
    assert result.exit_code == NO_ESTIMATE
    found = read_json(out)
    assert found["status"] == "search_bound"
    assert "widen the interval" in found["reason"]
    assert f"search_bound: {found['reason']}" in result.stdout
    assert found["t_d_s"] is None
    assert not synced.exists()
    assert f"not written: {synced}" in result.stderr
    assert [path.name for path in plot.iterdir()] == ["d_avg.png"]


def test_a_lamp_in_view_of_each_camera_changes_little(recorded, tmp_path):
    rig, files = recorded / "rig.yaml", []
    without = sync(*recorded.pair, rig, "joint").estimate
    for path, place in zip(recorded.pair, ((150, 100), (190, 140)), strict=True):
        files.append(tmp_path / Path(path).name)
        lit = merged(load_events(path).events, lamp(*place, 12, round(1e6 * DURATION_S)))
        save_events_h5(files[-1], lit, WIDTH, HEIGHT)
    result = sync(*files, rig, "joint")
    assert result.estimate.status == "ok"
    # The object's events in the mask's 144 px of 90,000 are gone; 0.3 ms is the mark.
    assert abs(result.estimate.t_d_s - without.t_d_s) < 3e-4
    assert [camera.clutter.masked_pixels for camera in result.answer.cleans] == [144, 144]
    assert "camera 1: 144 px that fire by themselves masked" in result.summary()


def test_options_reach_the_method_and_deviations_of_the_intrinsics_widen_the_poses(
    recorded, tmp_path
):
    found, out = [], tmp_path / "out.json"
    args = (*recorded.pair, "--rig", recorded / "rig.yaml", "--method", "joint", "--json", out)
    options = ["--no-denoise", "--n-samples", "150", "--half-window", "0.01", "--n-min", "100"]
    for focal, centre in (("0", "0"), ("1", "3")):
        result = run_sync(*args, *options, "--focal-std", focal, "--centre-std", centre)
        assert result.exit_code == 0
        assert " pairs of positions used, of 150 sample times\n" in result.stdout
        assert "denoise" not in result.stderr
        found.append(np.sqrt(np.diag(read_json(out)["covariance"]))[1:])
    assert np.all(found[1] > found[0])


@pytest.mark.parametrize("suffix", FIGURE_SUFFIXES)
def test_one_file_holds_all_figures(suffix, recorded, tmp_path):
    plot = tmp_path / f"page{suffix}"
    args = ("--rig", recorded / "rig.yaml", "--method", "zncc_f", "--plot", plot)
    result = run_sync(*recorded.pair, *args)
    assert result.exit_code == 0
    assert [path.name for path in tmp_path.iterdir()] == [plot.name]
    assert str(plot) in result.stderr
