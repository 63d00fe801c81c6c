"""Something to be done with a damaged input in, what became of it out: each in its own process.

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
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from sim.errors import SimError
from ssac.console.exits import BAD_INPUT, BUG, DONE, guarded, warnings_as_lines

MAX_S = 20.0
MAX_BYTES = 2 << 30
"""Of memory, beyond what the process had when it was forked."""


class Case(NamedTuple):
    """One damaged input, or one disturbance."""

    kind: str
    damage: str
    number: int
    outcome: str  # as of `campaign.OUTCOMES`
    said: str  # on stderr


class Ended(NamedTuple):
    """How a case ended."""

    code: int  # exit code; negative: the signal that ended it
    stderr: str
    value: int | None  # that was returned, where it ended well
    is_late: bool  # and was killed


def in_own_process(work: Callable[[], int], folder: Path) -> Ended:
    """Do something as a command of ours would, with limits of time and memory.

    Parameters
    ----------
    work
        Returns a number.
    folder
        For temporary files and for tracebacks.
    """
    reading, writing = os.pipe()
    with tempfile.TemporaryFile(dir=folder) as stderr:
        sys.stdout.flush()
        sys.stderr.flush()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)  # of forks where there are threads
            process = os.fork()
        if process == 0:
            os.close(reading)
            _child(work, folder, stderr.fileno(), writing)
        os.close(writing)
        is_late = not _closed_within(reading, MAX_S)
        if is_late:
            os.kill(process, signal.SIGKILL)
        said = os.read(reading, 64) if not is_late else b""
        os.close(reading)
        _, status = os.waitpid(process, 0)
        stderr.seek(0)
        text = stderr.read(100_000).decode("utf-8", "replace")
    value = int(said) if said else None
    return Ended(os.waitstatus_to_exitcode(status), text, value, is_late)


def outcome(ended: Ended, name: str, good: int) -> str:
    """Name what became of a case.

    Parameters
    ----------
    ended
        How it ended.
    name
        Of the damaged file: an error must name it.
    good
        The value of the whole input.
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
        is_clear = len(lines) == 1 and lines[0].startswith("error: ") and name in lines[0]
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
    try:
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


def _closed_within(descriptor: int, seconds: float) -> bool:
    """Wait until a pipe has something to read, or its other end is closed."""
    until_s = time.monotonic() + seconds
    while (left_s := until_s - time.monotonic()) > 0:
        with suppress(InterruptedError):
            return bool(select.select([descriptor], [], [], left_s)[0])
    return False
