"""Worker processes: those that die are replaced, and none outlives the one that started it."""

import os
import signal
import subprocess
import sys
from functools import partial
from pathlib import Path

import pytest

from experiments.lab import pool as module
from experiments.lab.pool import Alone, DiedError, Processes, n_cores
from tests.experiments.lab import jobs
from tests.experiments.lab.jobs import work_off

ROOT = Path(__file__).resolve().parents[3]


@pytest.mark.parametrize("pool", [Alone, partial(Processes, 1), partial(Processes, 2)])
def test_every_job_ends_once_with_what_it_returned_or_raised(pool):
    tasks = [partial(jobs.square, number) for number in range(5)] + [partial(jobs.faulty, 5)]
    with pool() as workers:
        found = work_off(workers, tasks)
        assert workers.ended(0.0) == []
    assert [found[number].value for number in range(5)] == [0, 1, 4, 9, 16]
    assert repr(found[5].error) == "ValueError('a bug')"


@pytest.mark.parametrize(
    ("job", "how"), [(jobs.killed, "ended by SIGKILL"), (jobs.left, "ended with code 3")]
)
def test_a_worker_that_dies_takes_its_own_job_and_no_other(job, how):
    tasks = [partial(job if number in (1, 4) else jobs.square, number) for number in range(8)]
    with Processes(2) as pool:
        found = work_off(pool, tasks)
        for number in range(8):
            error = found[number].error
            if number in (1, 4):
                assert isinstance(error, DiedError)
                assert str(error) == how
            else:
                assert (found[number].value, error) == (number * number, None)
        # And there still are two of them.
        for number in (0, 1):
            assert pool.has_room()
            pool.give(number, partial(jobs.square, number))
        assert not pool.has_room()


def test_a_worker_that_died_idle_costs_nothing():
    with Processes(1) as pool:
        pid = work_off(pool, [partial(jobs.who, 0)])[0].value
        worker = next(one for one in module._IDLE if one.process.pid == pid)
        os.kill(pid, signal.SIGKILL)
        worker.process.join()
        assert work_off(pool, [partial(jobs.square, 3)])[0].value == 9


def test_workers_serve_one_crew_after_the_other():
    pids = []
    for _ in range(2):
        with Processes(1) as pool:
            pids.append(work_off(pool, [partial(jobs.who, 0)])[0].value)
    assert pids[0] == pids[1] != os.getpid()


def test_a_crew_that_is_left_ends_what_it_was_on():
    with Processes(1) as pool:
        pool.give(0, partial(jobs.wait_for_ever, 0))
        ((worker, _),) = pool._busy.values()
    assert worker.process.exitcode == -signal.SIGTERM


def test_what_cannot_be_sent_is_an_error_and_no_death():
    with Processes(1) as pool:
        found = work_off(
            pool, [partial(jobs.unsendable, 0), partial(jobs.square, jobs.Unreadable())]
        )
    assert isinstance(found[0].error, TypeError)
    assert "lambda" in str(found[0].error)
    assert repr(found[1].error) == "ValueError('a bug')"


def test_an_error_that_cannot_be_read_back_is_an_error_and_no_death():
    with Processes(1) as pool:
        found = work_off(pool, [partial(jobs.oddly_faulty, 0), partial(jobs.square, 3)])
    assert isinstance(found[0].error, TypeError)
    assert "second" in str(found[0].error)
    assert found[1].value == 9


def test_workers_end_when_the_process_that_started_them_is_killed():
    command = [sys.executable, "-m", "tests.experiments.lab.jobs"]
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    parent = subprocess.Popen(command, env=environment, cwd=ROOT, stdout=subprocess.PIPE)
    assert [parent.stdout.readline() for _ in range(2)] == [b"waiting\n"] * 2
    parent.kill()
    # The pipe ends when nobody holds its other end: neither the parent nor a worker.
    assert parent.communicate(timeout=60)[0] == b""
    assert parent.returncode == -signal.SIGKILL


def test_there_is_a_core():
    assert 1 <= n_cores() <= (os.cpu_count() or 1)
