"""A path in; a file that appears under it only when it is complete, and not over an input."""

import os
import resource
import shutil
from collections.abc import Collection, Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from ssac.errors import SsacError, WriteError
from ssac.files.temporary import temporary_path

LEAST_FREE_BYTES = 1 << 20
"""Less space than that is a full disk: results are smaller, but there are several."""


def check_target(output: Path, inputs: Iterable[Path]) -> None:
    """Raise SsacError, before any work is done, unless a file can be written and is no input."""
    if output.is_dir() or not output.parent.is_dir():
        raise SsacError(f"{output}: not a file in a folder that exists: name another")
    if any(output.exists() and path.exists() and output.samefile(path) for path in inputs):
        raise SsacError(f"{output}: is one of the inputs and would be lost: name another file")
    check_writable(output)


def check_targets(outputs: Iterable[Path | None], inputs: Collection[Path]) -> None:
    """Check each output, but for None, as `check_target` does, and that no two are one file."""
    named: set[Path] = set()
    for output in outputs:
        if output is None:
            continue
        check_target(output, inputs)
        if output.resolve() in named:
            raise SsacError(f"{output}: is named for two outputs: name a file for each")
        named.add(output.resolve())


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Give a temporary name in the same folder to write to; rename it to `path` at the end.

    If the block fails, the temporary file is removed and whatever was at `path` stays as it was.

    Raises
    ------
    WriteError
        If it cannot be written, as on a full disk. The message names `path`.
    """
    temporary = temporary_path(path)
    try:
        yield temporary
        os.replace(temporary, path)
    except OSError as error:
        if error.filename is not None and str(error.filename) != str(temporary):
            raise  # about another file
        raise WriteError(
            f"{path}: could not be written ({error.strerror or ' '.join(str(error).split())}): "
            "make room, or name another place"
        ) from error
    finally:
        with suppress(OSError):  # of a disk that is gone
            temporary.unlink(missing_ok=True)


def check_writable(path: Path, n_bytes: int = 0) -> None:
    """Raise WriteError, before any work is done, when a file could not be written.

    Parameters
    ----------
    path
        Of the file; its folder may have to be made.
    n_bytes
        Its size, where that is known.
    """
    if path.is_dir():
        raise WriteError(f"{path}: is a folder: name a file to write")
    check_folder(path.parent, n_bytes)


def check_folder(folder: Path, n_bytes: int = 0) -> None:
    """Raise WriteError when files could not be written into a folder, which may have to be made."""
    there = folder.absolute()
    while not there.exists():
        there = there.parent
    if not there.is_dir():
        raise WriteError(f"{folder}: {there} is a file: name a folder")
    if not os.access(there, os.W_OK | os.X_OK):
        raise WriteError(f"{folder}: {there} cannot be written to: name another place")
    free, needed = shutil.disk_usage(there).free, max(n_bytes, LEAST_FREE_BYTES)
    if free < needed:
        raise WriteError(
            f"{folder}: {free} bytes are free on this disk, and {needed} are needed: make room, or "
            "name another place"
        )
    limit = resource.getrlimit(resource.RLIMIT_FSIZE)[0]
    if limit != resource.RLIM_INFINITY and limit < needed:
        raise WriteError(
            f"{folder}: files may have {limit} bytes here, and {needed} are needed: raise the limit"
            " (ulimit -f)"
        )
