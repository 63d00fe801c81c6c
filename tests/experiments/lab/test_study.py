"""Cells become rows and files: resumed, in shards, with crashes, other runs and dead workers."""

import json
from concurrent.futures import Future
from contextlib import ExitStack
from dataclasses import dataclass, replace
from typing import Any

import pandas as pd
import pytest

from experiments import commands
from experiments.lab import schedule
from experiments.lab import study as module
from experiments.lab.cache import Cache, claimed
from experiments.lab.cell import CRASHED, Measure
from experiments.lab.pool import DiedError, Pool, Processes
from experiments.lab.results import SUMS_FILE, csv_text, read_table
from experiments.lab.schedule import MAX_DEATHS, Workers, recordings_key, run_cells
from experiments.lab.study import Runs, check_runs, run_study
from sim.recording import SimConfig
from ssac.errors import SsacError, WriteError
from tests.experiments.command import run as command
from tests.experiments.lab.squares import SQUARES, SquareCell, SquareRow

LOADED = []  # numbers whose recordings were loaded
FAULTS = {}  # errors to raise, by "number 3" or "power 2"


@dataclass(frozen=True)
class PowerCell(SquareCell):
    """A power of a number, divided by 7; each number stands for a recording."""

    power: int

    @property
    def recordings(self):
        return ((SimConfig(), self.number),)

    @property
    def columns(self):
        return {**super().columns, "power": self.power}


def load_number(cells, _):
    number = cells[0].number
    LOADED.append(number)
    if f"number {number}" in FAULTS:
        raise FAULTS[f"number {number}"]
    return number


def power_row(cell, number):
    if f"power {cell.power}" in FAULTS:
        raise FAULTS[f"power {cell.power}"]
    return SquareRow("ok", "", number**cell.power / 7)


CELLS = [PowerCell(number, power) for power in (1, 2) for number in range(4)]
VALUES = [cell.number**cell.power / 7 for cell in CELLS]
MEASURE = Measure(load_number, power_row, SquareRow)
STUDY = replace(
    SQUARES, cells=lambda: CELLS, measure=MEASURE, config={"powers": (1, 2)},
    runs=Runs("squares_runs.csv", ("number", "power")),
)  # fmt: skip


@pytest.fixture(autouse=True)
def no_gl(monkeypatch):
    """Replace keys and OpenGL: numbers need no recording, and their code is in none of our keys."""
    LOADED.clear()
    FAULTS.clear()
    monkeypatch.setattr(schedule, "recording_key", lambda sim, seed: f"recording {seed}")
    monkeypatch.setattr(schedule, "run_key", lambda *parts: str(abs(hash(parts))))
    monkeypatch.setattr(module, "context_or_none", lambda: None)
    monkeypatch.setattr(commands, "all_studies", lambda: {"squares": STUDY})


def run(cache):
    return run_study(STUDY, Cache(cache), Workers(1))


def study(*arguments):
    return command("study", *arguments, "--workers", 1)


def test_every_cell_is_a_row_and_the_files_follow_from_it(tmp_path):
    study("squares", "--out", tmp_path, "--cache", tmp_path / "cache")
    names = {path.name for path in tmp_path.iterdir() if path.is_file()}
    assert names == {*STUDY.files, *STUDY.provenances, SUMS_FILE}
    first, second, third, *_ = (tmp_path / "squares_runs.csv").read_text().splitlines()
    assert first == "cell,number,pair,power,status,reason,square"
    assert second == '0,0,"[0, 1]",1,ok,,0'
    assert third == '1,1,"[1, 1]",1,ok,,0.142857'
    assert (tmp_path / "squares.csv").read_text().splitlines()[1] == "low,0.428571"
    content = json.loads((tmp_path / "squares_runs.provenance.json").read_text())
    assert content["command"] == "ssac study squares"
    assert content["config"] == {"study": "squares", "shard": "1/1", "powers": [1, 2]}


