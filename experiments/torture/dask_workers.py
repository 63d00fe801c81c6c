"""A folder in, a Dask scheduler on this machine with two workers out, while a block runs."""

import importlib.util
import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

from ssac.errors import SsacError

_ROOT = Path(__file__).resolve().parents[2]
_START_S = 120.0


class Scheduler(NamedTuple):
    """A scheduler that runs."""

    address: str
    workers: tuple[int, ...]  # their process ids


def has_dask() -> bool:
    """Whether the optional package is installed."""
    return importlib.util.find_spec("distributed") is not None


@contextmanager
def two_workers(folder: Path) -> Iterator[Scheduler]:
    """Start a scheduler and two workers; end them with the block.

    Raises
    ------
    SsacError
        If the scheduler does not start.
    """
    file = folder / "scheduler.json"
    boss = _dask("scheduler", folder, "--host", "127.0.0.1", "--port", "0")
    started = [boss]
    try:
        until_s = time.monotonic() + _START_S
        while not file.exists():
            if boss.poll() is not None or time.monotonic() > until_s:
                raise SsacError("the Dask scheduler does not start")
            time.sleep(0.1)
        more = ("--nthreads", "1", "--no-nanny", "--local-directory", str(folder))
        started += [_dask("worker", folder, *more) for _ in range(2)]
        address = json.loads(file.read_text(encoding="utf-8"))["address"]
        yield Scheduler(address, tuple(process.pid for process in started[1:]))
    finally:
        for process in reversed(started):
            process.kill()
            process.wait()


def _dask(role: str, folder: Path, *options: str) -> "subprocess.Popen[bytes]":
    command = [sys.executable, "-m", "dask", role, "--no-dashboard", *options]
    return subprocess.Popen(
        [*command, "--scheduler-file", str(folder / "scheduler.json")],
        env=os.environ | {"PYTHONPATH": str(_ROOT)},
        cwd=folder,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
