"""Claims: one holder at a time, taken over from those that are gone, given back to nobody else."""

import os
import subprocess
import sys
import threading
import time
from contextlib import suppress
from functools import partial
from pathlib import Path

import pytest

from experiments.lab import lock as claim
from experiments.lab.lock import LAPSES_S, claimed, remove_lapsed
from experiments.lab.pool import Processes
from tests.experiments.lab import jobs
from tests.experiments.lab.jobs import work_off
from tests.left_over import ELSEWHERE, let_lie, made_by

ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture
def path(tmp_path):
    return tmp_path / "claims" / ".abc.claim"


def write(path: Path, process: int, host: str = "") -> str:
    """Claim as another process does."""
    path.parent.mkdir(exist_ok=True)
    text = made_by(path, process, host).name
    path.write_text(text)
    return text


def test_one_holds_it_at_a_time_and_gives_it_back(path):
    with claimed(path) as first:
        with claimed(path) as second:
            assert (first, second) == (True, False)
        assert path.exists()
        with claimed(path.with_name(".other.claim")) as other:
            assert other
    with suppress(ValueError), claimed(path) as again:
        assert again
        raise ValueError("whatever it is")
    assert list(path.parent.iterdir()) == []


def test_two_processes_share_what_is_to_be_made(tmp_path):
    names = [f"file{number}" for number in range(40)]
    with Processes(2) as pool:
        found = work_off(pool, [partial(jobs.make_each_once, tmp_path, names)] * 2)
    assert [one.error for one in found.values()] == [None, None]
    assert sorted((tmp_path / "log").read_text().split()) == sorted(names)
    assert {path.name for path in tmp_path.iterdir()} == {"log", *names}


def test_what_a_killed_process_held_is_free_at_once(path):
    path.parent.mkdir()
    command = [sys.executable, "-m", "tests.experiments.lab.jobs", str(path)]
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    holder = subprocess.Popen(command, env=environment, cwd=ROOT, stdout=subprocess.PIPE)
    assert holder.stdout.readline() == b"True\n"
    with claimed(path) as is_ours:
        assert not is_ours
    holder.kill()
    holder.communicate()
    with claimed(path) as is_ours:
        assert is_ours


def test_an_equal_process_id_of_another_host_is_not_ours(path):
    # Neither the same process, nor one that can be known to have ended.
    for process in (os.getpid(), 2**22 + 1):
        text = write(path, process, ELSEWHERE)
        with claimed(path) as is_ours:
            assert not is_ours
        assert path.read_text() == text


@pytest.mark.parametrize("host", ["", ELSEWHERE])
def test_a_holder_that_is_silent_for_long_loses_it(path, host):
    write(path, os.getpid(), host)
    let_lie(path, 0.5 * LAPSES_S)
    with claimed(path) as is_ours:
        assert not is_ours
    let_lie(path, 2.0 * LAPSES_S)
    with claimed(path) as is_ours:
        assert is_ours
    assert list(path.parent.iterdir()) == []


def test_a_holder_is_not_silent(path, monkeypatch):
    monkeypatch.setattr(claim, "BEAT_S", 0.001)
    with claimed(path):
        let_lie(path, 2.0 * LAPSES_S)
        while path.stat().st_mtime < time.time() - LAPSES_S:  # until a beat has come
            time.sleep(0.01)
        with claimed(path) as is_ours:
            assert not is_ours


def test_who_lost_it_neither_touches_nor_gives_back_the_claim_of_another(path, monkeypatch):
    monkeypatch.setattr(claim, "BEAT_S", 0.001)
    with claimed(path):
        text = write(path, os.getpid(), ELSEWHERE)
        while any(thread.name == str(path) for thread in threading.enumerate()):
            time.sleep(0.001)  # until the next beat has seen it
        let_lie(path, 0.5 * LAPSES_S)
        before = path.stat().st_mtime_ns
    assert path.read_text() == text
    assert path.stat().st_mtime_ns == before


def test_of_two_that_take_over_the_second_leaves_it_to_the_first(path):
    # Both found the same claim lapsed; the first has made its own meanwhile.
    lapsed = write(path, os.getpid(), ELSEWHERE)
    new = write(path, os.getpid())
    claim._remove(path, lapsed)
    assert path.read_text() == new
    assert [one.name for one in path.parent.iterdir()] == [path.name]


def test_claims_of_the_gone_are_removed(path):
    kept = path.with_name(".kept.claim")
    write(path, os.getpid(), ELSEWHERE)
    let_lie(path, 2.0 * LAPSES_S)
    write(kept, os.getpid())
    remove_lapsed(path.parent)
    assert list(path.parent.iterdir()) == [kept]
