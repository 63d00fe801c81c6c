"""`ssac sync`: what it finds, prints and writes, and how it refuses."""

import io
import json
import warnings
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass, replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from sim.recording import SimConfig, simulate
from sim.render.instants import SamplingConfig
from sim.scene.trajectory import SplineConfig
from sim.sensor.events import PRESETS
from sim.storage import save_recording
from ssac.clock import Clock
from ssac.console.exits import BAD_INPUT, NO_ESTIMATE
from ssac.estimate import ClockJump, Estimate
from ssac.events import slice_time
from ssac.files.event_files import load_events, save_events_text
from ssac.files.hdf5 import save_events_h5
from ssac.tool.__main__ import main
from ssac.tool.plots import FILE_SUFFIXES
from ssac.tool.report import report_json, report_text
from ssac.tool.sync import sync
from tests.recorded import T_D_S, empty_events
from tests.ssac.synthetic import HEIGHT, WIDTH, angle_deg, rotation_angle_deg

TOLERANCE_S = 3e-3  # 8 s of noisy synthetic pixels: about 1 ms
KEYS = {"t_d_s", "t_d_std_s", "R", "t", "status", "reason", "method", "n_samples", "d_avg_px"}


@dataclass(frozen=True)
class Run:
    """What a command line gave."""

    exit_code: int
    stdout: str
    stderr: str


def run(*args):
    out, err = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        code = main(["sync", *map(str, args)])
    return Run(code, out.getvalue(), err.getvalue())


def read_json(path: Path):
    def refuse(constant):
        raise ValueError(f"{constant} is not JSON")

    return json.loads(path.read_text(), parse_constant=refuse)


@pytest.fixture(scope="module")
def joint_run(recorded):
    json_file, synced = recorded / "joint.json", recorded / "synced.h5"
    result = run(
        *recorded.pair,
        "--rig",
        recorded / "rig.yaml",
        "--json",
        json_file,
        "--write-synced",
        synced,
    )
    return result, read_json(json_file), synced


def test_offset_and_pose_are_found(joint_run, recorded):
    result, found, _ = joint_run
    assert result.exit_code == 0, result.stderr
    assert set(found) >= KEYS
    assert found["note"] == ""
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
    assert f"{found['n_samples']} pairs of tangents to the object's outline used\n" in result.stdout
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


def test_synced_events_have_no_offset_left(joint_run, recorded):
    again = sync(recorded / "cam1.h5", joint_run[2], recorded / "rig.yaml")
    # The search draws other subsets, and stops within 10 us or so of the same minimum.
    assert abs(again.estimate.t_d_s) < 1e-4


def test_the_function_finds_what_the_command_prints(joint_run, recorded):
    result = sync(recorded / "cam1.h5", recorded / "cam2.h5", recorded / "rig.yaml")
    assert report_text(result) == joint_run[0].stdout.rstrip("\n")
    untimed = {key: value for key, value in joint_run[1].items() if key != "seconds"}
    report = report_json(result)
    assert set(report.pop("seconds")) == {"read", "denoise", "estimate"}
    assert report == untimed


def test_swapped_cameras_have_the_opposite_sign(recorded):
    cam1, cam2 = recorded.pair
    result = run(cam2, cam1, "--rig", recorded / "rig.yaml", "--method", "joint")
    assert result.exit_code == 0
    assert "t_d = -" in result.stdout
    assert "less than camera 1's; add it to camera 2's timestamps" in result.stdout


def test_known_extrinsics_are_used(recorded, tmp_path):
    rig, out = recorded / "rig_extrinsics.yaml", tmp_path / "out.json"
    result = run(*recorded.pair, "--rig", rig, "--known-extrinsics", "--json", out)
    assert result.exit_code == 0
    found = read_json(out)
    assert found["method"] == "tangency-known"
    np.testing.assert_allclose(found["R"], recorded.scene.R, atol=1e-12)
    assert f"as given in {rig}" in result.stdout


def test_the_format_of_a_file_does_not_matter(recorded):
    results = [
        sync(recorded / "cam1.h5", recorded / name, recorded / "rig.yaml", "ssac")
        for name in ("cam2.h5", "cam2.txt")
    ]
    assert results[0].estimate.t_d_s == results[1].estimate.t_d_s


