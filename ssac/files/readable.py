"""Unreadable files: each exception of a library becomes an SsacError that names the file."""

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from ssac.errors import SsacError

_OURS = (SsacError, KeyboardInterrupt, SystemExit, GeneratorExit)


def check_is_file(path: Path) -> None:
    """Raise SsacError when there is no such file."""
    if not path.is_file():
        raise SsacError(f"{path}: there is no such file: check the path")


@contextmanager
def readable(path: Path, kind: str) -> Iterator[None]:
    """Turn whatever a library raises in the block, even a panic, into one SsacError.

    `kind` says what the file should be, as in "a readable HDF5 file".
    """
    try:
        yield
    except _OURS:
        raise
    except BaseException as error:
        raise SsacError(f"{path}: not {kind} ({brief(error)}): copy or record it again") from error


def brief(error: BaseException, longest: int = 200) -> str:
    """Return an exception's message on one line, cut to `longest` characters."""
    if isinstance(error, MemoryError):  # of a library that believes a size it reads
        return "a size in it is larger than the memory here"
    words = " ".join(str(error).split()) or type(error).__name__
    return words if len(words) <= longest else f"{words[:longest]}..."


@contextmanager
def silenced() -> Iterator[None]:
    """Discard what compiled code writes to stderr in the block, as a panic prints its own lines."""
    try:
        kept = os.dup(2)
    except OSError:  # there is no stderr
        yield
        return
    try:
        with suppress(OSError), open(os.devnull, "wb") as nowhere:
            os.dup2(nowhere.fileno(), 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)


def check_text(path: Path) -> None:
    """Raise SsacError if a file has a zero byte, which a text reader takes for the file's end."""
    with readable(path, "a readable file"), path.open("rb") as file:
        while block := file.read(1 << 22):
            at = block.find(b"\0")
            if at >= 0:
                raise SsacError(
                    f"{path}: not a text file: byte {file.tell() - len(block) + at} is zero, as "
                    "where a disk was full or a copy broke off: copy or record it again"
                )


def is_number(word: str) -> bool:
    """Return whether `float` can parse a word."""
    try:
        float(word)
    except ValueError:
        return False
    return True


def side_px(value: Any, said: str, path: Path) -> int:
    """Return a sensor's width or height [px] that a file states; SsacError, with `said`, if bad."""
    most = (1 << 16) - 1  # largest value of an event's field x or y
    try:
        side = int(value)
    except (TypeError, ValueError, OverflowError):
        side = 0
    if not 1 <= side <= most:
        raise SsacError(
            f"{path}: {said} 1 to {most} px, got {str(value)[:40]!r}: correct it, or leave it out"
        )
    return side
