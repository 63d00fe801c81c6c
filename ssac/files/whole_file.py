"""Files that appear under their names only when they are complete, and never over an input.

They are written under a temporary name in the same folder, .NAME.HOST.PROCESS.RANDOM.part, so that
what a killed process left behind can be told from what another one is just writing, and be removed.
`sim.storage` gives folders such names.
"""

import glob
import os
import platform
import re
import shutil
import time
from collections.abc import Collection, Iterable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from hashlib import sha256
from pathlib import Path

from ssac.errors import SsacError, WriteError

FIGURE_SUFFIXES = (".png", ".pdf", ".svg")

LEFT_OVER_S = 86_400.0
"""Time without a write after which a temporary file of another host counts as left over."""

_MADE = re.compile(r"\..*\.(?P<host>[A-Za-z0-9-]+)\.(?P<process>\d+)\.[0-9a-f]{32}\.[a-z]+", re.S)

_NAME_LENGTH = 32  # letters kept, of up to 4 bytes each: a file's name has 255 bytes at most


def check_targets(outputs: Iterable[Path | None], inputs: Collection[Path]) -> None:
    """Raise SsacError unless each output can be written: none is an input, and no two one file."""
    named: set[Path] = set()
    for output in outputs:
        if output is None:
            continue
        if output.is_dir() or not output.parent.is_dir():
            raise SsacError(f"{output}: not a file in a folder that exists: name another")
        if any(output.exists() and path.exists() and output.samefile(path) for path in inputs):
            raise SsacError(f"{output}: is one of the inputs and would be lost: name another file")
        check_writable(output)
        if output.resolve() in named:
            raise SsacError(f"{output}: is named for two outputs: name a file for each")
        named.add(output.resolve())


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Give a temporary name in the same folder to write to; rename it to `path` at the end.

    If the block fails, the temporary file is removed and whatever was at `path` stays as it was.
    WriteError, which names `path`, if it cannot be written, as on a full disk.
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


def write_whole(path: Path, text: str) -> None:
    """Write a file of text as `whole_file` does."""
    with whole_file(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def check_writable(path: Path, n_bytes: int = 0) -> None:
    """Raise WriteError, before any work is done, when a file of so many bytes cannot be written."""
    if path.is_dir():
        raise WriteError(f"{path}: is a folder: name a file to write")
    check_folder(path.parent, n_bytes)


def check_folder(folder: Path, n_bytes: int = 0) -> None:
    """Raise WriteError if files could not be written into a folder, which need not exist yet."""
    there = folder.absolute()
    while not there.exists():
        there = there.parent
    if not there.is_dir():
        raise WriteError(f"{folder}: {there} is a file: name a folder")
    if not os.access(there, os.W_OK | os.X_OK):
        raise WriteError(f"{folder}: {there} cannot be written to: name another place")
    # Less than a megabyte is a full disk: results are smaller, but there are several.
    free, needed = shutil.disk_usage(there).free, max(n_bytes, 1 << 20)
    if free < needed:
        raise WriteError(
            f"{folder}: {free} bytes are free on this disk, and {needed} are needed: make room, or "
            "name another place"
        )


@cache
def host() -> str:
    """Name the scope in which a process id is unique: a machine since its boot, or a container."""
    node = platform.node()
    place = [node]
    with suppress(OSError):  # not Linux
        place.append(Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii"))
    with suppress(OSError):
        place.append(os.readlink("/proc/self/ns/pid"))
    name = re.sub(r"[^A-Za-z0-9-]", "-", node)[:20]
    return f"{name}-{sha256(repr(place).encode()).hexdigest()[:8]}"


def temporary_path(path: Path) -> Path:
    """Return a temporary path in the same folder, unique among all processes of all hosts."""
    name, maker = path.name[:_NAME_LENGTH], f"{host()}.{os.getpid()}"
    return path.with_name(f".{name}.{maker}.{os.urandom(16).hex()}.part")


def is_left_over(path: Path) -> bool:
    """Whether a path is a temporary one of ours that no process writes to any more.

    On this host the process that made it has ended; of other hosts only the last write is known.
    """
    made = _MADE.fullmatch(path.name)
    if made is None:
        return False
    if made["host"] != host():
        return _idle_s(path) > LEFT_OVER_S
    return not _runs(int(made["process"]))


def remove_left_over(folder: Path, name: str = "") -> None:
    """Remove left-over temporary files and folders from a folder, or only those made for a name."""
    prefix = f".{glob.escape(name[:_NAME_LENGTH])}." if name else "."
    for path in folder.glob(f"{prefix}*"):
        if not is_left_over(path):
            continue
        with suppress(OSError):  # another one was faster
            if path.is_dir():
                shutil.rmtree(path)
            else:
                path.unlink()


def _idle_s(path: Path) -> float:
    """Time since a file, or anything in a folder, was written [s]; 0 when it is gone."""
    try:
        return time.time() - max(one.stat().st_mtime for one in (path, *path.rglob("*")))
    except OSError:
        return 0.0


def _runs(process: int) -> bool:
    """Whether the process of this host with this id has not ended."""
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:  # somebody else's
        return True
    try:  # a process that has ended keeps its id until its parent waits for it
        state = Path(f"/proc/{process}/stat").read_text(encoding="utf-8", errors="replace")
    except OSError:  # another system, or it has ended just now
        return True
    return state.rpartition(")")[2].split()[0] not in ("Z", "X")