def test_recordings_of_unequal_start_and_length(recorded, tmp_path):
    events1, events2 = (load_events(recorded / name).events for name in ("cam1.h5", "cam2.h5"))
    save_events_h5(tmp_path / "1.h5", slice_time(events1, 1_300_000, 8_000_000), WIDTH, HEIGHT)
    save_events_h5(tmp_path / "2.h5", slice_time(events2, 0, 7_100_000), WIDTH, HEIGHT)
    result = sync(tmp_path / "1.h5", tmp_path / "2.h5", recorded / "rig.yaml")
    assert result.estimate.status == "ok"
    assert abs(result.estimate.t_d_s - T_D_S) < TOLERANCE_S


def test_clocks_with_unlike_epochs_need_nothing_more(recorded, tmp_path):
    events = load_events(recorded / "cam2.h5").events.copy()
    epoch_s = 1_700_000_000
    events["t"] += epoch_s * 1_000_000
    save_events_h5(tmp_path / "2.h5", events, WIDTH, HEIGHT)
    args = (recorded / "cam1.h5", tmp_path / "2.h5", "--rig", recorded / "rig.yaml")
    refused = run(*args, "--search", "-1", "1")
    assert refused.exit_code == BAD_INPUT
    advice = refused.stderr.rsplit("for example ", 1)[1].split()
    out = tmp_path / "out.json"
    for more in (advice, ()):  # or every offset is searched
        assert run(*args, *more, "--json", out).exit_code == 0
        assert abs(read_json(out)["t_d_s"] - epoch_s - T_D_S) < TOLERANCE_S


@pytest.mark.parametrize("method", ["zncc_e", "zncc_f", "event_rate"])
def test_what_a_method_does_not_estimate_is_null(method, recorded, tmp_path):
    out = tmp_path / "out.json"
    args = ("--rig", recorded / "rig.yaml", "--method", method, "--json", out)
    result = run(*recorded.pair, *args)
    assert result.exit_code == 0, result.stderr
    found = read_json(out)
    assert found["t_d_s"] is not None
    missing = ("t_d_std_s", "R", "t", "n_samples", "d_avg_px", "covariance")
    assert [found[key] for key in missing] == [None] * len(missing)
    assert ("denoise" in result.stderr) == (method != "zncc_f")


@pytest.mark.parametrize("method", ["ssac", "albl", "zncc_e", "zncc_f", "event_rate"])
def test_an_offset_without_a_deviation_comes_with_no_advice_to_apply_it(method, recorded, tmp_path):
    out = tmp_path / "out.json"
    synced = tmp_path / "synced.h5"
    args = ("--rig", recorded / "rig.yaml", "--method", method, "--json", out)
    result = run(*recorded.pair, *args, "--write-synced", synced)
    assert result.exit_code == 0, result.stderr
    assert f"{synced}, by an offset of unknown accuracy\n" in result.stderr
    note = f"{method} states no standard deviation"
    assert "ms, of unknown accuracy\n" in result.stdout
    assert f"note           {note}" in result.stdout
    assert "subtract" not in result.stdout
    found = read_json(out)
    assert found["t_d_std_s"] is None
    assert found["note"].startswith(note)
    assert found["status"] == "ok"


def test_no_reliable_estimate_says_why(recorded, tmp_path):
    out, synced, plot = tmp_path / "out.json", tmp_path / "synced.h5", tmp_path / "figures"
    result = run(
        *recorded.pair, "--rig", recorded / "rig.yaml", "--search", "-1", "0.02", "--json", out,
        "--write-synced", synced, "--plot", plot,
    )  # fmt: skip
    assert result.exit_code == NO_ESTIMATE
    found = read_json(out)
    assert found["status"] == "search_bound"
    assert "widen the interval" in found["reason"]
    assert f"search_bound: {found['reason']}" in result.stdout
    assert found["t_d_s"] is None
    assert not synced.exists()
    assert f"not written: {synced}" in result.stderr
    assert [path.name for path in plot.iterdir()] == ["d_avg.png"]


def test_an_unreliable_offset_is_not_explained_as_if_it_held(recorded):
    result = sync(recorded / "cam1.h5", recorded / "cam2.h5", recorded / "rig.yaml", "ssac")
    doubtful = replace(
        result.estimate,
        status="ambiguous_offset",
        reason="so it is",
        alternatives_s=np.array([-0.75, 0.85]),
        R=None,
        t=None,
    )
    doubted = replace(result, estimate=doubtful)
    text = report_text(doubted)
    assert text.startswith("no estimate    ambiguous_offset: so it is\nnot reliable   t_d = ")
    assert "or             t_d = -750, 850 ms" in text
    assert "camera 2's clock" not in text
    report = report_json(doubted)
    assert report["alternatives_s"] == [-0.75, 0.85]
    assert report["t_d_is_reliable"] is False


