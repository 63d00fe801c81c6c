"""Locks that only one process at a time can hold, whatever host it runs on.

A lock is a file (`filelock.SoftFileLease`). Its holder touches it now and then. It is free when its
holder is a process of this host that has ended, or when nobody touched it for `LAPSES_S`, as seen
by one who asks again and again: then the next one that asks takes it over.

Locks save work, and nothing rests on them: should two processes hold one, as after a holder was
suspended, both make the same thing, and either is whole (`whole_file`, `sim.storage`).
"""

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from filelock import SoftFileLease, Timeout

SUFFIX = ".claim"

LAPSES_S = 120.0
"""Longer than a client of a network disk may show old times (NFS: 60 s), and a touch or two."""

ASK_AGAIN_S = 1.0
"""How long those wait who find something locked."""

_SEEN: dict[Path, SoftFileLease] = {}
"""Of those who found a lock taken: each remembers since when nobody has touched it."""


@contextmanager
def claimed(path: Path) -> Iterator[bool]:
    """Hold a lock while the block runs; False when another process, or thread, has it.

    Parameters
    ----------
    path
        Of the lock, ending with `SUFFIX`; its folder is made.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    lease = _SEEN.pop(path, None) or SoftFileLease(
        path, lease_duration=LAPSES_S, timeout=0, thread_local=False
    )
    try:
        lease.acquire()
    except Timeout:
        _SEEN[path] = lease
        yield False
        return
    try:
        yield True
    finally:
        lease.release()


def remove_lapsed(folder: Path) -> None:
    """Remove the locks in a folder whose holders are gone.

    One who was killed before it wrote who it is has left an empty file, which would never lapse.
    """
    for path in folder.glob(f".*{SUFFIX}"):
        with suppress(OSError):
            if path.stat().st_size == 0:
                path.unlink()
                continue
        with claimed(path):
            pass
