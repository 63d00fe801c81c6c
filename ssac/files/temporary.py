"""A name in; a temporary one out that no process of any host gives twice, and that tells its maker.

    .NAME.HOST.PROCESS.RANDOM.part

Equal process ids on two hosts that share a disk, in two containers of one host, or before and after
a restart are three different makers. What a maker leaves behind when it is killed can be told from
what another is just writing, so that it can be removed. `sim.storage` gives folders such names.
"""

import glob
import os
import platform
import re
import shutil
from contextlib import suppress
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import NamedTuple

LEFT_OVER_S = 86_400.0
"""After a day without a write, what a process of another host was writing is left over."""

_MADE = re.compile(r"\..*\.(?P<host>[A-Za-z0-9-]+)\.(?P<process>\d+)\.[0-9a-f]{32}\.[a-z]+", re.S)

_NAME_LENGTH = 32  # of 255 bytes that a file's name may have, four for each of these letters


class Maker(NamedTuple):
    """A process."""

    host: str  # as `host` of this module gives it
    process: int

    @property
    def is_here(self) -> bool:
        """Whether it runs, or ran, where its number tells us something."""
        return self.host == host()

    @property
    def is_gone(self) -> bool:
        """Whether it is known to have ended: False for those of other hosts."""
        return self.is_here and not _runs(self.process)


def this_process() -> Maker:
    """Say who we are."""
    return Maker(host(), os.getpid())


@cache
def host() -> str:
    """Name the place in which a process id has one meaning: a machine, since it was started.

    A container counts as a machine of its own.
    """
    node = platform.node()
    place = [node]
    with suppress(OSError):  # not Linux
        place.append(Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii"))
    with suppress(OSError):
        place.append(os.readlink("/proc/self/ns/pid"))
    name = re.sub(r"[^A-Za-z0-9-]", "-", node)[:20]
    return f"{name}-{sha256(repr(place).encode()).hexdigest()[:8]}"


def temporary_path(path: Path) -> Path:
    """Give a name beside a path that is given only once, by any process of any host."""
    maker = this_process()
    name = path.name[:_NAME_LENGTH]
    return path.with_name(f".{name}.{maker.host}.{maker.process}.{os.urandom(16).hex()}.part")


def maker_of(path: Path) -> Maker | None:
    """Read who made a temporary file or folder off its name; None where the name does not tell."""
    found = _MADE.fullmatch(path.name)
    return Maker(found["host"], int(found["process"])) if found else None


def is_left_over(path: Path) -> bool:
    """Say whether a temporary file or folder of ours is one that nobody writes to any more.

    For a process of this host, that it has ended decides; for one of another host, that nothing was
    written for `LEFT_OVER_S`. False for a name that is not of ours.
    """
    maker = maker_of(path)
    if maker is None:
        return False
    return maker.is_gone if maker.is_here else idle_s(path) > LEFT_OVER_S


def remove_left_over(folder: Path, name: str = "") -> None:
    """Remove the temporary files and folders in a folder that nobody writes to any more.

    Parameters
    ----------
    folder
        It need not be there. What lies deeper is left alone.
    name
        Of the file or folder that they would have become; empty: of all.
    """
    prefix = f".{glob.escape(name[:_NAME_LENGTH])}." if name else "."
    for path in folder.glob(f"{prefix}*"):
        if not is_left_over(path):
            continue
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path, ignore_errors=True)
        else:
            with suppress(OSError):  # another one was faster
                path.unlink()


def idle_s(path: Path) -> float:
    """Time since a file, or anything in a folder, was written [s], by the clock of its disk.

    A network disk has a clock of its own, and so has every host: only times of one clock compare.
    0 when the file is gone, or when the disk takes no file that would tell its time.
    """
    try:
        written_s = max(one.stat().st_mtime for one in (path, *path.rglob("*")))
        return _disk_time_s(path.parent) - written_s
    except OSError:
        return 0.0


def _disk_time_s(folder: Path) -> float:
    probe = temporary_path(folder / "clock")
    try:
        probe.touch(exist_ok=False)
        return probe.stat().st_mtime
    finally:
        probe.unlink(missing_ok=True)


def _runs(process: int) -> bool:
    """Say whether there is a process of this host with a number that has not ended."""
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:  # somebody else's
        return True
    try:  # one that ended keeps its number until its parent asks how
        state = Path(f"/proc/{process}/stat").read_text(encoding="utf-8", errors="replace")
    except OSError:  # another system, or it has ended just now
        return True
    return state.rpartition(")")[2].split()[0] not in ("Z", "X")