def test_an_offset_that_holds_is_given_without_a_pose(recorded):
    result = sync(recorded / "cam1.h5", recorded / "cam2.h5", recorded / "rig.yaml", "ssac")
    direction = np.eye(6)[[5]]
    partial = replace(
        result.estimate,
        status="degenerate_pose",
        reason="so it is",
        unobservable=direction,
        R=None,
        t=None,
    )
    text = report_text(replace(result, estimate=partial))
    assert text.startswith("no pose        degenerate_pose: so it is\ntime offset    t_d = ")
    assert "camera 2's clock shows" in text
    assert "rotation" not in text
    report = report_json(replace(result, estimate=partial))
    assert report["t_d_is_reliable"] is True
    assert report["unobservable"] == direction.tolist()


def test_clocks_are_told(recorded):
    result = sync(recorded / "cam1.h5", recorded / "cam2.h5", recorded / "rig.yaml", "ssac")
    plain = report_json(result)
    names = ("t_ref_s", "skew_ppm", "skew_std_ppm", "clock_covariance", "clock_jump")
    assert [plain[name] for name in names] == [None] * 5  # the paper's takes them to run alike
    assert plain["clock_knots"] == []
    knots_s = np.array([0.0, 5.0, 10.0])
    wandering = replace(
        result.estimate,
        t_ref_s=5.0,
        skew_ppm=-400.0,
        skew_std_ppm=2.5,
        knots_s=knots_s,
        strays_s=np.array([0.001, -0.002, 0.001]),
        strays_std_s=np.full(3, 1e-4),
    )
    text = report_text(replace(result, estimate=wandering))
    assert "clock skew     -400.0 ppm, 1 sigma 2.5 ppm\n" in text
    assert "camera 2's clock runs slow; t_d holds at 5.000 s of camera 1's\n" in text
    assert "and strays by up to 2.000 ms, 3 knots\n" in text
    assert "far beyond the 50 ppm expected of such clocks: see --skew-prior\n" in text
    report = report_json(replace(result, estimate=wandering))
    assert (report["t_ref_s"], report["skew_ppm"], report["skew_std_ppm"]) == (5.0, -400.0, 2.5)
    assert report["clock_knots"][1] == {"t_s": 5.0, "stray_s": -0.002, "std_s": 1e-4}
    jump = ClockJump(3.0, 0.02, 0.001, 0.05, 0.07)
    jumping = Estimate("joint", "clock_jump", "so it is", jump=jump)
    assert report_text(replace(result, estimate=jumping)).startswith(
        "no estimate    clock_jump: so"
    )
    report = report_json(replace(result, estimate=jumping))
    assert report["clock_jump"] == {
        "at_s": 3.0, "size_s": 0.02, "size_std_s": 0.001, "before_s": 0.05, "after_s": 0.07,
    }  # fmt: skip
    assert (report["t_d_s"], report["t_d_is_reliable"]) == (None, False)


def make_bad_inputs(recorded, folder: Path):
    """File names of camera 1's events and the rig, or options, and what the error must say."""
    (folder / "zero.h5").write_bytes(b"")
    (folder / "truncated.h5").write_bytes((recorded / "cam1.h5").read_bytes()[:50_000])
    (folder / "events.foo").write_bytes(b"1")
    save_events_h5(folder / "no_events.h5", empty_events(), WIDTH, HEIGHT)
    (folder / "unsorted.txt").write_text(f"{WIDTH} {HEIGHT}\n0.2 1 1 1\n0.1 1 1 1\n")
    (folder / "outside.txt").write_text("0.1 400 1 1\n0.2 1 1 1\n")
    (folder / "isolated.txt").write_text(f"{WIDTH} {HEIGHT}\n0.1 1 1 1\n0.2 1 1 1\n")
    events = load_events(recorded / "cam1.h5").events
    save_events_text(folder / "sparse.txt", events[::8], WIDTH, HEIGHT)
    late = events.copy()
    late["t"] += 60_000_000
    save_events_h5(folder / "late.h5", late, WIDTH, HEIGHT)
    rig = (recorded / "rig.yaml").read_text()
    (folder / "large.yaml").write_text(rig.replace(f"[{WIDTH}, {HEIGHT}]", "[640, 480]"))
    (folder / "nan.yaml").write_text(rig.replace("173.0", ".nan"))


