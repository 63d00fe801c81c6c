"""The workers of a Dask scheduler as a pool (`experiments.lab.pool`)."""

import logging
import time
from concurrent.futures import FIRST_COMPLETED, CancelledError, Future, wait
from contextlib import suppress
from typing import Any

from experiments.lab.pool import Ended, Job
from ssac.errors import SsacError

WAIT_FOR_WORKERS_S = 60.0
"""They may be on their way, or be started again."""

_LOOK_S = 5.0  # how often it is seen whether there still are workers


class Cluster:
    """The workers of a Dask scheduler.

    The scheduler gives the job of a worker that died to another one, several times (its setting
    `allowed-failures`), and then gives up with an error of its own.
    """

    def __init__(self, address: str) -> None:
        self._address = address
        self._client = _connected(address)
        self._running: dict[Future[Any], int] = {}
        self._executor = self._client.get_executor(pure=False)
        self._seen_s = time.monotonic()  # when there were workers

    def has_room(self) -> bool:
        """Whether it takes a job: the scheduler has a queue of its own."""
        return True

    def give(self, number: int, job: Job) -> None:
        """Hand a job to the scheduler."""
        self._running[self._executor.submit(job)] = number

    def ended(self, timeout_s: float | None) -> list[Ended]:
        """Wait until jobs have ended; SsacError when scheduler or workers are gone."""
        until_s = time.monotonic() + timeout_s if timeout_s is not None else float("inf")
        found: set[Future[Any]] = set()
        while not found and time.monotonic() < until_s:
            left_s = min(_LOOK_S, max(0.0, until_s - time.monotonic()))
            found = wait(self._running, left_s, FIRST_COMPLETED).done
            self._look(bool(found))
        return [self._result(future) for future in found]

    def __enter__(self) -> "Cluster":
        return self

    def __exit__(self, *_: object) -> None:
        for future in self._running:
            future.cancel()
        log = logging.getLogger("distributed.client")
        level = log.level
        log.setLevel(logging.CRITICAL)  # it would tell at length how it cannot connect again
        try:
            self._client.close()
        finally:
            log.setLevel(level)

    def _result(self, future: "Future[Any]") -> Ended:
        number = self._running.pop(future)
        try:
            return Ended(number, future.result())
        except CancelledError as error:
            raise SsacError(
                f"the Dask scheduler at {self._address} is gone: what is done is in the cache, "
                "start it again and run again"
            ) from error
        except Exception as error:
            return Ended(number, None, error)

    def _look(self, is_alive: bool) -> None:
        """Refuse to wait for ever where nobody works."""
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
    """Give a client of the scheduler, which has workers."""
    try:
        from distributed import Client
    except ImportError as error:
        raise SsacError(
            '--scheduler needs Dask: .venv/bin/pip install "dask[distributed]"'
        ) from error
    try:
        client = Client(address, timeout=10, set_as_default=False)  # type: ignore[no-untyped-call]
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
