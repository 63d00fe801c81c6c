"""Files are written whole or not at all, and what a killed process leaves is recognised."""

import errno
import os
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import pytest

from sim.storage import partial_path
from ssac.errors import WriteError
from ssac.files import whole_file
from tests.left_over import ELSEWHERE, ended_process, let_lie, made_by


def test_no_name_is_given_twice_and_each_tells_its_maker(tmp_path):
    paths = [whole_file.temporary_path(tmp_path / "a.csv") for _ in range(100)]
    # The simulator's names say the same, by code of its own: neither package imports the other.
    paths += [partial_path(tmp_path, "recording") for _ in range(2)]
    assert len(set(paths)) == 102
    assert all(f".{whole_file.host()}.{os.getpid()}." in path.name for path in paths)
    assert {path.parent for path in paths} == {tmp_path}


@pytest.mark.parametrize("name", ["a" * 250 + ".csv", "\N{SNOWMAN}" * 80])  # 240 bytes
def test_long_names_have_temporary_ones_too(tmp_path, name):
    with whole_file.whole_file(tmp_path / name) as path:
        path.write_text("whole")
    assert [path.name for path in tmp_path.iterdir()] == [name]


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="told by Linux' /proc")
def test_a_process_that_nobody_asked_how_it_ended_has_ended(tmp_path):
    process = subprocess.Popen([sys.executable, "-c", ""], stdout=subprocess.PIPE)
    process.stdout.read()  # until it ends; its process id stays until we wait for it
    path = made_by(tmp_path / "a", process.pid)
    while not whole_file.is_left_over(path):
        time.sleep(0.01)  # its pipes close just before it ends
    process.wait()


def test_on_another_host_time_decides(tmp_path):
    folder = made_by(tmp_path / "recording", ended_process(), ELSEWHERE)
    folder.mkdir()
    (folder / "cam1.h5").touch()
    assert not whole_file.is_left_over(folder)
    let_lie(folder, whole_file.LEFT_OVER_S + 60.0)
    assert whole_file.is_left_over(folder)
    (folder / "cam1.h5").write_text("still at it")  # the folder's own time stays as it is
    assert not whole_file.is_left_over(folder)


def test_only_what_is_left_over_is_removed(tmp_path):
    ended = ended_process()
    folder = made_by(tmp_path / "recording", ended)
    folder.mkdir()
    (folder / "cam1.h5").touch()
    file = made_by(tmp_path / "run.json", ended)
    file.touch()
    mine = whole_file.temporary_path(tmp_path / "recording")
    elsewhere = made_by(tmp_path / "recording", ended, ELSEWHERE)
    kept = {mine, elsewhere, tmp_path / f".recording.{ended}.partial", tmp_path / "recording"}
    for path in kept:
        path.mkdir()
    let_lie(mine, 10 * whole_file.LEFT_OVER_S)  # on this host the process alone decides
    whole_file.remove_left_over(tmp_path, "recording")
    assert set(tmp_path.iterdir()) == {*kept, file}
    whole_file.remove_left_over(tmp_path)
    assert set(tmp_path.iterdir()) == kept
    whole_file.remove_left_over(tmp_path / "none")


# --- What cannot be written ---


def test_what_cannot_be_a_file_is_refused_before_any_work(tmp_path, monkeypatch):
    whole_file.check_writable(tmp_path / "new" / "deeper" / "out.csv")
    assert list(tmp_path.iterdir()) == []  # a folder that is lacking will be made
    (tmp_path / "file").touch()
    with pytest.raises(WriteError, match=f"{tmp_path}: is a folder: name a file to write"):
        whole_file.check_writable(tmp_path)
    with pytest.raises(WriteError, match="/file is a file: name a folder"):
        whole_file.check_writable(tmp_path / "file" / "out.csv")
    monkeypatch.setattr(whole_file.shutil, "disk_usage", lambda _: SimpleNamespace(free=5_000_000))
    whole_file.check_folder(tmp_path, 5_000_000)
    with pytest.raises(WriteError, match="5000000 bytes are free on this disk, and 5000001 are"):
        whole_file.check_folder(tmp_path, 5_000_001)
    monkeypatch.setattr(whole_file.os, "access", lambda *_: False)  # tests may run as root
    with pytest.raises(WriteError, match="cannot be written to: name another place"):
        whole_file.check_writable(tmp_path / "out.csv")


def test_what_is_there_and_is_no_file_is_refused_and_stays(tmp_path):
    pipe, loop = tmp_path / "pipe", tmp_path / "loop"
    os.mkfifo(pipe)
    loop.symlink_to(loop)
    (tmp_path / "link").symlink_to(pipe)
    for path in (pipe, loop, tmp_path / "link", Path("/dev/stdout"), Path("/proc/self/fd/1")):
        said = f"{path}: expected a regular file or a new name, got a device"
        with pytest.raises(WriteError, match=said):
            whole_file.check_targets([path], [])
        with pytest.raises(WriteError, match=said):
            whole_file.write_whole(path, "")
    assert pipe.is_fifo()
    assert loop.is_symlink()


def test_through_a_link_its_file_is_written(tmp_path):
    (tmp_path / "folder").mkdir()
    link, file = tmp_path / "out.csv", tmp_path / "folder" / "file.csv"
    link.symlink_to(Path("folder") / "file.csv")
    for text in ("first", "again"):  # while the file is not there yet, and when it is
        whole_file.check_targets([link], [])
        whole_file.write_whole(link, text)
        assert link.is_symlink()
        assert file.read_text() == text
        assert [one.name for one in file.parent.iterdir()] == ["file.csv"]


@pytest.mark.parametrize("has_name", [True, False])
def test_a_disk_that_runs_full_is_one_line_and_leaves_what_was_there(tmp_path, has_name):
    path = tmp_path / "out.csv"
    path.write_text("before")

    def write():
        with whole_file.whole_file(path) as temporary:
            temporary.write_text("half of it")
            name = str(temporary) if has_name else None
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), name)

    with pytest.raises(WriteError, match=r"out\.csv: could not be written \(No space left on dev"):
        write()
    assert [one.name for one in tmp_path.iterdir()] == ["out.csv"]
    assert path.read_text() == "before"


def test_an_error_about_another_file_stays_what_it_is(tmp_path):
    with (
        pytest.raises(FileNotFoundError, match=r"in\.csv"),
        whole_file.whole_file(tmp_path / "out.csv"),
    ):
        (tmp_path / "in.csv").read_text()
