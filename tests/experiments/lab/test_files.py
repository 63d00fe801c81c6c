"""Files of results: their checksums as sha256sum reads them, and which code made them."""

import subprocess
from concurrent.futures import ThreadPoolExecutor

import pytest

from experiments.lab import provenance
from experiments.lab.results import SUMS_FILE, read_checksums, record_checksums, save_files, sha256
from ssac.errors import SsacError


def written(folder, name, text="1"):
    (folder / name).write_text(text)
    return folder / name


def test_a_file_and_its_provenance_are_noted_and_the_others_stay(tmp_path):
    (table,) = save_files(tmp_path, [("a.csv", b"1"), provenance.provenance_file("a.csv", {})])
    assert list(read_checksums(tmp_path)) == ["a.csv", "a.provenance.json"]
    subprocess.run(["sha256sum", "--check", SUMS_FILE], cwd=tmp_path, check=True)
    before = read_checksums(tmp_path)["a.csv"]
    written(tmp_path, "a.csv", "2")  # by hand
    record_checksums(tmp_path, [written(tmp_path, "b.png", "3")])
    assert read_checksums(tmp_path)["a.csv"] == before != sha256(table)
    table.unlink()
    save_files(tmp_path, [("b.png", None)])
    assert list(read_checksums(tmp_path)) == ["a.provenance.json"]


def test_commands_that_write_at_once_lose_no_note(tmp_path):
    paths = [written(tmp_path, f"{number}.csv") for number in range(40)]
    with ThreadPoolExecutor(8) as pool:
        list(pool.map(lambda path: record_checksums(tmp_path, [path]), paths))
    assert set(read_checksums(tmp_path)) == {path.name for path in paths}


@pytest.mark.parametrize("line", ["abc  a.csv", "0" * 64 + " a.csv", "0" * 64 + "  ", ""])
def test_a_line_that_is_none_is_an_error(tmp_path, line):
    written(tmp_path, SUMS_FILE, f"{'0' * 64}  a.csv\n{line}\n")
    with pytest.raises(SsacError, match="line 2 is no digest and name"):
        read_checksums(tmp_path)
    with pytest.raises(SsacError, match="cannot be read"):
        read_checksums(tmp_path / "none")


def test_changed_code_makes_the_commit_dirty_and_results_do_not(tmp_path, monkeypatch):
    monkeypatch.setattr(provenance, "ROOT", tmp_path)
    monkeypatch.setenv("GIT_CEILING_DIRECTORIES", str(tmp_path.parent))
    assert provenance.code_commit() == "unknown"

    (tmp_path / "results").mkdir()
    for name in ("code.py", "results/table.csv"):
        written(tmp_path, name)
    git = "git -c user.name=a -c user.email=a@b -c commit.gpgsign=false"
    for words in ("init -q", "add .", "commit -q -m x"):
        subprocess.run(f"{git} {words}".split(), cwd=tmp_path, check=True)
    commit = provenance.code_commit()
    assert len(commit) == 12
    for name in ("results/table.csv", "untracked.txt"):
        written(tmp_path, name, "2")
    assert provenance.code_commit() == commit
    written(tmp_path, "code.py", "2")
    assert provenance.code_commit() == f"{commit}-dirty"
    monkeypatch.setattr(provenance, "ROOT", tmp_path / "results")  # within another's repository
    assert provenance.code_commit() == "unknown"
