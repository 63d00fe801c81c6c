"""One thing done as a command of ours would, in a process of its own, and how it ended.

The process is forked from this one, which has imported everything: a case costs milliseconds.
"""

import os
import resource
import select
import signal
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from threading import RLock
from typing import NamedTuple

from tqdm import tqdm

from sim.errors import SimError
from ssac.cli.exits import BAD_INPUT, BUG, DONE, guarded, warnings_as_lines

MAX_S = 20.0
MAX_BYTES = 2 << 30
"""Of memory, beyond what the process had when it was forked."""


class Ended(NamedTuple):
    """How a case ended."""

    code: int  # exit code; negative: the signal that ended it
    stderr: str
    value: int | None  # that was returned, where it ended well
    is_late: bool  # and was killed


def run_forked(work: Callable[[], int], folder: Path, within_s: float = MAX_S) -> Ended:
    """Do one thing, which returns a number, in a process forked from this one.

    `folder` is for temporary files and for tracebacks. A process that takes longer is killed.
    """
    reading, writing = os.pipe()
    with tempfile.TemporaryFile(dir=folder) as stderr:
        sys.stdout.flush()
        sys.stderr.flush()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)  # of forks where there are threads
            pid = os.fork()
        if pid == 0:
            os.close(reading)
            _child(work, folder, stderr.fileno(), writing)
        os.close(writing)
        said, is_late = b"", True
        try:
            said, is_late = _read_to_end(reading, within_s)
        finally:
            if is_late:
                os.kill(pid, signal.SIGKILL)
            os.close(reading)
            _, status = os.waitpid(pid, 0)
        stderr.seek(0)
        text = stderr.read(100_000).decode("utf-8", "replace")
    value = int(said) if said else None
    return Ended(os.waitstatus_to_exitcode(status), text, value, is_late)


def outcome(ended: Ended, name: str, good: int) -> str:
    """Name what became of a case.

    An error must name the damaged file; `good` is the value of the whole input.
    """
    if ended.is_late:
        return "hang"
    if ended.code < 0:
        return "abort"
    lines = ended.stderr.splitlines()
    if "MemoryError" in ended.stderr or "Unable to allocate" in ended.stderr:
        return "over_memory"
    if ended.code == BUG or "Traceback" in ended.stderr:
        return "traceback"
    if ended.code == BAD_INPUT:
        errors = [line for line in lines if not line.startswith("warning: ")]
        is_clear = len(errors) == 1 and errors[0].startswith("error: ") and name in errors[0]
        return "refused" if is_clear else "unclear"
    if ended.code != DONE or ended.value is None:
        return "abort"
    if lines:
        return "warned"
    if ended.value < 0.99 * good:
        return "silently_fewer"
    return "read"


def _child(work: Callable[[], int], folder: Path, stderr: int, writing: int) -> None:
    """Do it and end: nothing of the parent may run on."""
    code = BUG
    tqdm.set_lock(RLock())  # not one of the system's, which would outlive this process
    try:
        os.setsid()  # a group of its own
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        os.dup2(stderr, 2)
        sys.stderr = os.fdopen(2, "w", closefd=False)
        tempfile.tempdir = str(folder)
        has_bytes = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        limit = has_bytes + MAX_BYTES
        resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))

        def run() -> int:
            with warnings_as_lines():
                value = work()
            os.write(writing, str(value).encode())
            return DONE

        code = guarded(run, (SimError,))
        sys.stderr.flush()
    finally:
        os._exit(code)


def _read_to_end(descriptor: int, seconds: float) -> tuple[bytes, bool]:
    """Read a pipe until its other end is closed; and whether that takes longer than it may."""
    until_s, said = time.monotonic() + seconds, b""
    while (left_s := until_s - time.monotonic()) > 0:
        if select.select([descriptor], [], [], left_s)[0]:
            part = os.read(descriptor, 64)
            if not part:
                return said, False
            said += part
    return said, True
