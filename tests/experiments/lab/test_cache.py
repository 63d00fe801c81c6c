"""The cache: what an entry depends on; entries are made once and whole, and damage is found."""

import os
import re
import shutil
import socket
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from experiments.lab import cache as module
from experiments.lab import grid
from experiments.lab.cache import ASIDE, Cache, claimed, recording_key, remove_lapsed, run_key
from experiments.lab.code import ROOT
from experiments.lab.grid import Cell
from sim.errors import SimError
from sim.recording import SimConfig
from sim.render.config import RenderConfig
from sim.render.gl_context import BACKENDS, open_context
from sim.scene.trajectory import SplineConfig
from ssac.config import Config
from ssac.errors import SsacError, WriteError
from ssac.events import EVENT_DTYPE
from ssac.files.hdf5 import save_events_h5
from ssac.pipeline.registry import METHODS
from tests.experiments.lab.squares import flipped
from tests.left_over import ended_process

pytestmark = pytest.mark.render  # a recording's key names the GL driver

ROW = {"status": "ok", "reason": "", "t_d_error_ms": 0.1 + 0.2, "r_error_deg": None}


def files_in(folder):
    return [path.name for path in folder.rglob("*") if path.is_file()]


def test_every_parameter_and_the_seed_make_another_recording_but_the_offset_does_not():
    leaky = replace(SimConfig().sensor, leak_hz=0.1)
    configs = SimConfig(), SimConfig(angle_deg=91.0), SimConfig(sensor=leaky)
    keys = [*(recording_key(one, 0) for one in configs), recording_key(SimConfig(), 1)]
    assert len(set(keys)) == 4
    assert recording_key(SimConfig(t_d_s=0.5), 0) == keys[0]


def test_a_file_counts_by_what_is_in_it_and_in_those_that_it_names(tmp_path):
    contents = []
    for number, text in enumerate("aab"):
        file = tmp_path / f"{number}.ply"
        file.write_text(text)
        contents.append(module.content(SimConfig(drone_file=file)))
    assert contents[0] == contents[1] != contents[2]
    assert module.content(tmp_path) == str(tmp_path)  # a folder: its reader says what is wrong
    file, keys = tmp_path / "one.obj", set()
    file.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nmtllib one.mtl\nusemtl a\nf 1 2 3\n")
    for red in (1, 0.5):
        file.with_suffix(".mtl").write_text(f"newmtl a\nKd {red} 0 0\n")
        keys.add(recording_key(SimConfig(drone_file=file), 0))
    assert len(keys) == 2


def test_the_size_of_a_cache_leaves_out_what_another_run_moves(tmp_path, monkeypatch):
    (tmp_path / "kept").write_bytes(b"123")
    monkeypatch.setattr(os, "walk", lambda folder: [(str(folder), [], ["kept", "moved"])])
    assert Cache(tmp_path).size_bytes() == 3


def test_a_recording_is_as_large_as_its_flight_is_long(tmp_path):
    path = tmp_path / "flight.csv"
    path.write_text("".join(f"{t},0,0,1,0,0,0,1\n" for t in range(91)))
    by_file = module.recording_bytes(SimConfig(trajectory_file=path))
    assert by_file == module.recording_bytes(SimConfig(spline=SplineConfig(duration_s=90.0)))


def test_every_part_makes_another_run_and_so_does_another_version_of_a_method(monkeypatch):
    recordings, inputs = ("recording",), (0.05, Config(), "ssac", "")
    code = ("experiments.lab.scored",)
    keys = [
        run_key(recordings, inputs, code),
        run_key(("other",), inputs, code),
        run_key(("recording", "other"), inputs, code),
        run_key(recordings, inputs, ("experiments.studies.refusal",)),
    ]
    for at, value in enumerate((0.06, Config(n_min=100), "joint", "1.0")):
        keys.append(run_key(recordings, (*inputs[:at], value, *inputs[at + 1 :]), code))
    assert len(set(keys)) == len(keys)
    cell = Cell(SimConfig(), 0, 0, 0.05, Config(), "ssac", {})
    before = run_key(recordings, cell.inputs, ())
    method = replace(METHODS["ssac"], version="of yesterday")
    monkeypatch.setattr(grid, "METHODS", {"ssac": method})
    assert run_key(recordings, cell.inputs, ()) != before


@pytest.mark.parametrize("packages", ["SIM_PACKAGES", "SSAC_PACKAGES"])
def test_another_version_of_a_package_is_another_key(monkeypatch, packages):
    def keys():
        return recording_key(SimConfig(), 0), run_key((), 1, ("experiments.lab.scored",))

    before, real = keys(), module.package_versions
    listed = getattr(module, packages)
    monkeypatch.setattr(
        module, "package_versions",
        lambda names: real(names) | ({"numpy": "0.1"} if names == listed else {}),
    )  # fmt: skip
    assert np.not_equal(keys(), before).tolist() == [packages[:3] == "SIM", packages[:4] == "SSAC"]


@pytest.mark.parametrize("folder", ["sim", "ssac"])
def test_every_package_that_computes_is_part_of_a_key(folder):
    said = r"^\s*(?:import|from) (numpy|scipy|numba|cv2|pyrender|OpenGL|trimesh|manifold3d)\b"
    texts = (path.read_text(encoding="utf-8") for path in (ROOT / folder).rglob("*.py"))
    used = {name for text in texts for name in re.findall(said, text, re.MULTILINE)}
    of = {"cv2": "opencv-python-headless", "OpenGL": "PyOpenGL"}
    assert {of.get(name, name) for name in used} <= {*getattr(module, f"{folder.upper()}_PACKAGES")}
    assert "cv2" in used


