"""A small part of the campaign; and that what must not be would be seen."""

import os
import signal
import time

import numpy as np
import pytest

from experiments.torture import case
from experiments.torture.campaign import BAD, OUTCOMES, campaign, table
from experiments.torture.case import Case, Ended, in_own_process, outcome
from ssac.errors import SsacError

N_CASES = 126  # six of each kind of input


def test_no_damaged_input_ends_as_it_must_not(tmp_path):
    cases = campaign(N_CASES, 1, tmp_path)
    assert len({one.kind for one in cases}) == 21
    bad = [one for one in cases if one.outcome in (*BAD, "silently_fewer")]
    assert not bad
    refused = sum(one.outcome == "refused" for one in cases)
    assert N_CASES // 4 < refused < N_CASES  # damage is done, and not all of it can be seen


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
def test_each_outcome_is_told_from_the_others(work, expected, tmp_path, monkeypatch):
    monkeypatch.setattr(case, "MAX_S", 0.3 if work is _slow else 20.0)
    assert outcome(in_own_process(work, tmp_path), "a.h5", 100) == expected


def test_a_warning_is_none_of_silence():
    assert outcome(Ended(0, "warning: a.h5 is damaged\n", 5, False), "a.h5", 100) == "warned"


def test_the_table_counts_every_case_once():
    cases = [Case("a", "flip", k, OUTCOMES[k % 3], "") for k in range(7)]
    counts = table([*cases, Case("b", "cut", 7, "shorter", "")])
    assert counts["input"].tolist() == ["a", "b", "all"]
    assert counts["cases"].tolist() == [7, 1, 8]
    assert (counts[list(OUTCOMES)].sum(axis=1) == counts["cases"]).all()
