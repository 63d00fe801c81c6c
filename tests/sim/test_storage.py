import json
import shutil
import time
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import Mock

import h5py
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sim.errors import SimError
from sim.recorded import CameraRecording, Drift, Recording, Truth
from sim.recording import simulate
from sim.render.gl_context import GLContext
from sim.render.renderer import RenderCheck
from sim.scene.rig import two_view_rig
from sim.sensor.frames import Frames
from sim.sensor.kernels import EVENT_DTYPE
from sim.storage import check_out_dir, record, save_recording
from ssac.files.event_files import load_events
from ssac.files.hdf5 import load_frames
from ssac.files.rigs import load_rig
from tests.sim import scenes

T_D_S = 0.05
PROVENANCE = {"seed": 3, "spline": {"a": 2.0}, "files": ["a.csv"], "none": None, "on": True}
QUICK = replace(scenes.QUICK, t_d_s=T_D_S)


def made_up_recording(n_events=5000, n_frames=4, first_us=-1_234_567):
    """Make a recording of random events, frames and poses, as no simulation is needed to write."""
    rng = scenes.rng()
    rig = two_view_rig(70.0, t_d_s=T_D_S, **scenes.lens("radtan", -0.1, 0.01, 0.001, 0.0))
    cameras = []
    for camera in rig.cameras:
        events = np.empty(n_events, EVENT_DTYPE)
        events["t"] = first_us + np.sort(rng.integers(0, 3_000_000, n_events))
        events["x"], events["y"] = rng.integers(0, 346, n_events), rng.integers(0, 260, n_events)
        events["p"] = rng.integers(0, 2, n_events)
        times_us = first_us + 20_000 * np.arange(n_frames)
        images = rng.integers(0, 256, (n_frames, 260, 346)).astype(np.uint8)
        cameras.append(CameraRecording(camera, events, Frames(times_us, images, 0.005)))
    T_W_B = scenes.tumbling(20, 0, (0.0, 0.0, 0.0), 2.0)
    T_W_B[7, :3, 3] = [0.0, -9.0, 0.0]  # behind camera 1
    centres_px = np.stack([camera.project(T_W_B[:, :3, 3]) for camera in rig.cameras])
    drift = Drift(-20_000.0, 0.5, (0.7, 0.005))
    truth = Truth(T_D_S, *rig.extrinsics(), np.linspace(0, 1, 20), T_W_B, centres_px, drift)
    gl = GLContext("osmesa", "llvmpipe", "4.5")
    return Recording(rig, truth, 321, gl, RenderCheck(50, 9000, 0.004, 0.01), tuple(cameras))


def contents(folder):
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir())}


@pytest.mark.parametrize(
    ("n_events", "n_frames", "first_us", "fit"),
    [(0, 1, 0, 186), (1, 0, -400_000, 186), (5000, 16, -1_234_567, 186), (65_536, 0, 0, 186),
     (140_000, 35, 7, 186), *((0, 5, 0, fit) for fit in (0.25, 1.75, 17.5))],
)  # fmt: skip
def test_hdf5_and_text_are_read_back(tmp_path, monkeypatch, n_events, n_frames, first_us, fit):
    """The frames that are stored are the same, however few of them may be in memory at once."""
    monkeypatch.setattr("sim.storage._MAX_CHUNK_BYTES", round(fit * 260 * 346))
    recording = made_up_recording(n_events, n_frames, first_us)
    save_recording(recording, tmp_path / "out", {}, text=True)
    for camera in recording.cameras:
        path = tmp_path / "out" / f"{camera.camera.name}.h5"
        with h5py.File(path) as file:
            assert (file.attrs["width"], file.attrs["height"]) == (346, 260)
            for name in "txyp":
                assert file[f"events/{name}"].dtype == EVENT_DTYPE[name]
                np.testing.assert_array_equal(file[f"events/{name}"][:], camera.events[name])
            assert ("frames" in file) == (n_frames > 0)
            if n_frames:
                assert file["frames/images"].chunks[0] == min(max(int(fit), 1), 16, n_frames)
        lines = path.with_suffix(".txt").read_text().splitlines()
        assert lines[0] == "346 260"
        assert len(lines) == 1 + n_events
        if n_events:
            for suffix in (".h5", ".txt"):
                read = load_events(path.with_suffix(suffix))
                assert read.events.dtype == EVENT_DTYPE
                np.testing.assert_array_equal(read.events, camera.events)
                assert (read.width, read.height) == (346, 260)
        expected = (camera.frames.times_us, camera.frames.images) if n_frames else None
        np.testing.assert_equal(load_frames(path), expected)