def test_a_simulation_that_fails_is_the_simulators_error_and_leaves_nothing(tmp_path):
    (other,) = {*BACKENDS} - {open_context().backend}
    undrawn = SimConfig(render=RenderConfig(backend=other))
    for config, said in ((SimConfig(angle_deg=200.0), "the angle between"), (undrawn, "draws")):
        with pytest.raises(SimError, match=said):
            Cache(tmp_path).recording_folder(config, 0)
        assert files_in(tmp_path) == []


def test_a_run_comes_back_as_it_went_in_and_only_if_it_was_written_whole(tmp_path, monkeypatch):
    cache, write = Cache(tmp_path), Path.write_text

    def half(path, text, **options):
        write(path, text[: len(text) // 2], **options)
        raise OSError(28, "No space left on device")

    assert cache.load_run("abcd") is None
    monkeypatch.setattr(Path, "write_text", half)
    with pytest.raises(WriteError, match="No space left on device"):
        cache.save_run("abcd", ROW)
    assert files_in(tmp_path) == []
    monkeypatch.undo()
    cache.save_run("abcd", ROW)
    assert cache.load_run("abcd") == ROW
    assert files_in(tmp_path) == ["abcd.json"]
    assert cache.size_bytes() == len(module.text_of_row(ROW))


def test_no_flipped_bit_of_a_row_goes_unseen():
    text = module.text_of_row(ROW).encode()
    assert module.row_of_text(text) == ROW
    for at in range(len(text)):
        for bit in range(8):
            read = module.row_of_text(flipped(text, at, bit))
            assert read in (None, ROW)  # 1e0 and 1E0 are one number
        assert module.row_of_text(text[:at]) is None


def test_a_damaged_row_is_moved_aside_and_said_once(tmp_path, capsys):
    cache = Cache(tmp_path)
    cache.save_run("abcd", ROW)
    (path,) = tmp_path.rglob("*.json")
    path.write_text(path.read_text().replace("0.3", "0.4"))
    assert [cache.load_run("abcd") for _ in range(2)] == [None, None]
    assert capsys.readouterr().err.count("was damaged: moved to") == 1
    assert [one.parent.name for one in tmp_path.rglob("*.json")] == [ASIDE]
    cache.save_run("abcd", ROW)
    assert cache.load_run("abcd") == ROW


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A recording in the cache in `tmp_path`, with its checksums."""
    made = tmp_path / "recordings" / "abcd"
    made.mkdir(parents=True)
    save_events_h5(made / "cam1.h5", np.empty(0, EVENT_DTYPE), 346, 260)
    (made / "rig.yaml").write_text("cam0:\n")
    module.save_sums(made)
    monkeypatch.setattr(Cache, "_recording_path", lambda *_: made)
    return made


@pytest.mark.parametrize(
    ("file", "damage"),
    [
        ("cam1.h5", lambda whole: flipped(whole, len(whole) // 2)),
        ("rig.yaml", None),
        ("../abcd.sha256", lambda _: b"[3"),
        ("../abcd.sha256", None),  # as after a run that was killed before it wrote them
    ],
)
def test_a_damaged_recording_is_made_again(folder, tmp_path, monkeypatch, capsys, file, damage):
    shutil.copytree(folder, tmp_path / "kept")
    calls = []

    def record(config, seed, out, provenance):
        calls.append(seed)
        shutil.copytree(tmp_path / "kept", out)

    monkeypatch.setattr(module, "record", record)
    whole = (folder / file).read_bytes()
    (folder / file).write_bytes(damage(whole)) if damage else (folder / file).unlink()
    for _ in range(2):
        assert Cache(tmp_path).recording_folder(SimConfig(), 3) == folder
    assert calls == [3]
    assert capsys.readouterr().err.count("was damaged") == 1


def test_an_entry_that_cannot_be_moved_is_one_error(folder, tmp_path):
    (folder / "rig.yaml").unlink()
    (tmp_path / ASIDE).write_text("a file in the folder's place")
    with pytest.raises(SsacError, match="is damaged and cannot be moved aside"):
        Cache(tmp_path).recording_folder(SimConfig(), 0)


def left_by(lock, old, new):
    """Write the lock of another process: ours, with `old` replaced by `new`; return its text."""
    with claimed(lock):
        mine = lock.read_text()
    assert mine.count(old) == 1
    lock.write_text(mine.replace(old, new))
    return lock.read_text()


def test_what_a_killed_process_held_is_free_at_once(tmp_path):
    lock, kept = tmp_path / "claims" / ".abc.claim", tmp_path / "claims" / ".kept.claim"
    left = left_by(lock, f"pid={os.getpid()}\n", f"pid={ended_process()}\n")
    with claimed(lock) as is_ours:
        assert is_ours
    # Locks that nobody asks for again are removed, also the empty one of a process killed early.
    for text in (left, ""):
        lock.write_text(text)
        with claimed(kept):
            remove_lapsed(lock.parent)
            assert list(lock.parent.iterdir()) == [kept]


def test_a_holder_elsewhere_keeps_it_until_it_is_silent_for_long(tmp_path, monkeypatch):
    lock, now_s = tmp_path / "claims" / ".abc.claim", 0.0
    monkeypatch.setattr(time, "monotonic", lambda: now_s)
    text = left_by(lock, socket.gethostname(), "elsewhere")  # its process id is in use here

    def is_free_after(share):
        nonlocal now_s
        now_s += share * module.LAPSES_S
        with claimed(lock) as is_ours:
            return is_ours

    assert [is_free_after(share) for share in (0.0, 0.9)] == [False, False]
    assert lock.read_text() == text
    os.utime(lock)  # a sign of life
    assert [is_free_after(share) for share in (0.9, 0.9, 0.2)] == [False, False, True]
    assert list(lock.parent.iterdir()) == []
