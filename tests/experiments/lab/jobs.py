"""Jobs for workers, which find them by the name of their module."""

import os
import signal
import sys
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future, wait
from pathlib import Path
from typing import Any

from experiments.lab.pool import Pool


def square(number: int) -> int:
    return number * number


def who(_: int) -> int:
    return os.getpid()


def killed(_: int) -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def left(_: int) -> None:
    os._exit(3)


def faulty(_: int) -> None:
    raise ValueError("a bug")


def unsendable(_: int) -> object:
    return lambda: None


class TwoWordsError(Exception):
    """Pickles, and cannot be unpickled: it is made of two words, and keeps one."""

    def __init__(self, first: str, second: str) -> None:
        super().__init__(first + second)


def oddly_faulty(_: int) -> None:
    raise TwoWordsError("a ", "bug")


class Unreadable:
    """Raises where it is unpickled."""

    def __reduce__(self) -> object:
        return faulty, (0,)


def wait_for_ever(_: int) -> None:
    while True:
        time.sleep(1.0)


def hold(path: Path) -> None:
    """Lock, say so, and never give it back."""
    from experiments.lab.cache import claimed

    with claimed(path) as is_ours:
        print(is_ours, flush=True)
        time.sleep(1e6)


def work_off(pool: Pool, jobs: Sequence[Callable[[], Any]]) -> list["Future[Any]"]:
    """Have a pool do jobs, each one once."""
    found: list[Future[Any]] = []
    for job in jobs:
        running = [one for one in found if not one.done()]
        if len(running) >= pool.room:
            assert pool.ended(running, None)
        found.append(pool.submit(job))
    wait(found)
    return found


if __name__ == "__main__":
    hold(Path(sys.argv[1]))