BAD_INPUTS = [
    (("missing.h5",), "missing.h5: there is no such file"),
    (("zero.h5",), "zero.h5: the file is empty"),
    (("truncated.h5",), "truncated.h5: not a readable HDF5 file"),
    (("events.foo",), "events.foo: unknown extension '.foo': use one of"),
    (("no_events.h5",), "no_events.h5: there are no events"),
    (("unsorted.txt",), "unsorted.txt: events must be sorted by time"),
    (("outside.txt",), "outside.txt with camera 1 of .*: the sensor is 346 x 260 px"),
    (("isolated.txt",), "isolated.txt: denoising left 0 of 2 events"),
    (("sparse.txt",), "sparse.txt: no window of 40 ms holds 200 events"),
    (("late.h5", "--search", "-1", "1"), r"late.h5 .60.* have no common time .* --search -6.*"),
    (("cam2.h5",), "cam2.h5: given for both cameras"),
    (("cam1.h5", "--rig", "large.yaml"), "large.yaml is calibrated at 640 x 480 px, but .*cam1.h5"),
    (("cam1.h5", "--rig", "nan.yaml"), "nan.yaml, cam0, intrinsics: expected 4 of finite numbers"),
    (("cam1.h5", "--rig", "cam1.h5"), "cam1.h5: unknown extension '.h5' of a rig"),
    (("cam1.h5", "--known-extrinsics"), "rig.yaml: tangency-known needs the extrinsics"),
    (("cam1.h5", "--method", "scac"), "unknown method 'scac': use one of ssac"),
    (("events_only.h5", "--method", "zncc_f"), "events_only.h5: zncc_f compares intensity frames"),
    (("cam1.h5", "--search", "1", "-1"), "--search: expected a smaller and a larger offset"),
    (("cam1.h5", "--search", "0", "nan"), "--search: expected a smaller and a larger offset"),
    (("cam1.h5", "--skew-prior", "-1"), "--skew-prior: expected 0 to 100000 ppm, got -1"),
    (("cam1.h5", "--clock", "quartz"), "--clock: expected affine or pieces, got quartz"),
    (("cam1.h5", "--clock", "pieces", "--skew-prior", "0"), "its prior must be above 0 ppm"),
    (("cam1.h5", "--search", "0", "4000"), "at most 3600 seconds apart, got 0 4000"),
    (("cam1.h5", "--n-samples", "0"), "--n-samples: expected 20 to 100000, got 0"),
    (("cam1.h5", "--half-window", "20"), "--half-window: expected 0.001 to 0.25 seconds, got 20"),
    (("cam1.h5", "--half-window", "nan"), "--half-window: expected 0.001 to 0.25 seconds"),
    (("cam1.h5", "--n-min", "-3"), "--n-min: expected 1 to 100000, got -3"),
    (("cam1.h5", "--json", "no/such/out.json"), "out.json: not a file in a folder that exists"),
    (("cam1.h5", "--write-synced", "out.raw"), "out.raw: cannot write the extension '.raw'"),
    (("cam1.h5", "--write-synced", "cam1.h5"), "cam1.h5: is one of the inputs"),
    (("cam1.h5", "--plot", "cam1.h5"), "cam1.h5: exists and is no folder"),
]


@pytest.fixture(scope="module")
def bad_folder(recorded, tmp_path_factory):
    folder = tmp_path_factory.mktemp("bad")
    for name in ("cam1.h5", "cam2.h5", "rig.yaml"):
        (folder / name).write_bytes((recorded / name).read_bytes())
    (folder / "events_only.h5").write_bytes((recorded / "cam1.h5").read_bytes())
    with h5py.File(folder / "events_only.h5", "a") as file:
        del file["frames"]
    make_bad_inputs(recorded, folder)
    return folder


