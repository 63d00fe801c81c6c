"""Imitates what killed processes leave behind: their temporary names, and old files."""

import os
import subprocess
import sys
import time
from pathlib import Path

from ssac.files.whole_file import host as this_host
from ssac.files.whole_file import temporary_path

ELSEWHERE = "elsewhere-01234567"


def ended_process() -> int:
    process = subprocess.Popen([sys.executable, "-c", ""])
    process.wait()
    return process.pid


def made_by(path: Path, process: int, host: str = "") -> Path:
    """Return the temporary name that a process of this or another host gives to a path."""
    maker, name = f".{this_host()}.{os.getpid()}.", temporary_path(path).name
    return path.with_name(name.replace(maker, f".{host or this_host()}.{process}."))


def let_lie(path: Path, idle_s: float) -> None:
    """Make a file or folder look as if it was last written some seconds ago."""
    then_s = time.time() - idle_s
    for one in (path, *path.rglob("*")):
        os.utime(one, (then_s, then_s))