def test_rigs_and_the_truth_are_complete(tmp_path):
    recording = made_up_recording()
    save_recording(recording, tmp_path / "out", PROVENANCE)
    assert load_rig(tmp_path / "out" / "rig.yaml").T_2_1 is None
    known, truth = load_rig(tmp_path / "out" / "rig_extrinsics.yaml"), recording.truth
    np.testing.assert_allclose(known.T_2_1[:3, :3], truth.R, atol=1e-12)  # round-off
    np.testing.assert_allclose(known.T_2_1[:3, 3], truth.t * truth.baseline_m, atol=1e-12)
    for read, made in zip((known.cam1, known.cam2), recording.rig.cameras, strict=True):
        np.testing.assert_array_equal(read.K, made.K)
        assert (read.width, read.height) == (made.width, made.height)
        assert read.intrinsics_std_px == (0.0, 0.0, 0.0, 0.0)  # exact intrinsics
    truth = json.loads((tmp_path / "out" / "truth.json").read_text(), parse_constant=pytest.fail)
    assert (truth["t_d_s"], truth["skew_ppm"], truth["t_ref_s"]) == (T_D_S, -20_000.0, 0.5)
    assert truth["clock_jump"] == {"at_s": 0.7, "size_s": 0.005}
    np.testing.assert_array_equal(truth["R"], recording.truth.R)
    np.testing.assert_array_equal(truth["t"], recording.truth.t)
    assert truth["provenance"] == PROVENANCE
    assert truth["n_instants"] == recording.n_instants
    assert truth["gl"] == {"backend": "osmesa", "renderer": "llvmpipe", "version": "4.5"}
    # Rounded to nine decimals.
    np.testing.assert_allclose(truth["times_s"], recording.truth.times_s, atol=1e-9)
    positions_m = np.array(truth["drone_position_W_m"])
    np.testing.assert_allclose(positions_m, recording.truth.T_W_B[:, :3, 3], atol=1e-9)
    R = Rotation.from_quat(truth["drone_quaternion_W_B_xyzw"]).as_matrix()
    np.testing.assert_allclose(R, recording.truth.T_W_B[:, :3, :3], atol=1e-8)
    clocks = (("cam1", 0.0), ("cam2", T_D_S))
    for (name, offset_s), centres_px in zip(clocks, recording.truth.centres_px, strict=True):
        camera = truth["cameras"][name]
        assert camera["time_offset_s"] == offset_s
        assert camera["n_events"] == 5000
        assert np.array(camera["T_C_W"]).shape == (4, 4)
        read_px = np.array(camera["drone_px"], dtype=float)  # null becomes NaN
        np.testing.assert_allclose(read_px, centres_px, atol=1e-9)
    assert truth["cameras"]["cam1"]["drone_px"][7] == [None, None]


@pytest.mark.render
def test_the_same_bytes_are_written_after_a_simulation_and_meanwhile(tmp_path):
    recording = simulate(QUICK, 3)
    save_recording(recording, tmp_path / "after", PROVENANCE, text=True)
    time.sleep(1.1)  # time stamps within files have a resolution of a second
    recorded = record(QUICK, 3, tmp_path / "meanwhile", PROVENANCE, text=True)
    assert contents(tmp_path / "meanwhile") == contents(tmp_path / "after")
    assert recorded.n_events == tuple(len(camera.events) for camera in recording.cameras)
    assert recorded.n_frames == (50, 50)
    assert recorded.flight.n_instants == recording.n_instants


