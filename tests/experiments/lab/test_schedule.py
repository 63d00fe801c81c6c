"""Tasks to rows: what is claimed elsewhere, what dies, and what a killed run left; no OpenGL.

Real processes that share a cache or die are in `tests/experiments/sweep`.
"""

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from experiments.lab import schedule, task
from experiments.lab.cache import Cache
from experiments.lab.cell import CRASHED, Measure
from experiments.lab.lock import claimed
from experiments.lab.pool import Alone, DiedError, Ended, done
from experiments.lab.schedule import MAX_DEATHS, Workers, run_cells
from experiments.lab.task import Task, recordings_key
from sim.recording import SimConfig
from tests.left_over import ended_process, made_by

NUMBERS = range(6)


@dataclass(frozen=True)
class NumberCell:
    number: int
    power: int

    @property
    def recordings(self) -> tuple[Any, ...]:
        return ((SimConfig(), self.number),)

    @property
    def columns(self) -> dict[str, Any]:
        return {"number": self.number, "power": self.power}

    @property
    def inputs(self) -> int:
        return self.power


@dataclass(frozen=True)
class NumberRow:
    status: str
    reason: str = ""
    value: int = 0


LOADED: list[int] = []


def load_number(cells: Sequence[NumberCell], _: Cache) -> int:
    LOADED.append(cells[0].number)
    return cells[0].number


def number_row(cell: NumberCell, number: int) -> NumberRow:
    return NumberRow("ok", "", number**cell.power)


MEASURE = Measure(load_number, number_row, NumberRow)

CELLS = [NumberCell(number, power) for power in (1, 2) for number in NUMBERS]


@pytest.fixture(autouse=True)
def no_gl(monkeypatch: pytest.MonkeyPatch) -> None:
    """Numbers need no recordings, so no OpenGL, and stand in no module of ours."""
    LOADED.clear()
    monkeypatch.setattr(task, "recording_key", lambda sim, seed: f"recording {seed}")
    monkeypatch.setattr(task, "run_key", lambda *parts: str(abs(hash(parts))))


class Mortal:
    """A pool of two that does its jobs here, and whose workers die when it is told."""

    def __init__(self, deaths: dict[int, int]) -> None:
        self.deaths = dict(deaths)  # how often a job kills its worker
        self.jobs: list[tuple[int, Any]] = []
        self.given: list[int] = []

    def has_room(self) -> bool:
        return len(self.jobs) < 2

    def give(self, number: int, job: Any) -> None:
        self.given.append(number)
        self.jobs.append((number, job))

    def ended(self, timeout_s: float | None) -> list[Ended]:
        del timeout_s
        number, job = self.jobs.pop(0)
        if self.deaths.get(number, 0):
            self.deaths[number] -= 1
            return [Ended(number, None, DiedError("ended by SIGKILL"))]
        return [done(number, job)]

    def __enter__(self) -> "Mortal":
        return self

    def __exit__(self, *_: object) -> None:
        assert not self.jobs


def run(cache: Path, **options: Any) -> Any:
    return run_cells(CELLS, Cache(cache), Workers(1), measure=MEASURE, **options)


def values(outcome: Any) -> list[int]:
    """Values of all rows, in the order of the cells."""
    return [int(value) for value in outcome.runs["value"]]


EXPECTED = [number**power for power in (1, 2) for number in NUMBERS]


def test_a_worker_that_dies_once_costs_its_task_nothing_but_time(tmp_path, monkeypatch, capsys):
    pool = Mortal({1: 1, 4: 1})
    monkeypatch.setattr(schedule, "_pool", lambda *_: pool)
    outcome = run(tmp_path)
    assert values(outcome) == EXPECTED
    assert (outcome.n_deaths, outcome.n_crashed) == (2, 0)
    assert sorted(pool.given) == sorted([*NUMBERS, 1, 4])
    assert pool.given[:2] == [0, 1]
    said = capsys.readouterr().err
    assert said.count("run again by a new one") == 2
    assert "a worker ended by SIGKILL on the flight of 20 s at 90 deg with seed 1" in said


