"""Worker processes: dead ones are replaced, and a job that fails harms no other job."""

import os
import signal
import time
from concurrent.futures import wait
from functools import partial
from operator import mul
from threading import Lock

import pytest

from experiments.lab import pool as module
from experiments.lab.pool import DiedError, Pool, Processes, in_new_process


class UnreadableError(Exception):
    """It raises an error when it is unpickled."""

    def __reduce__(self):
        return int, ("a bug",)


def oddly_faulty():
    raise UnreadableError


def square(number):
    return partial(mul, number, number)


def work_off(pool, jobs):
    found = []
    for job in jobs:
        running = [one for one in found if not one.done()]
        if len(running) >= pool.room:
            assert pool.ended(running, None)
        found.append(pool.submit(job))
    wait(found)
    return found


def result_of(job):
    with Processes(1) as pool:
        return work_off(pool, [job])[0].result()


@pytest.mark.parametrize(
    "pool", [Pool, partial(Processes, 1), partial(Processes, 2)], ids=["here", "1", "2"]
)
def test_every_job_ends_once_with_what_it_returned_or_raised(pool):
    tasks = [square(number) for number in range(5)] + [partial(int, "a bug")]
    with pool() as workers:
        *found, failed = work_off(workers, tasks)
    assert [one.result() for one in found] == [0, 1, 4, 9, 16]
    assert isinstance(failed.exception(), ValueError)
    assert "'a bug'" in str(failed.exception())


@pytest.mark.parametrize(
    ("job", "error", "said"),
    [
        (partial(signal.raise_signal, signal.SIGKILL), DiedError, "ended by SIGKILL"),
        (partial(os._exit, 3), DiedError, "ended with code 3"),
        (Lock, TypeError, "lock"),  # a result that cannot be pickled
        (partial(abs, UnreadableError()), ValueError, "a bug"),
        (oddly_faulty, ValueError, "a bug"),
    ],
)
def test_a_job_that_dies_or_cannot_be_sent_takes_no_other_with_it(job, error, said):
    tasks = [job if number in (1, 4) else square(number) for number in range(8)]
    with Processes(2) as pool:
        found = work_off(pool, tasks)
    for number, one in enumerate(found):
        if number in (1, 4):
            assert type(one.exception()) is error
            assert said in str(one.exception())
        else:
            assert one.result() == number * number


def test_workers_serve_one_pool_after_the_other_and_one_that_died_idle_costs_nothing():
    pid, again = result_of(os.getpid), result_of(os.getpid)
    assert pid == again != os.getpid()
    worker = next(one for one in module._IDLE if one.process.pid == pid)
    os.kill(pid, signal.SIGKILL)
    worker.process.join()
    assert result_of(square(3)) == 9


def test_a_pool_that_is_left_ends_what_it_was_on():
    with Processes(1) as pool:
        pool.submit(partial(time.sleep, 1e6))
        (worker,) = pool._busy
    assert worker.process.exitcode == -signal.SIGTERM


def test_a_process_of_its_own_may_start_more():
    assert in_new_process(partial(result_of, square(3))) == 9  # as the one that makes the tables
