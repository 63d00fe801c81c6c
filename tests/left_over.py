"""What processes leave behind that were killed: names of theirs, and files that lay for long."""

import os
import subprocess
import sys
import time
from pathlib import Path

from ssac.files.whole_file import temporary_path, this_process

ELSEWHERE = "elsewhere-01234567"
"""A host that is not this one."""


def ended_process() -> int:
    """Id of a process that has ended."""
    process = subprocess.Popen([sys.executable, "-c", ""])
    process.wait()
    return process.pid


def made_by(path: Path, process: int, host: str = "") -> Path:
    """A temporary name that another process, of this host or another one, gives a path."""
    me = this_process()
    name = temporary_path(path).name
    name = name.replace(f".{me.host}.{me.process}.", f".{host or me.host}.{process}.")
    return path.with_name(name)


def let_lie(path: Path, idle_s: float) -> None:
    """Make a file or folder look as if it was last written some seconds ago."""
    then_s = time.time() - idle_s
    for one in (path, *path.rglob("*")):
        os.utime(one, (then_s, then_s))
