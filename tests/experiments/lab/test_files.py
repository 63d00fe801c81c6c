"""Checksums of results: as sha256sum reads them, kept for files that were not written again."""

import subprocess
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from experiments.lab.files import SUMS_FILE, read_checksums, record_checksums, sha256
from ssac.errors import SsacError


def written(folder: Path, name: str, text: str) -> Path:
    path = folder / name
    path.write_text(text)
    return path


def test_a_file_and_its_provenance_are_noted_and_the_others_stay(tmp_path: Path) -> None:
    table = written(tmp_path, "a.csv", "1")
    written(tmp_path, "a.provenance.json", "{}")
    record_checksums(tmp_path, [table])
    assert list(read_checksums(tmp_path)) == ["a.csv", "a.provenance.json"]
    before = read_checksums(tmp_path)["a.csv"]
    written(tmp_path, "a.csv", "2")  # by hand
    record_checksums(tmp_path, [written(tmp_path, "b.png", "3")])
    assert read_checksums(tmp_path)["a.csv"] == before != sha256(table)
    table.unlink()
    record_checksums(tmp_path, [tmp_path / "b.png"])
    assert "a.csv" not in read_checksums(tmp_path)


def test_sha256sum_takes_them(tmp_path: Path) -> None:
    record_checksums(tmp_path, [written(tmp_path, name, name) for name in ("b", "a")])
    done = subprocess.run(
        ["sha256sum", "--check", SUMS_FILE], cwd=tmp_path, capture_output=True, check=False
    )
    assert done.returncode == 0


def test_commands_that_write_at_once_lose_no_note(tmp_path: Path) -> None:
    paths = [written(tmp_path, f"{number}.csv", str(number)) for number in range(40)]
    with ThreadPoolExecutor(8) as pool:
        list(pool.map(lambda path: record_checksums(tmp_path, [path]), paths))
    assert set(read_checksums(tmp_path)) == {path.name for path in paths}


@pytest.mark.parametrize("line", ["abc  a.csv", "0" * 64 + " a.csv", "0" * 64 + "  ", ""])
def test_a_line_that_is_none_is_an_error(tmp_path: Path, line: str) -> None:
    written(tmp_path, SUMS_FILE, f"{'0' * 64}  a.csv\n{line}\n")
    with pytest.raises(SsacError, match="line 2 is no digest and name"):
        read_checksums(tmp_path)
    with pytest.raises(SsacError, match="cannot be read"):
        read_checksums(tmp_path / "none")
