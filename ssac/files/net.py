"""A block that reads a file in; whatever a library raises in it out, as one error of ours."""

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from ssac.errors import SsacError

_LONGEST = 200  # letters of a library's own words

_OURS = (SsacError, KeyboardInterrupt, SystemExit, GeneratorExit)


def check_is_file(path: Path) -> None:
    """Raise SsacError when there is no such file."""
    if not path.is_file():
        raise SsacError(f"{path}: there is no such file: check the path")


@contextmanager
def readable(path: Path, kind: str) -> Iterator[None]:
    """Turn whatever the block raises into one SsacError, but for our own errors and interrupts.

    Libraries raise more than they document: KeyError and RuntimeError from damaged HDF5,
    MemoryError from a size that is nonsense, RecursionError from nested YAML, and, compiled from
    Rust, panics that are no Exception at all.

    Parameters
    ----------
    path
        That the block reads.
    kind
        What it is to be: "a readable HDF5 file".
    """
    try:
        yield
    except _OURS:
        raise
    except BaseException as error:
        raise SsacError(f"{path}: not {kind} ({brief(error)}): copy or record it again") from error


def brief(error: BaseException) -> str:
    """Say in a few words of one line what a library raised."""
    words = " ".join(str(error).split()) or type(error).__name__
    return words if len(words) <= _LONGEST else f"{words[:_LONGEST]}..."


@contextmanager
def silenced() -> Iterator[None]:
    """Keep what compiled code writes to stderr from it: a panic prints lines of its own.

    Python's own output is not held back for long: nothing else is to run in the block.
    """
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
