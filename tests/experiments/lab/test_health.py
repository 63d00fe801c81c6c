"""Entries of the cache that are no longer what was written: seen, moved aside, made again."""

import shutil

import numpy as np
import pytest

from experiments.lab.cache import Brightness, Cache
from experiments.lab.health import ASIDE, is_sound, row_of_text, save_sums, text_of_row
from ssac.errors import SsacError
from ssac.files.hdf5 import save_events_h5
from tests.recorded import empty_events

ROW = {"status": "ok", "reason": "", "t_d_error_ms": 0.1 + 0.2, "r_error_deg": None}


def flipped(data: bytes, at: int) -> bytes:
    return data[:at] + bytes([data[at] ^ 1]) + data[at + 1 :]


def test_no_flipped_bit_of_a_row_goes_unseen():
    text = text_of_row(ROW).encode()
    assert row_of_text(text) == ROW
    for at in range(len(text)):
        assert row_of_text(flipped(text, at)) in (None, ROW)  # 1e0 and 1E0 are one number
        assert row_of_text(text[:at]) is None


def test_a_damaged_row_is_moved_aside_and_said_once(tmp_path, capsys):
    cache = Cache(tmp_path)
    cache.save_run("abcd", ROW)
    (path,) = tmp_path.rglob("*.json")
    path.write_text(path.read_text().replace("0.3", "0.4"))
    assert cache.load_run("abcd") is None
    assert cache.load_run("abcd") is None
    assert capsys.readouterr().err.count("was damaged: moved to") == 1
    assert [one.parent.name for one in tmp_path.rglob("*.json")] == [ASIDE]
    cache.save_run("abcd", ROW)
    assert cache.load_run("abcd") == ROW


@pytest.fixture
def folder(tmp_path):
    made = tmp_path / "recordings" / "abcd"
    made.mkdir(parents=True)
    save_events_h5(made / "cam1.h5", empty_events(), 346, 260)
    (made / "rig.yaml").write_text("cam0:\n")
    return made


def test_a_recording_is_what_its_checksums_say(folder):
    save_sums(folder)
    assert is_sound(folder)
    whole = (folder / "cam1.h5").read_bytes()
    (folder / "cam1.h5").write_bytes(flipped(whole, len(whole) // 2))
    assert not is_sound(folder)
    assert is_sound(folder, ("rig.yaml",))
    (folder / "cam1.h5").write_bytes(whole)
    assert is_sound(folder)
    (folder / "rig.yaml").unlink()
    assert not is_sound(folder)
    assert not is_sound(folder, ("rig.yaml",))


def test_a_recording_without_checksums_is_given_some_if_it_can_be_read(folder):
    whole = (folder / "cam1.h5").read_bytes()
    (folder / "cam1.h5").write_bytes(whole[:500])
    assert not is_sound(folder)
    (folder / "cam1.h5").write_bytes(whole)
    assert is_sound(folder)
    assert folder.with_name("abcd.sha256").is_file()


def test_a_damaged_recording_is_made_again(folder, monkeypatch, capsys):
    cache = Cache(folder.parents[1])
    monkeypatch.setattr(Cache, "_recording_path", lambda *_: folder)
    kept = folder.parents[1] / "kept"
    shutil.copytree(folder, kept)
    calls = []

    def record(config, seed, out, provenance):
        calls.append(seed)
        shutil.copytree(kept, out)

    monkeypatch.setattr("experiments.lab.cache.record", record)
    save_sums(folder)
    (folder / "rig.yaml").write_text("cam1:\n")
    assert cache.recording_folder(_config(), 3) == folder
    assert calls == [3]
    assert is_sound(folder)
    assert capsys.readouterr().err.count("was damaged") == 1
    assert cache.recording_folder(_config(), 3) == folder
    assert calls == [3]


def _config():
    from sim.recording import SimConfig

    return SimConfig()


def test_damaged_brightness_is_measured_again(tmp_path):
    cache = Cache(tmp_path)
    means = Brightness(np.linspace(0, 1, 9), np.arange(9), np.empty(0), np.empty(0, np.int64))
    recording = tmp_path / "recordings" / "abcd"
    cache.brightness(recording, lambda: means)
    (path,) = (tmp_path / "brightness").iterdir()
    whole = path.read_bytes()
    for damaged in (whole[: len(whole) // 2], flipped(whole, 200), b""):
        path.write_bytes(damaged)
        for kept, made in zip(cache.brightness(recording, lambda: means), means, strict=True):
            np.testing.assert_array_equal(kept, made)
        assert path.read_bytes() == whole


def test_an_entry_that_cannot_be_moved_is_one_error(folder, monkeypatch):
    save_sums(folder)
    (folder / "rig.yaml").unlink()
    (folder.parents[1] / ASIDE).write_text("a file in the folder's place")
    monkeypatch.setattr(Cache, "_recording_path", lambda *_: folder)
    with pytest.raises(SsacError, match="is damaged and cannot be moved aside"):
        Cache(folder.parents[1]).recording_folder(_config(), 0)
