"""Worker pools for the jobs of a run: this process, local processes, or a Dask cluster.

Each worker process has a pipe of its own and one job at a time, so that when a worker dies its job
is known and no other job is lost. Workers are spawned, not forked: threads and OpenGL do not
survive a fork. They import our code once, then serve one pool after the other until this process
ends; and they end with it, even when it is killed.
"""

import logging
import math
import os
import signal
import threading
import time
from collections.abc import Callable, Collection
from concurrent.futures import FIRST_COMPLETED, CancelledError, Future, ThreadPoolExecutor, wait
from contextlib import AbstractContextManager, suppress
from multiprocessing import get_context, parent_process
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from ssac.errors import SsacError

ENDS_WITHIN_S = 5.0  # after which a process that was asked to end is killed
WAIT_FOR_WORKERS_S = 60.0  # for a scheduler's workers, which may be starting or restarting
ANSWERS_WITHIN_S = 10.0  # without an answer after which the scheduler is taken to be absent
_LOOK_S = 5.0  # interval of the checks that a scheduler still has workers
_SPAWN = get_context("spawn")

Running = Future[Any]
Job = Callable[[], Any]  # a `functools.partial` of a function; it and its result can be pickled


class DiedError(Exception):
    """The worker ended in the middle of its job."""


class Pool(AbstractContextManager["Pool"]):
    """The pool of this process alone: a job that crashes the process ends everything."""

    room: float = 1  # number of jobs at a time

    def submit(self, job: Job) -> Running:
        """Run a job to its end."""
        future: Running = Future()
        value, error = _done(job)
        future.set_exception(error) if error else future.set_result(value)
        return future

    def ended(self, running: Collection[Running], timeout_s: float | None) -> set[Running]:
        """Return the jobs that ended; wait for the first, `timeout_s` at most (None: for ever)."""
        return wait(running, timeout_s, FIRST_COMPLETED).done

    def __exit__(self, *_: object) -> None:
        """End the jobs that still run."""


class Processes(Pool):
    """A pool of worker processes; a process that dies is replaced."""

    def __init__(self, count: int) -> None:
        self.room = count
        self._threads = ThreadPoolExecutor(count)  # each waits for one process
        self._busy: set[Worker] = set()

    def submit(self, job: Job) -> Running:
        """Hand a job to an idle process, or to a new one."""
        worker = _IDLE.pop() if _IDLE else Worker()
        if not worker.process.is_alive():  # it died idle, so not of a job
            worker.end()
            worker = Worker()
        self._busy.add(worker)
        return self._threads.submit(self._do, worker, job)

    def __exit__(self, *_: object) -> None:
        for worker in list(self._busy):
            worker.process.terminate()
        self._threads.shutdown()

    def _do(self, worker: "Worker", job: Job) -> Any:
        try:
            return worker.do(job)
        finally:
            self._busy.discard(worker)
            if not worker.pipe.closed:
                _IDLE.append(worker)


class Worker:
    """A process that does jobs, and our end of the pipe to it."""

    def __init__(self, has_children: bool = False) -> None:
        self.pipe, theirs = _SPAWN.Pipe()
        self.process = _SPAWN.Process(target=_serve, args=(theirs,), daemon=not has_children)
        # The worker ignores Ctrl-C from its start: this process gets it too, and ends its workers.
        is_main = threading.current_thread() is threading.main_thread()
        before = signal.signal(signal.SIGINT, signal.SIG_IGN) if is_main else None
        try:
            self.process.start()
        finally:
            if is_main:
                signal.signal(signal.SIGINT, before)
        theirs.close()  # only the worker holds it: the pipe closes when the worker ends

    def do(self, job: Job) -> Any:
        """Run a job in the process; DiedError when the process ends in the middle of it."""
        try:
            self.pipe.send(job)
            value, error = self.pipe.recv()
        except (EOFError, OSError):
            raise DiedError(self.end()) from None
        if error is not None:
            raise error
        return value

    def end(self) -> str:
        """Wait for the process to end, or kill it; say how it ended."""
        self.pipe.close()
        self.process.join(ENDS_WITHIN_S)
        if self.process.exitcode is None:
            self.process.kill()
            self.process.join()
        code = self.process.exitcode or 0
        return f"ended by {signal.Signals(-code).name}" if code < 0 else f"ended with code {code}"


_IDLE: list[Worker] = []  # kept for the next pool, since starting a worker takes seconds


