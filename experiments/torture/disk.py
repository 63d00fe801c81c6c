"""A folder and a size in, a small file system in it out, which soon is full."""

import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ssac.errors import SsacError


@contextmanager
def small_disk(at: Path, n_bytes: int) -> Iterator[Path]:
    """Mount a file system in memory while the block runs.

    Raises
    ------
    SsacError
        If this process may not.
    """
    at.mkdir(parents=True)
    _mount(f"size={n_bytes}", at)
    try:
        yield at
    finally:
        subprocess.run(["umount", str(at)], check=False, capture_output=True)


def make_room(disk: Path) -> None:
    """Give a small disk all the space that anything here needs."""
    _mount("remount,size=1g", disk)


def _mount(options: str, at: Path) -> None:
    command = ["mount", "-t", "tmpfs", "-o", options, "tmpfs", str(at)]
    made = subprocess.run(command, check=False, capture_output=True, text=True)
    if made.returncode:
        raise SsacError(
            f"{at}: a file system in memory cannot be mounted ({made.stderr.strip()}): run as "
            "root, or with --full-disks 0"
        )
