"""Files that appear under their names only when they are complete, and never over an input.

They are written under a temporary name in the same folder, .NAME.HOST.PROCESS.RANDOM.part. By it, a
file that a killed process left behind can be told from one that is being written, and be removed.
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

# Of pictures that are not written; a name that ends so is not meant as a folder's.
_OTHER_PICTURES = (".bmp", ".eps", ".gif", ".jpeg", ".jpg", ".ps", ".tif", ".tiff", ".webp")

LEFT_OVER_S = 86_400.0
"""Time since the last write after which a temporary file of another host counts as left over."""

_MADE = re.compile(r"\..*\.(?P<host>[A-Za-z0-9-]+)\.(?P<process>\d+)\.[0-9a-f]{32}\.[a-z]+", re.S)

_OPEN = re.compile("/proc/|/dev/(fd/|std)")

_NAME_LENGTH = 32  # characters kept, of up to 4 bytes each: file names have at most 255 bytes


def check_targets(outputs: Iterable[Path | None], inputs: Collection[Path]) -> None:
    """Raise SsacError unless each output can be written, is no input and is named only once."""
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


def check_figures(folder: Path) -> None:
    """Raise SsacError unless figures can be written into a folder, and it is meant as one."""
    fault, kinds = "", ", ".join(FIGURE_SUFFIXES)
    if folder.exists() and not folder.is_dir():
        fault = "exists and is no folder"
    elif folder.suffix.lower() in _OTHER_PICTURES:
        fault = f"cannot write the extension {folder.suffix!r}"
    if fault:
        raise SsacError(f"{folder}: {fault}: name a folder, or a file ending in {kinds}")
    check_folder(folder)


def numbered_file(path: Path, number: int | str) -> Path:
    """Name one of several files that are written in place of one: out.png -> out-1-2.png."""
    return path.with_name(f"{path.stem}-{number}{path.suffix}")


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Yield a temporary path in the same folder to write to; rename that file to `path` at the end.

    A symbolic link at `path` stays, and the file to which it leads is written. If the block fails,
    the temporary file is removed and whatever was at `path` stays as it was. WriteError, which
    names `path`, if the file cannot be written, as on a full disk.
    """
    target = _target(path)
    temporary = temporary_path(target)
    try:
        yield temporary
        os.replace(temporary, target)
    except OSError as error:
        if error.filename is not None and str(error.filename) != str(temporary):
            raise  # the error is about another file
        raise WriteError(
            f"{path}: could not be written ({error.strerror or ' '.join(str(error).split())}): "
            "make room, or name another place"
        ) from error
    finally:
        with suppress(OSError):  # the disk may be gone
            temporary.unlink(missing_ok=True)


def write_whole(path: Path, text: str) -> None:
    """Write text as `whole_file` does; surrogates of file names become backslash escapes."""
    with whole_file(path) as temporary:
        temporary.write_text(text, encoding="utf-8", errors="backslashreplace")


def check_writable(path: Path, n_bytes: int = 0) -> None:
    """Raise WriteError, before any work is done, if a file of `n_bytes` cannot be written."""
    check_folder(_target(path).parent, n_bytes)


def _target(path: Path) -> Path:
    """Return the file to write, past symbolic links; WriteError if something else is there."""
    target = Path(os.path.realpath(path)) if path.is_symlink() else path
    if path.is_dir():
        raise WriteError(f"{path}: is a folder: name a file to write")
    is_open = _OPEN.match(str(path.absolute()))  # /dev/stdout may lead to a file that others write
    if is_open or (path.exists() and not path.is_file()) or target.is_symlink():  # to itself
        raise WriteError(
            f"{path}: expected a regular file or a new name, got a device, a pipe, a socket or a "
            "link that leads to itself: name a file to write"
        )
    return target


def check_folder(folder: Path, n_bytes: int = 0) -> None:
    """Raise WriteError if files could not be written into a folder, which need not exist yet."""
    there = folder.absolute()
    while not there.exists():
        there = there.parent
    if not there.is_dir():
        raise WriteError(f"{folder}: {there} is a file: name a folder")
    if not os.access(there, os.W_OK | os.X_OK):
        raise WriteError(f"{folder}: {there} cannot be written to: name another place")
    # A disk with under a megabyte free counts as full: results are smaller, but there are several.
    free, needed = shutil.disk_usage(there).free, max(n_bytes, 1 << 20)
    if free < needed:
        raise WriteError(
            f"{folder}: {free} bytes are free on this disk, and {needed} are needed: make room, or "
            "name another place"
        )


@cache
def host() -> str:
    """Name the scope in which process ids are unique: a machine since its boot, or a container."""
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
    """Whether a path is a temporary path of this package to which no process writes.

    The process that made it has ended or, on another host, has written nothing for `LEFT_OVER_S`.
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
        with suppress(OSError):  # another process removed it first
            if path.is_dir():
                shutil.rmtree(path)
            else:
                path.unlink()


def _idle_s(path: Path) -> float:
    """Return the time [s] since a file, or anything in a folder, was written; 0 if it is gone."""
    try:
        return time.time() - max(one.stat().st_mtime for one in (path, *path.rglob("*")))
    except OSError:
        return 0.0


def _runs(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:  # the process of another user
        return True
    try:  # a process that has ended keeps its id until its parent waits for it
        state = Path(f"/proc/{process}/stat").read_text(encoding="utf-8", errors="replace")
    except OSError:  # another system, or it has ended just now
        return True
    return state.rpartition(")")[2].split()[0] not in ("Z", "X")