@pytest.mark.parametrize("error", [OSError("No space left on device"), KeyboardInterrupt()])
@pytest.mark.parametrize("step", ["CameraFiles", "save_events_text", "kalibr_yaml", "_truth"])
@pytest.mark.parametrize("out", ["new", "empty", "a/b/new"])
def test_nothing_is_left_of_a_recording_that_cannot_be_written(
    tmp_path, monkeypatch, error, step, out
):
    (tmp_path / "empty").mkdir()
    monkeypatch.setattr(f"sim.storage.{step}", Mock(side_effect=error))
    with pytest.raises(SimError if isinstance(error, OSError) else KeyboardInterrupt):
        save_recording(made_up_recording(50, 1), tmp_path / out, {}, text=True)
    assert [str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*")] == ["empty"]


@pytest.mark.parametrize(
    ("disk_mb", "n_events", "n_frames", "text"),
    [(20, 0, 60, False), (19, 300_000, 0, False), (19, 100_000, 0, True), (16, 5, 1, False)],
    ids=["frames", "events", "text", "full before"],
)
def test_hdf5_never_fills_a_disk(tmp_path, monkeypatch, disk_mb, n_events, n_frames, text):
    """It writes much of what it is given at the end, and ends the process where it cannot."""
    written = []

    def disk_usage(folder):
        written.append(sum(path.stat().st_size for path in folder.iterdir()))
        return SimpleNamespace(free=disk_mb * 2**20 - written[-1])

    def remove(folder, ignore_errors):
        disk_usage(folder)  # its files are closed by now
        removed(folder)

    removed = shutil.rmtree
    monkeypatch.setattr("sim.storage.shutil.disk_usage", disk_usage)
    monkeypatch.setattr("sim.storage.shutil.rmtree", remove)
    with pytest.raises(SimError, match=r"bytes are free on this disk, and .* needed: make room"):
        save_recording(made_up_recording(n_events, n_frames), tmp_path / "out", {}, text=text)
    assert max(written) < disk_mb * 2**20
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("out", "filled", "reason"),
    [
        ("taken", "before", "is not empty, .* is in it: name a new folder"),
        ("taken", "meanwhile", "is not empty, .* is in it: name a new folder"),
        ("taken", "made meanwhile", "is not empty, .* is in it: name a new folder"),
        ("taken/notes.txt", "before", r"notes\.txt is a file: name a folder"),
        ("taken/notes.txt/out", "before", r"cannot write the recording to .*notes\.txt/out"),
    ],
)
def test_what_is_there_is_left_alone(tmp_path, out, filled, reason):
    taken = tmp_path / "taken"

    def fill(*_):
        taken.mkdir(exist_ok=True)
        (taken / "notes.txt").write_text("mine")

    if filled != "made meanwhile":
        taken.mkdir()
    if filled == "before":
        fill()
    with pytest.raises(SimError, match=reason):
        save_recording(made_up_recording(5, 0), tmp_path / out, {}, write_more=fill)
    assert contents(taken) == {"notes.txt": b"mine"}
    assert [path.name for path in tmp_path.iterdir()] == ["taken"]


@pytest.mark.parametrize("out", ["new", "deep/er/new", "empty", "empty/", ".", "./", "../here"])
def test_new_and_empty_folders_are_taken_and_the_present_one(tmp_path, monkeypatch, out):
    """The parent of a folder may be another disk, or not be writable: nothing is written there."""
    here = tmp_path / "here"
    (here / "empty" if "empty" in out else here).mkdir(parents=True)
    monkeypatch.chdir(here)
    check_out_dir(Path(out))
    seen = []

    def look(partial, _):
        seen.append(partial.parent)
        assert [path.name for path in tmp_path.iterdir()] == ["here"]

    save_recording(made_up_recording(5, 1), Path(out), {}, write_more=look)
    assert seen == [here / "empty" if "empty" in out else here]
    assert "truth.json" in contents(Path(out))  # of the present folder: still the same one
    assert [path.name for path in tmp_path.iterdir()] == ["here"]
    assert not list(tmp_path.rglob("*.partial"))