def test_merged_shards_are_the_same_bytes_even_where_one_has_no_rows(tmp_path):
    study("squares", "--out", tmp_path, "--cache", tmp_path / "cache")
    parts, out = [], tmp_path / "merged" / "squares_runs.csv"
    for index in range(1, 6):  # of four recordings
        folder = tmp_path / f"part{index}"
        study("squares", "--out", folder, "--cache", folder, "--shard", f"{index}/5")
        assert not (folder / "squares.csv").exists()
        parts.append(folder / "squares_runs.csv")
    assert parts[4].read_text() == "cell,number,pair,power,status,reason,square\n"
    command("merge", out, *reversed(parts))
    for name in ("squares_runs.csv", "squares.csv", "squares.png"):
        assert (out.parent / name).read_bytes() == (tmp_path / name).read_bytes(), name
    merged = json.loads((out.parent / "squares.provenance.json").read_text())
    shards = [one["config"]["shard"] for one in merged["shards"]]
    assert shards == ["5/5", "4/5", "3/5", "2/5", "1/5"]

    def refused(said, *shards, out=tmp_path / "x" / "squares_runs.csv"):
        with pytest.raises(SsacError, match=said):
            command("merge", out, *shards)
        assert not out.exists()

    refused("2 of 8 cells are in none of the shards", *parts[:3])
    refused("cell 0 is in", parts[0], parts[0])
    refused(r"are named squares_runs\.csv", *parts, out=tmp_path / "x.csv")
    beside = parts[1].with_suffix(".provenance.json")
    text, content = parts[1].read_text(), json.loads(beside.read_text())
    for new, change, said in (
        (text, {"config": content["config"] | {"powers": [3]}}, "is of another grid"),
        (text, {"commit": "0123456789ab"}, "is of the code 0123456789ab, and"),
        (text.replace("square", "worth", 1), {}, "has other columns"),
        ("", {}, "is empty, or its end is missing: run this shard again"),
        (text[:-3], {}, "is empty, or its end is missing: run this shard again"),
        (f"{text}-1,x\n", {}, "a row begins with '-1', no cell's number"),
    ):
        parts[1].write_text(new)
        beside.write_text(json.dumps(content | change))
        refused(said, *parts)
    beside.unlink()
    refused(r"expected squares_runs\.provenance\.json beside it", *parts)


def test_gaps_in_the_runs_are_found(tmp_path):
    with pytest.raises(SsacError, match="squares: there are no runs with these options"):
        run_study(replace(STUDY, cells=list), Cache(tmp_path), Workers(1))
    runs = read_table(csv_text(run(tmp_path).runs))
    check_runs(STUDY, runs, CELLS)
    for damaged, said in (
        (runs.drop(index=3), "the cells 0 to 7 in order, got 7 rows"),
        (runs.iloc[[1, 0, *range(2, 8)]], "the cells 0 to 7 in order"),
        (runs.assign(number=runs["number"].replace(2, 0)), r"row 2 is of .*'number': 0"),
        (runs.assign(pair="[1, 1]"), "row 0 is of"),
        (runs.drop(columns="power"), "no columns power"),
    ):
        with pytest.raises(SsacError, match=said):
            check_runs(STUDY, damaged, CELLS)


@pytest.mark.parametrize("error", [KeyboardInterrupt(), WriteError("the disk is full")])
def test_what_is_done_is_not_done_again_and_a_stopped_study_goes_on(tmp_path, capsys, error):
    FAULTS["number 2"] = error
    with pytest.raises(type(error)):
        run(tmp_path)
    assert f"stopped: 2 of 4 recordings are done and kept in {tmp_path}" in capsys.readouterr().err
    assert LOADED == [0, 1, 2]
    FAULTS.clear()
    tables = []
    for loaded in ([2, 3], []):  # each once, for both powers
        LOADED.clear()
        tables.append(run(tmp_path).runs)
        assert loaded == LOADED
    assert list(tables[0]["square"]) == VALUES
    assert list(tables[0]["status"]) == ["ok"] * 8
    pd.testing.assert_frame_equal(*tables)


