"""Worker processes of this machine: those that die are replaced, and lose one job alone.

Each process has a pipe of its own and one job at a time, so that when one dies it is known on which
job, and no other job is lost. They are spawned, not forked: threads and OpenGL do not survive a
fork. They import our code once, then serve one pool after the other until this process ends; and
they end with it, even when it is killed.
"""

import ctypes
import os
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from multiprocessing import get_context, parent_process
from multiprocessing.connection import Connection, wait
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple, Protocol

LARGEST_BYTES = 1 << 25
"""Of what is kept: the most that glibc allows. A camera's events of 20 s are half of it."""

_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3  # parameters of glibc's mallopt
_MOST_KEPT_BYTES = 1 << 30

ENDS_WITHIN_S = 5.0
"""After that a process that was told to end is killed."""

_SPAWN = get_context("spawn")

Job = Callable[[], Any]
"""With what it returns, something that pickle takes: a `functools.partial` of a function."""


class DiedError(Exception):
    """The worker of a job ended in the middle of it."""


class Ended(NamedTuple):
    """What became of a job."""

    number: int  # as it was given
    value: Any  # that it returned
    error: Exception | None = None  # that it raised, or a DiedError


class Pool(Protocol):
    """Workers; when its block is left, none of them is on a job."""

    def has_room(self) -> bool:
        """Whether it takes a job now."""

    def give(self, number: int, job: Job) -> None:
        """Have a job done."""

    def ended(self, timeout_s: float | None) -> list[Ended]:
        """Wait until jobs have ended, one or more, or for some seconds; None: for ever."""

    def __enter__(self) -> "Pool":
        """Begin."""

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """End what is still being done."""


class Alone:
    """The pool of this process alone: a job that takes it down takes everything down."""

    def __init__(self) -> None:
        self._job: tuple[int, Job] | None = None

    def has_room(self) -> bool:
        """Whether there is no job."""
        return self._job is None

    def give(self, number: int, job: Job) -> None:
        """Take a job."""
        self._job = number, job

    def ended(self, timeout_s: float | None) -> list[Ended]:
        """Do it now, however long it takes."""
        del timeout_s
        if self._job is None:
            return []
        (number, job), self._job = self._job, None
        return [done(number, job)]

    def __enter__(self) -> "Alone":
        return self

    def __exit__(self, *_: object) -> None:
        self._job = None


def done(number: int, job: Job) -> Ended:
    """Do a job here."""
    try:
        return Ended(number, job())
    except Exception as error:
        return Ended(number, None, error)


def n_cores() -> int:
    """Count the cores that this process may use: a container's share of them, rounded up."""
    allowed = getattr(os, "sched_getaffinity", None)
    count = len(allowed(0)) if allowed else os.cpu_count() or 1
    with suppress(OSError, ValueError):  # not Linux, or no limit
        quota, period = Path("/sys/fs/cgroup/cpu.max").read_text(encoding="ascii").split()
        count = min(count, -(-int(quota) // int(period)))
    return max(count, 1)


class Processes:
    """A pool of some processes; those that died are replaced."""

    def __init__(self, count: int) -> None:
        self._count = count
        self._busy: dict[Connection, tuple[Worker, int]] = {}

    def has_room(self) -> bool:
        """Whether fewer are busy than there may be."""
        return len(self._busy) < self._count

    def give(self, number: int, job: Job) -> None:
        """Hand a job to an idle process, or to a new one."""
        worker = _IDLE.pop() if _IDLE else Worker()
        try:
            worker.pipe.send(job)
        except OSError:  # it died idle: of nothing that we gave it
            worker.end()
            worker = Worker()
            worker.pipe.send(job)
        self._busy[worker.pipe] = worker, number

    def ended(self, timeout_s: float | None) -> list[Ended]:
        """Wait until jobs have ended."""
        found = []
        ready = wait(list(self._busy), timeout_s)
        for pipe in [one for one in self._busy if one in ready]:
            worker, number = self._busy.pop(pipe)
            try:
                value, error = pipe.recv()
            except (EOFError, OSError):
                found.append(Ended(number, None, DiedError(worker.end())))
                continue
            except Exception as unreadable:  # what it sent cannot be unpickled; all of it was read
                value, error = None, unreadable
            _IDLE.append(worker)
            found.append(Ended(number, value, error))
        return found

    def __enter__(self) -> "Processes":
        return self

    def __exit__(self, *_: object) -> None:
        busy = [worker for worker, _ in self._busy.values()]
        self._busy.clear()
        for worker in busy:
            worker.process.terminate()
        for worker in busy:
            worker.end()


class Worker:
    """A process that does jobs, and our end of the pipe to it."""

    def __init__(self, has_children: bool = False) -> None:
        self.pipe, theirs = _SPAWN.Pipe()
        self.process = _SPAWN.Process(target=_serve, args=(theirs,), daemon=not has_children)
        with _deaf_to_interrupts():
            self.process.start()
        theirs.close()  # theirs alone from now on: the pipe ends when the process does

    def end(self) -> str:
        """Wait for its end, or bring it about; say how it came."""
        self.pipe.close()
        self.process.join(ENDS_WITHIN_S)
        if self.process.exitcode is None:
            self.process.kill()
            self.process.join()
        code = self.process.exitcode or 0
        return f"ended by {signal.Signals(-code).name}" if code < 0 else f"ended with code {code}"


_IDLE: list[Worker] = []
"""To start one takes seconds, so that they are kept for the next pool."""


@contextmanager
def _deaf_to_interrupts() -> Iterator[None]:
    """Let what starts here ignore Ctrl-C: we get it too, and end our workers in silence."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def _serve(pipe: Connection) -> None:
    """Do jobs until there are no more: the life of a worker."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    with suppress(EOFError, OSError):
        while True:
            ended = done(0, _received(pipe))
            try:
                pipe.send((ended.value, ended.error))
            except OSError:
                raise
            except Exception as error:  # something that pickle does not take
                pipe.send((None, TypeError(f"{ended.error or ended.value!r}: {error}")))


def _received(pipe: Connection) -> Job:
    """Wait for a job; one that cannot be unpickled, as its module is not here, becomes an error."""
    try:
        job: Job = pipe.recv()
    except (EOFError, OSError):
        raise EOFError from None
    except Exception as error:
        return _raising(error)
    return job


def _raising(error: Exception) -> Job:
    def raise_it() -> None:
        raise error

    return raise_it


def _end_with_parent() -> None:
    """End at once when the process that started us does, be it killed: nobody wants our work."""
    parent = parent_process()
    if parent is not None:
        parent.join()
    os._exit(1)


def in_new_process(job: Job) -> Any:
    """Do a job in a process that does nothing else; DiedError when that ends without."""
    worker = Worker(has_children=True)  # if it wants to
    try:
        worker.pipe.send(job)
        value, error = worker.pipe.recv()
    except (EOFError, OSError):
        raise DiedError(worker.end()) from None
    finally:
        worker.end()
    if error is not None:
        raise error
    return value


def keep_freed_memory() -> None:
    """Let arrays take the memory of those before them, where the C library is glibc.

    By default each array of some megabytes is given back to the kernel when it goes, and the next
    one's pages are zeroed anew as they are touched: a fifteenth of the time of cached tables. What
    a process needs at most stays the same.
    """
    with suppress(OSError, AttributeError):  # other C libraries do not have it
        mallopt = ctypes.CDLL(None).mallopt
        mallopt(_MMAP_THRESHOLD, LARGEST_BYTES)
        mallopt(_TRIM_THRESHOLD, _MOST_KEPT_BYTES)
