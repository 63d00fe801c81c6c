"""What cannot be written is said before work begins, or in one line that names the file."""

import errno
import os
import resource
from types import SimpleNamespace

import pytest

from ssac.errors import SsacError, WriteError
from ssac.files import whole_file as module
from ssac.files.whole_file import check_folder, check_targets, check_writable, whole_file


def test_a_place_that_will_be_made_can_be_written_to(tmp_path):
    check_writable(tmp_path / "new" / "deeper" / "out.csv")
    assert list(tmp_path.iterdir()) == []


def test_what_cannot_be_a_file_is_refused_before_any_work(tmp_path, monkeypatch):
    (tmp_path / "file").touch()
    with pytest.raises(WriteError, match=f"{tmp_path}: is a folder: name a file to write"):
        check_writable(tmp_path)
    with pytest.raises(WriteError, match="/file is a file: name a folder"):
        check_writable(tmp_path / "file" / "out.csv")
    monkeypatch.setattr(module.os, "access", lambda *_: False)  # tests may run as root
    with pytest.raises(WriteError, match="cannot be written to: name another place"):
        check_writable(tmp_path / "out.csv")


def test_two_outputs_are_not_one_file(tmp_path):
    check_targets((tmp_path / "one.txt", None, tmp_path / "two.txt", None), ())
    same = tmp_path / "one.txt", tmp_path.joinpath("..", tmp_path.name, "one.txt")
    with pytest.raises(SsacError, match=r"one\.txt: is named for two outputs"):
        check_targets(same, ())


def test_a_disk_without_room_is_refused_before_any_work(tmp_path, monkeypatch):
    monkeypatch.setattr(module.shutil, "disk_usage", lambda _: SimpleNamespace(free=5_000_000))
    check_folder(tmp_path, 5_000_000)
    with pytest.raises(WriteError, match="5000000 bytes are free on this disk, and 5000001 are"):
        check_folder(tmp_path, 5_000_001)


def test_a_limit_of_files_sizes_counts_as_room(tmp_path, monkeypatch):
    monkeypatch.setattr(module.resource, "getrlimit", lambda _: (10_000, resource.RLIM_INFINITY))
    with pytest.raises(WriteError, match=r"files may have 10000 bytes here, .* raise the limit"):
        check_folder(tmp_path)


@pytest.mark.parametrize("has_name", [True, False])
def test_a_disk_that_runs_full_is_one_line_and_leaves_what_was_there(tmp_path, has_name):
    path = tmp_path / "out.csv"
    path.write_text("before")

    def write():
        with whole_file(path) as temporary:
            temporary.write_text("half of it")
            name = str(temporary) if has_name else None
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), name)

    with pytest.raises(WriteError, match=r"out\.csv: could not be written \(No space left on dev"):
        write()
    assert [one.name for one in tmp_path.iterdir()] == ["out.csv"]
    assert path.read_text() == "before"


def test_an_error_about_another_file_stays_what_it_is(tmp_path):
    def write():
        with whole_file(tmp_path / "out.csv"):
            (tmp_path / "in.csv").read_text()

    with pytest.raises(FileNotFoundError, match=r"in\.csv"):
        write()