@pytest.mark.parametrize(("args", "message"), BAD_INPUTS, ids=lambda value: " ".join(value))
def test_bad_input_is_refused_in_one_line(args, message, bad_folder, monkeypatch):
    monkeypatch.chdir(bad_folder)
    before = {path.name: path.stat().st_mtime_ns for path in bad_folder.iterdir()}
    rig = () if "--rig" in args else ("--rig", "rig.yaml")
    result = run(args[0], "cam2.h5", *args[1:], *rig)
    assert result.exit_code == BAD_INPUT
    assert result.stdout == ""
    *progress, last = result.stderr.splitlines()
    assert not any("error" in line for line in progress)
    assert last.startswith("error: ")
    with pytest.raises(ValueError, match=message):
        raise ValueError(last)
    assert before == {path.name: path.stat().st_mtime_ns for path in bad_folder.iterdir()}


@pytest.mark.parametrize(
    ("args", "message"),
    [
        ((), "Missing option '--rig'"),
        (("--search", "-1"), "Option '--search' requires 2 arguments"),
        (("--n-samples", "many"), "Invalid value for '--n-samples'"),
    ],
)
def test_bad_usage_is_refused_in_one_line(args, message, recorded):
    rig = ("--rig", recorded / "rig.yaml") if args else ()
    result = run(*recorded.pair, *rig, *args)
    assert result.exit_code == BAD_INPUT
    (line,) = result.stderr.splitlines()
    assert line.startswith(f"error: {message}")
    assert line.endswith("; see python -m ssac.tool sync --help")


def test_deviations_of_the_intrinsics_widen_those_of_the_pose(recorded, tmp_path):
    found = []
    for focal, centre in (("0", "0"), ("1", "3")):
        out = tmp_path / "out.json"
        result = run(
            *recorded.pair, "--rig", recorded / "rig.yaml", "--method", "joint", "--json", out,
            "--focal-std", focal, "--centre-std", centre,
        )  # fmt: skip
        assert result.exit_code == 0
        found.append(np.sqrt(np.diag(read_json(out)["covariance"]))[1:])
    assert np.all(found[1] > found[0])


def test_options_reach_the_method(recorded):
    result = run(
        *recorded.pair, "--rig", recorded / "rig.yaml", "--no-denoise", "--n-samples", "150",
        "--half-window", "0.01", "--n-min", "100", "--method", "joint",
    )  # fmt: skip
    assert result.exit_code == 0
    assert " pairs of positions used, of 150 sample times\n" in result.stdout
    assert "denoise" not in result.stderr


@pytest.mark.parametrize("suffix", FILE_SUFFIXES)
def test_one_file_holds_all_figures(suffix, recorded, tmp_path):
    plot = tmp_path / f"page{suffix}"
    args = ("--rig", recorded / "rig.yaml", "--method", "zncc_f", "--plot", plot)
    result = run(*recorded.pair, *args)
    assert result.exit_code == 0
    assert [path.name for path in tmp_path.iterdir()] == [plot.name]
    assert str(plot) in result.stderr


def test_a_warning_is_one_line(recorded, tmp_path, monkeypatch):
    def warn_and_load(path):
        warnings.warn(f"{path} starts at time 0", stacklevel=2)
        return load_events(path)

    monkeypatch.setattr("ssac.tool.load.load_events", warn_and_load)
    result = run(*recorded.pair, "--rig", recorded / "rig.yaml", "--method", "zncc_e")
    assert f"warning: {recorded / 'cam1.h5'} starts at time 0\n" in result.stderr


@pytest.mark.render
@pytest.mark.parametrize(
    ("noise", "t_d_s", "angle"), [("ideal", 0.05, 90.0), ("davis346", -0.5, 60.0)]
)
def test_a_simulated_recording_end_to_end(noise, t_d_s, angle, tmp_path):
    recording = simulate(
        SimConfig(
            angle_deg=angle,
            t_d_s=t_d_s,
            spline=SplineConfig(duration_s=8.0),
            sampling=SamplingConfig(max_step_px=1.0),
            sensor=PRESETS[noise],
        ),
        seed=0,
    )
    folder = tmp_path / "recording"
    save_recording(recording, folder, {})
    result = sync(folder / "cam1.h5", folder / "cam2.h5", folder / "rig.yaml")
    estimate, truth = result.estimate, recording.truth
    assert estimate.status == "ok"
    assert estimate.R is not None
    assert estimate.t is not None
    # The bias of the events' mean, over the few passes of 8 s.
    assert abs(estimate.t_d_s - truth.t_d_s) < 3e-3
    assert rotation_angle_deg(estimate.R, truth.R) < 4.0
    assert angle_deg(estimate.t, truth.t) < 4.0