def test_a_task_that_kills_all_its_workers_is_a_crash_and_the_others_go_on(
    tmp_path, monkeypatch, capsys
):
    pool = Mortal({2: 100})
    monkeypatch.setattr(schedule, "_pool", lambda *_: pool)
    outcome = run(tmp_path)
    assert pool.given.count(2) == MAX_DEATHS
    runs = outcome.runs
    crashed = runs[runs["number"] == 2]
    assert (crashed["status"] == CRASHED).all()
    expected = f"worker: DiedError: {MAX_DEATHS} workers died of it, the last one ended by SIGKILL"
    assert (crashed["reason"] == expected).all()
    assert (runs[runs["number"] != 2]["status"] == "ok").all()
    assert outcome.n_deaths == MAX_DEATHS
    assert "given up" in capsys.readouterr().err
    # It is not kept: the next run tries it again, and nothing else.
    monkeypatch.setattr(schedule, "_pool", lambda *_: Alone())
    LOADED.clear()
    assert values(run(tmp_path)) == EXPECTED
    assert LOADED == [2]


def test_what_another_run_is_on_comes_last_and_is_not_done_twice(tmp_path, monkeypatch, capsys):
    cache = Cache(tmp_path)
    first = Task(tuple(cell for cell in CELLS if cell.number == 0))
    claim = cache.claim_of_runs(recordings_key(first))
    with ExitStack() as other:
        assert other.enter_context(claimed(claim))

        def sleep(_: float) -> None:
            if 0 not in LOADED:  # the other run takes its time
                assert [*NUMBERS][1:] == LOADED  # all that is left is its
                task.run_task(first, cache, MEASURE)
                other.close()

        monkeypatch.setattr(schedule, "ASK_AGAIN_S", 0.01)
        monkeypatch.setattr(schedule.time, "sleep", sleep)
        outcome = run(tmp_path)
    assert values(outcome) == EXPECTED
    assert sorted(LOADED) == [*NUMBERS]
    assert not list(tmp_path.rglob("*.claim"))
    assert "waiting for what another run is on: 1 recordings" in capsys.readouterr().err


def test_what_another_run_gives_up_is_done_here(tmp_path, monkeypatch):
    claim = Cache(tmp_path).claim_of_runs(recordings_key(Task((CELLS[0],))))
    with ExitStack() as other:
        other.enter_context(claimed(claim))
        monkeypatch.setattr(schedule, "ASK_AGAIN_S", 0.01)
        monkeypatch.setattr(schedule.time, "sleep", lambda _: other.close())
        assert values(run(tmp_path)) == EXPECTED
    assert LOADED == [1, 2, 3, 4, 5, 0]


def test_what_killed_runs_left_is_removed(tmp_path):
    ended = ended_process()
    recordings, runs = tmp_path / "recordings", tmp_path / "runs"
    (recordings / "whole").mkdir(parents=True)
    (runs / "ab").mkdir(parents=True)
    left = made_by(recordings / "half", ended)
    left.mkdir()
    (left / "cam1.h5").touch()
    made_by(runs / "ab" / "abc.json", ended).touch()
    run(tmp_path)
    assert [path.name for path in recordings.iterdir()] == ["whole"]
    assert not list(tmp_path.rglob(".*"))


def test_one_process_is_this_one_and_nothing_to_do_needs_none():
    assert isinstance(schedule._pool(Workers(1), 5), Alone)
    assert isinstance(schedule._pool(Workers(scheduler="tcp://127.0.0.1:9"), 0), Alone)
    # One task may take its worker down, but not this process with it.
    assert not isinstance(schedule._pool(Workers(2), 1), Alone)


def test_a_crash_is_tried_again_and_a_row_is_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(cell: NumberCell, number: int) -> NumberRow:
        raise KeyError("a bug")

    monkeypatch.setattr(task, "run_key", lambda recordings, inputs, code: f"{recordings} {inputs}")
    for row, status in ((broken, CRASHED), (broken, CRASHED), (number_row, "ok"), (broken, "ok")):
        measure = Measure(load_number, row, NumberRow)
        outcome = run_cells(CELLS[:1], Cache(tmp_path), Workers(1), measure=measure)
        assert list(outcome.runs["status"]) == [status]
