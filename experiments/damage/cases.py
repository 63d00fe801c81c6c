"""One case: an input is damaged and used as a user's command would, and what became of that.

It is used in a process forked from this one, which has imported everything: a case costs
milliseconds.
"""

import os
import resource
import select
import shutil
import signal
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from functools import partial
from pathlib import Path
from threading import RLock
from typing import NamedTuple

import numpy as np
from tqdm import tqdm

from experiments.damage.changes import OF_BYTES, OF_TEXT, restructured
from experiments.damage.inputs import Input, whole_inputs
from sim.errors import SimError
from ssac.cli.exits import BAD_INPUT, BUG, DONE, guarded, warnings_as_lines

OUTCOMES = (
    "refused",  # in one line that names the file
    "warned",  # read, and it was said what is wrong
    "read",  # all of it, but for 1 %
    "shorter",  # cut off, of a format without an end mark
    "right",  # of disturbed sweeps, which are tests now: none
    "silently_fewer",  # over 1 % fewer, without a word
    "unclear",  # refused in several lines, or without the file's name
    "traceback",
    "abort",
    "hang",
    "over_memory",
    "wrong",  # as "right"
)

MAX_S = 20.0
MAX_BYTES = 2 << 30
"""Of memory, beyond what the process had when it was forked."""


class Case(NamedTuple):
    """One damaged input."""

    kind: str
    damage: str
    number: int
    outcome: str  # of OUTCOMES
    said: str  # on stderr


class Damaging:
    """A good input of each kind in a folder that goes with this."""

    def __init__(self) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="ssac-damage-")
        self.folder = Path(self._folder.name)
        self.whole = whole_inputs(self.folder / "whole")


def damaged_case(damaging: Damaging, number: int, seed: int) -> Case:
    """Damage a copy of an input and use it; the same seed and number damage it the same way."""
    rng = np.random.default_rng([seed, number])
    whole, folder = damaging.whole[number % len(damaging.whole)], damaging.folder / "damaged"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    path = folder / whole.path.name
    damage = _damaged(whole, path, rng)
    is_allowed = whole.use_damaged is not None and rng.integers(3) == 0
    use = whole.use_damaged if is_allowed and whole.use_damaged else whole.use
    ended = run_forked(partial(use, path), folder)
    found = outcome(ended, path.name, whole.good)
    if found == "silently_fewer" and damage == "cut" and not whole.has_end:
        found = "shorter"
    damage += ", allowed" if is_allowed else ""  # read with `--allow-damaged`
    return Case(whole.kind, damage, number, found, " ".join(ended.stderr.split())[-500:])


def _damaged(whole: Input, path: Path, rng: np.random.Generator) -> str:
    """Write a damaged copy; return what was done to it."""
    if whole.kind.startswith("hdf5") and rng.integers(2):
        shutil.copyfile(whole.path, path)
        return restructured(path, rng)
    damages = OF_TEXT if whole.is_text else OF_BYTES
    name = list(damages)[int(rng.integers(len(damages)))]
    path.write_bytes(damages[name](whole.path.read_bytes(), rng))
    return name


class Ended(NamedTuple):
    """How a case ended."""

    code: int  # exit code; negative: the signal that ended it
    stderr: str
    value: int | None  # that was returned, where it ended well
    is_late: bool  # and was killed


def run_forked(work: Callable[[], int], folder: Path, within_s: float = MAX_S) -> Ended:
    """Do one thing, which returns a number, in a process forked from this one."""
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
