"""A small part of the campaign; and that what must not be would be seen."""

import os
import signal
import time

import numpy as np
import pandas as pd
import pytest

from experiments.damage.cases import OUTCOMES, Ended, outcome, run_forked
from experiments.lab.cache import Cache
from experiments.lab.files import csv_text
from experiments.lab.results import Results
from experiments.lab.task import run_task, tasks_of
from experiments.studies.reliability import (
    BAD,
    EVENT_FILES,
    KINDS,
    STUDIES,
    damage_cells,
    reliability_faults,
    reliability_table,
    silent_share,
)
from ssac.errors import SsacError

N_CASES = 126  # six of each kind of input
(STUDY,) = STUDIES


def test_no_damaged_input_ends_as_it_must_not_and_the_table_counts_every_case_once(tmp_path):
    tasks = tasks_of(damage_cells(N_CASES, 1))
    assert [task.cells[0].end for task in tasks] == [100, 126]  # each can be done elsewhere
    rows = [row for task in tasks for row in run_task(task, Cache(tmp_path), STUDY.measure).rows]
    assert not [row["reason"] for row in rows if row["status"] != "ok"]
    again = [row for task in tasks for row in run_task(task, Cache(tmp_path), STUDY.measure).rows]
    assert again == rows  # from the cache
    table = reliability_table(pd.DataFrame(rows), Results(tmp_path))
    assert table["input"].tolist() == [*KINDS, "all"]
    assert table["cases"].tolist() == [*len(KINDS) * [6], N_CASES]
    assert not table[[*BAD, "silently_fewer"]].to_numpy().any()
    assert (table[list(OUTCOMES)].sum(axis=1) == table["cases"]).all()
    refused = table["refused"].iloc[-1]
    assert N_CASES // 4 < refused < N_CASES  # damage is done, and not all of it can be seen


def _said(line, error=SsacError):
    def work():
        raise error(line)

    return work


def _slow():
    time.sleep(60.0)


@pytest.mark.parametrize(
    ("work", "expected"),
    [
        (lambda: 100, "read"),
        (lambda: 98, "silently_fewer"),
        (_said("a.h5: is damaged"), "refused"),
        (_said("is damaged"), "unclear"),  # what is?
        (_said("a.h5", KeyError), "traceback"),
        (lambda: os.kill(os.getpid(), signal.SIGKILL), "abort"),
        (lambda: len(np.ones(1 << 40, np.uint8)), "over_memory"),
        (_slow, "hang"),
    ],
)
def test_each_outcome_is_told_from_the_others(work, expected, tmp_path):
    ended = run_forked(work, tmp_path, 0.3 if work is _slow else 20.0)
    assert outcome(ended, "a.h5", 100) == expected

    assert outcome(Ended(0, "warning: a.h5 is damaged\n", 5, False), "a.h5", 100) == "warned"


def _committed(**changed: int) -> pd.DataFrame:
    """The table of a whole campaign of which all event files are refused, but for some cases."""
    n_cases = damage_cells()[-1].end
    counts = [len(range(k, n_cases, len(KINDS))) for k in range(len(KINDS))]
    table = pd.DataFrame(0, index=list(KINDS), columns=list(OUTCOMES))
    table["refused"] = counts
    for name, n in changed.items():
        table.loc[KINDS[0], [name, "refused"]] += (n, -n)
    table.loc["all"] = table.sum()
    table.insert(0, "cases", [*counts, n_cases])
    return table.reset_index(names="input")


@pytest.mark.parametrize(
    ("table", "fault"),
    [
        (_committed(), None),
        (_committed().iloc[1:], "its kinds and cases are not"),
        (_committed(hang=1), "hang: 1"),
        (_committed().replace({"refused": {953: 952}}), "not as many as its cases"),
        (_committed().drop(columns="hang"), "its columns are"),
    ],
)
def test_the_committed_table_is_held_against_the_campaign(table, fault, tmp_path):
    (tmp_path / "reliability.csv").write_text(csv_text(table))
    faults = reliability_faults(Results(tmp_path))
    assert (fault in faults[0]) if fault else not faults


def test_few_may_be_read_with_fewer_events_in_silence(tmp_path):
    n_files = sum(_committed()["cases"][: len(EVENT_FILES)])
    for n, is_fault in ((n_files // 200, False), (n_files // 200 + 2, True)):
        table = _committed(silently_fewer=n)
        (tmp_path / "reliability.csv").write_text(csv_text(table))
        assert bool(reliability_faults(Results(tmp_path))) == is_fault
        assert silent_share(table) == n / n_files
