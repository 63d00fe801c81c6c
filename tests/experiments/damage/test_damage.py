"""A small part of the campaign; and that what must not be would be seen."""

import os
import signal
import time
from functools import partial
from itertools import islice

import numpy as np
import pytest

from experiments.damage import campaign as module
from experiments.damage.campaign import campaign
from experiments.damage.command import command_of
from experiments.damage.forked import Ended, outcome, run_forked
from experiments.damage.reliability import (
    BAD,
    COMMAND,
    COMMITTED,
    CSV_FILE,
    EVENT_FILES,
    OTHER_INPUTS,
    OUTCOMES,
    Case,
    Extent,
    reliability_faults,
    reliability_table,
    silent_share,
)
from experiments.lab.cache import Cache
from experiments.lab.results import Results
from experiments.quoted.tables import TABLES
from ssac.errors import SsacError

N_CASES = 126  # six of each kind of input


def test_no_damaged_input_ends_as_it_must_not(tmp_path):
    cases = list(campaign(Extent(N_CASES, 1), tmp_path, Cache(tmp_path / "cache")))
    assert {one.kind for one in cases} == {*EVENT_FILES, *OTHER_INPUTS}
    bad = [one for one in cases if one.outcome in (*BAD, "silently_fewer")]
    assert not bad
    refused = sum(one.outcome == "refused" for one in cases)
    assert N_CASES // 4 < refused < N_CASES  # damage is done, and not all of it can be seen


def test_a_campaign_that_was_stopped_goes_on_where_it_was(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "CASES_PER_ENTRY", 4)
    cache = Cache(tmp_path / "cache")
    some = list(islice(campaign(Extent(12, 5), tmp_path / "first", cache), 5))  # then it is stopped
    assert len(list((cache.folder / "runs").rglob("*.json"))) == 2
    monkeypatch.setattr(module, "damaged_case", partial(_other_case, module.damaged_case))
    cases = list(campaign(Extent(12, 5), tmp_path / "again", cache))
    assert cases[:8] == some + cases[5:8]
    assert [one.said == "anew" for one in cases] == 8 * [False] + 4 * [True]
    other = list(campaign(Extent(4, 5), tmp_path / "other", Cache(tmp_path / "none")))
    assert [one.damage for one in other] == [one.damage for one in cases[:4]]  # of the seed alone


def _other_case(make, *arguments):
    return make(*arguments)._replace(said="anew")


def _said(line, error=SsacError):
    def work():
        raise error(line)

    return work


def _killed():
    os.kill(os.getpid(), signal.SIGKILL)
    return 1


def _large():
    return len(np.ones(1 << 40, np.uint8))


def _slow():
    time.sleep(60.0)
    return 1


@pytest.mark.parametrize(
    ("work", "expected"),
    [
        (lambda: 100, "read"),
        (lambda: 98, "silently_fewer"),
        (_said("a.h5: is damaged"), "refused"),
        (_said("is damaged"), "unclear"),  # what is?
        (_said("a.h5", KeyError), "traceback"),
        (_killed, "abort"),
        (_large, "over_memory"),
        (_slow, "hang"),
    ],
)
def test_each_outcome_is_told_from_the_others(work, expected, tmp_path):
    ended = run_forked(work, tmp_path, 0.3 if work is _slow else 20.0)
    assert outcome(ended, "a.h5", 100) == expected


def test_a_warning_is_none_of_silence():
    assert outcome(Ended(0, "warning: a.h5 is damaged\n", 5, False), "a.h5", 100) == "warned"


def test_the_table_counts_every_case_once():
    cases = [Case("a", "flip", k, OUTCOMES[k % 3], "") for k in range(7)]
    counts = reliability_table([*cases, Case("b", "cut", 7, "shorter", "")])
    assert counts["input"].tolist() == ["a", "b", "all"]
    assert counts["cases"].tolist() == [7, 1, 8]
    assert (counts[list(OUTCOMES)].sum(axis=1) == counts["cases"]).all()


def _whole_campaign():
    counts = COMMITTED.counts()
    return [
        Case(kind, "flip", k, "refused" if kind in EVENT_FILES else "right", "")
        for kind, n in counts.items()
        for k in range(n)
    ]


def _faults(folder, cases):
    reliability_table(cases).to_csv(folder / CSV_FILE, index=False)
    return reliability_faults(folder)


def test_the_committed_table_is_held_against_the_campaign_and_its_marks(tmp_path):
    cases = _whole_campaign()
    assert _faults(tmp_path, cases) == ()
    assert "its kinds and cases are not" in _faults(tmp_path, cases[1:])[0]
    assert _faults(tmp_path, [cases[0]._replace(outcome="hang"), *cases[1:]]) == ("hang: 1",)
    n_files = sum(COMMITTED.counts()[kind] for kind in EVENT_FILES)
    for n, is_fault in ((n_files // 200, False), (n_files // 200 + 2, True)):
        silent = [one._replace(outcome="silently_fewer") for one in cases[:n]]
        assert bool(_faults(tmp_path, [*silent, *cases[n:]])) == is_fault
        assert silent_share(reliability_table([*silent, *cases[n:]])) == n / n_files


def test_the_page_shows_the_committed_table_and_nothing_where_there_is_none(tmp_path):
    show = TABLES["table.reliability"]
    assert show(Results(tmp_path)) == ""
    cases = [Case("es", name, k, name, "") for k, name in enumerate(OUTCOMES)]
    reliability_table(cases).to_csv(tmp_path / CSV_FILE, index=False)
    rows = show(Results(tmp_path)).splitlines()
    n_good = len(OUTCOMES) - len(BAD) - 1  # "right" is shown no more
    assert [word.strip() for word in rows[-1].split("|")[1:-1]] == [
        "all",
        str(len(OUTCOMES)),
        *n_good * ["1"],
        str(len(BAD)),
    ]


def test_the_provenance_has_the_command_line_that_was_given():
    assert command_of(COMMITTED) == COMMAND
    assert command_of(Extent(cases=100)) == f"{COMMAND} --cases 100"