def in_new_process(job: Job) -> Any:
    """Run a job in a new process; DiedError when the process ends before the job."""
    worker = Worker(has_children=True)  # its job may start processes
    try:
        return worker.do(job)
    finally:
        worker.end()


def _done(job: Job) -> tuple[Any, Exception | None]:
    try:
        return job(), None
    except Exception as error:
        return None, error


def _serve(pipe: Connection) -> None:
    """Run jobs from the pipe until it closes: the main loop of a worker."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    with suppress(OSError):  # of `send`, which fails after `recv` when the pipe is closed
        while True:
            answer = _done(lambda: pipe.recv()())  # unpickling fails where a module is missing
            try:
                pipe.send(answer)
            except Exception as error:  # the answer cannot be pickled
                pipe.send((None, TypeError(f"{answer!r}: {error}")))


def _end_with_parent() -> None:
    """End this worker at once when its parent process ends, even by a kill."""
    parent = parent_process()
    if parent is not None:
        parent.join()
    os._exit(1)


class Cluster(Pool):
    """The workers of a Dask scheduler, which has a queue of its own and replaces those that die."""

    room = math.inf

    def __init__(self, address: str) -> None:
        self._address = address
        self._client = _connected(address)
        self._executor = self._client.get_executor(pure=False)
        self._seen_s = time.monotonic()  # when workers were last seen

    def submit(self, job: Job) -> Running:
        """Hand a job to the scheduler."""
        future: Running = self._executor.submit(job)
        return future

    def ended(self, running: Collection[Running], timeout_s: float | None) -> set[Running]:
        """Wait until jobs have ended; SsacError when scheduler or workers are gone."""
        until_s = time.monotonic() + (math.inf if timeout_s is None else timeout_s)
        found: set[Running] = set()
        while not found and time.monotonic() < until_s:
            found = super().ended(running, min(_LOOK_S, max(0.0, until_s - time.monotonic())))
            self._look(bool(found))
        for future in found:
            if future.cancelled() or isinstance(future.exception(), CancelledError):
                raise SsacError(
                    f"the Dask scheduler at {self._address} is gone: what is done is in the cache, "
                    "start it again and run again"
                )
        return found

    def __exit__(self, *_: object) -> None:
        log = logging.getLogger("distributed.client")
        level = log.level
        log.setLevel(logging.CRITICAL)  # it would log at length that it cannot reconnect
        try:
            self._executor.shutdown(wait=False)
            self._client.close()
        finally:
            log.setLevel(level)

    def _look(self, is_alive: bool) -> None:
        """Raise SsacError when the scheduler has had no workers for WAIT_FOR_WORKERS_S."""
        if not is_alive:
            with suppress(OSError):  # the scheduler does not answer
                is_alive = bool(self._client.scheduler_info()["workers"])
        now_s = time.monotonic()
        if is_alive:
            self._seen_s = now_s
        elif now_s - self._seen_s > WAIT_FOR_WORKERS_S:
            raise SsacError(
                f"the Dask scheduler at {self._address} has no workers any more: what is done is "
                "in the cache, start some and run again"
            )


def _connected(address: str) -> Any:
    try:
        from distributed import Client
    except ImportError as error:
        raise SsacError(
            '--scheduler needs Dask: .venv/bin/pip install "dask[distributed]"'
        ) from error
    try:
        client = Client(address, timeout=ANSWERS_WITHIN_S, set_as_default=False)  # type: ignore[no-untyped-call]
    except (OSError, ValueError) as error:
        raise SsacError(
            f"no Dask scheduler answers at {address!r}: expected an address such as "
            f"tcp://host:8786 ({error})"
        ) from error
    try:
        client.wait_for_workers(1, timeout=WAIT_FOR_WORKERS_S)
    except OSError as error:  # TimeoutError is one
        client.close()  # type: ignore[no-untyped-call]
        raise SsacError(
            f"the Dask scheduler at {address} has no workers: start some with "
            f"dask worker {address} --nthreads 1"
        ) from error
    return client


def n_cores() -> int:
    """Count the cores that this process may use: a container's share of them, rounded up."""
    allowed = getattr(os, "sched_getaffinity", None)
    count = len(allowed(0)) if allowed else os.cpu_count() or 1
    with suppress(OSError, ValueError):  # not Linux, or no limit
        quota, period = Path("/sys/fs/cgroup/cpu.max").read_text(encoding="ascii").split()
        count = min(count, -(-int(quota) // int(period)))
    return max(count, 1)
