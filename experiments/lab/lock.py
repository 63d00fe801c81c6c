"""A file's name in; whether this process may make what it stands for, or another one is on it, out.

A claim is a file that only one process can create, whatever host it runs on. Its holder touches it
every `BEAT_S`. It lapses when its holder is a process of this host that has ended, or when nobody
touched it for `LAPSES_S`: then the next one that asks takes it over.

Claims save work, and nothing rests on them: should two processes hold one, as after a holder was
suspended, both make the same thing, and either is whole (`whole_file`, `sim.storage`).
"""

import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from ssac.files.whole_file import idle_s, maker_of, temporary_path

SUFFIX = ".claim"

BEAT_S = 10.0

LAPSES_S = 120.0
"""Longer than a client of a network disk may show old times (NFS: 60 s), and a beat or two."""

ASK_AGAIN_S = 1.0
"""How long those wait who find something claimed."""


@contextmanager
def claimed(path: Path) -> Iterator[bool]:
    """Hold a claim while the block runs; False when another process, or thread, has it.

    Parameters
    ----------
    path
        Of the claim, ending with `SUFFIX`; its folder is made.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    name = _taken(path)
    if not name:
        yield False
        return
    ended = threading.Event()
    beats = threading.Thread(target=_beat, args=(path, name, ended), name=str(path), daemon=True)
    beats.start()
    try:
        yield True
    finally:
        ended.set()
        beats.join()
        if _holder(path) == name:
            path.unlink(missing_ok=True)


def remove_lapsed(folder: Path) -> None:
    """Remove the claims in a folder whose holders are gone."""
    for path in folder.glob(f".*{SUFFIX}"):
        name = _holder(path)
        if _has_lapsed(path, name):
            _remove(path, name)


def _taken(path: Path) -> str:
    """Create a claim; return what it says, which no other claim does, or nothing if it is taken."""
    name = temporary_path(path).name
    if not _created(path, name):
        found = _holder(path)
        if not _has_lapsed(path, found):
            return ""
        _remove(path, found)
        if not _created(path, name):  # another one was faster
            return ""
    return name


def _created(path: Path, name: str) -> bool:
    try:
        with path.open("x", encoding="utf-8") as file:
            file.write(name)
    except FileExistsError:
        return False
    return True


def _holder(path: Path) -> str:
    """Read who holds a claim; nothing while it is being written, or when there is none."""
    try:
        return path.read_text(encoding="utf-8")
    except OSError:
        return ""


def _has_lapsed(path: Path, holder: str) -> bool:
    maker = maker_of(Path(holder))
    return (maker is not None and maker.is_gone) or idle_s(path) > LAPSES_S


def _remove(path: Path, holder: str) -> None:
    """Remove a claim that has lapsed, unless another process has just taken it over.

    It is put aside first, which only one process can do, and put back if it is not the lapsed one.
    """
    aside = temporary_path(path)
    try:
        path.rename(aside)
    except OSError:  # another one was faster
        return
    if _holder(aside) != holder:
        with suppress(OSError):  # a third one has taken it meanwhile, or the disk has no links
            os.link(aside, path)
    aside.unlink(missing_ok=True)


def _beat(path: Path, name: str, ended: threading.Event) -> None:
    """Touch a claim again and again, until it is given back or somebody else's."""
    while not ended.wait(BEAT_S):
        if _holder(path) != name:
            return
        with suppress(OSError):
            os.utime(path)  # by the disk's clock