def test_a_crash_is_a_row_that_is_tried_again_and_leaves_the_others(tmp_path):
    FAULTS["power 2"] = RuntimeError("a bug")
    FAULTS["number 1"] = SsacError("unreadable")
    runs = run(tmp_path).runs.set_index(["number", "power"])
    assert len(runs) == 8
    assert list(runs.loc[(0, 2), ["status", "reason"]]) == [CRASHED, "2: RuntimeError: a bug"]
    assert runs.loc[(0, 1), "status"] == "ok"
    assert list(runs.loc[1, "status"]) == ["unusable"] * 2
    FAULTS.clear()
    for loaded in ([0, 1, 2, 3], []):
        LOADED.clear()
        assert set(run(tmp_path).runs["status"]) == {"ok"}
        assert loaded == LOADED


def test_what_a_method_refuses_is_kept_and_a_full_disk_stops_the_study(tmp_path):
    FAULTS["power 1"] = SsacError("too few points")
    FAULTS["power 2"] = WriteError("the disk is full")
    with pytest.raises(WriteError):
        run(tmp_path)
    FAULTS.clear()
    # The first cell is that of number 0 and power 1.
    assert list(run(tmp_path).runs["status"]) == ["unusable", *["ok"] * 7]


@pytest.mark.parametrize("finishes", [True, False])
def test_what_another_run_is_on_comes_last_and_is_done_once_by_it_or_here(
    tmp_path, monkeypatch, capsys, finishes
):
    cache = Cache(tmp_path)
    first = tuple(cell for cell in CELLS if cell.number == 0)
    with ExitStack() as other:
        assert other.enter_context(claimed(cache.claim_of_runs(recordings_key(first))))

        def sleep(_):
            if 0 not in LOADED:  # the other run takes its time
                assert LOADED == [1, 2, 3]  # the other run holds all that is left
                if finishes:
                    schedule.run_task(first, cache, MEASURE)
                other.close()

        monkeypatch.setattr(schedule, "ASK_AGAIN_S", 0.01)
        monkeypatch.setattr(schedule.time, "sleep", sleep)
        outcome = run(tmp_path)
    assert list(outcome.runs["square"]) == VALUES
    assert LOADED == [1, 2, 3, 0]
    assert not list(tmp_path.rglob("*.claim"))
    assert "waiting for what another run is on: 1 recordings" in capsys.readouterr().err


class Mortal(Pool):
    """A pool of two that runs its jobs in this process; the recording of 2 kills its workers."""

    room = 2

    def submit(self, job):
        if job.args[0][0].number != 2:
            return super().submit(job)
        future: Future[Any] = Future()
        future.set_exception(DiedError("ended by SIGKILL"))
        return future


def test_a_task_that_kills_its_workers_is_a_crash_and_others_go_on(tmp_path, monkeypatch, capsys):
    with monkeypatch.context() as with_deaths:
        with_deaths.setattr(schedule, "_pool", lambda *_: Mortal())
        outcome = run(tmp_path)
    assert outcome.n_deaths == MAX_DEATHS
    reason = f"worker: DiedError: {MAX_DEATHS} workers died of it, the last one ended by SIGKILL"
    ended = set(outcome.runs[["number", "status", "reason"]].itertuples(index=False, name=None))
    assert ended == {(2, CRASHED, reason), *((number, "ok", "") for number in (0, 1, 3))}
    assert "given up" in capsys.readouterr().err
    # A crash is not cached: the next run repeats that task, and nothing else.
    LOADED.clear()
    assert list(run(tmp_path).runs["square"]) == VALUES
    assert LOADED == [2]


def test_nothing_to_do_needs_no_workers_and_one_task_has_a_process_of_its_own(tmp_path):
    absent = Workers(scheduler="tcp://127.0.0.1:9")
    assert len(run_cells([], Cache(tmp_path), absent, measure=MEASURE).runs) == 0
    # One task may take its worker down, but not this process with it.
    assert isinstance(schedule._pool(Workers(2), 1), Processes)
