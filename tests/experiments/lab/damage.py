"""Damages to a file of results, each of which must be found."""

import re
from pathlib import Path

_NUMBER = re.compile(r"(?<![\w.])\d+\.\d+(?![\w.])|(?<![\w.])\d+(?![\w.])")


def delete(path: Path) -> None:
    path.unlink()


def double_a_number(path: Path) -> None:
    """Double the last number that doubling changes."""
    text = path.read_text(encoding="utf-8")
    last = [found for found in _NUMBER.finditer(text) if float(found.group()) != 0.0][-1]
    doubled = f"{2.0 * float(last.group()):.6g}"
    path.write_text(text[: last.start()] + doubled + text[last.end() :], encoding="utf-8")


def change_a_status(path: Path) -> None:
    """Let the last run that is "ok" have no match."""
    before, ok, after = path.read_text(encoding="utf-8").rpartition(",ok,")
    assert ok
    path.write_text(f"{before},no_match,{after}", encoding="utf-8")


def delete_a_row(path: Path) -> None:
    lines = path.read_text(encoding="utf-8").splitlines(keepends=True)
    path.write_text("".join([*lines[:-2], lines[-1]]), encoding="utf-8")


def double_a_row(path: Path) -> None:
    lines = path.read_text(encoding="utf-8").splitlines(keepends=True)
    path.write_text("".join([*lines, lines[-1]]), encoding="utf-8")


def flip_a_byte(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(bytes(content))


DAMAGES = (delete, delete_a_row, double_a_row, double_a_number)
"""Of a table or page: a row is gone, is there twice, or has another number."""
