"""Locks: one holder at a time, taken over from those that are gone, given back to nobody else."""

import os
import socket
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import pytest

from experiments.lab import cache
from experiments.lab.cache import claimed, remove_lapsed
from experiments.lab.code import ROOT

HOLDING = """
import sys, time
from pathlib import Path
from experiments.lab.cache import claimed

with claimed(Path(sys.argv[1])) as is_ours:
    print(is_ours, flush=True)
    time.sleep(1e6)
"""


@pytest.fixture
def path(tmp_path):
    return tmp_path / "claims" / ".abc.claim"


def write_elsewhere(path: Path) -> str:
    """Hold a lock as a process of another host does, whose id is one of ours."""
    with claimed(path) as is_ours:
        assert is_ours
        mine = path.read_text()
    text = mine.replace(socket.gethostname(), "elsewhere")
    assert text != mine
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


def test_what_a_killed_process_held_is_free_at_once(path):
    path.parent.mkdir()
    kept = path.with_name(".kept.claim")
    command = [sys.executable, "-c", HOLDING, str(path)]
    holder = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE)
    assert holder.stdout.readline() == b"True\n"
    with claimed(path) as is_ours:
        assert not is_ours
    remove_lapsed(path.parent)
    assert path.exists()
    holder.kill()
    holder.communicate()
    left = path.read_text()
    with claimed(path) as is_ours:
        assert is_ours
    # And what nobody asks for again is tidied away, also of one that was killed as it began.
    for text in (left, ""):
        path.write_text(text)
        with claimed(kept):
            remove_lapsed(path.parent)
            assert list(path.parent.iterdir()) == [kept]


def test_a_holder_elsewhere_keeps_it_until_it_is_silent_for_long(path, monkeypatch):
    now_s = 0.0
    monkeypatch.setattr(time, "monotonic", lambda: now_s)
    text = write_elsewhere(path)

    def is_free_after(share: float) -> bool:
        nonlocal now_s
        now_s += share * cache.LAPSES_S
        with claimed(path) as is_ours:
            return is_ours

    assert not is_free_after(0.0)
    assert not is_free_after(0.9)
    assert path.read_text() == text
    os.utime(path)  # a sign of life
    assert not is_free_after(0.9)
    assert not is_free_after(0.9)
    assert is_free_after(0.2)
    assert list(path.parent.iterdir()) == []


def test_a_holder_is_not_silent_and_does_not_give_back_the_lock_of_another(path, monkeypatch):
    monkeypatch.setattr(cache, "LAPSES_S", 0.6)
    with claimed(path):
        before = path.stat().st_mtime_ns
        time.sleep(1.5)
        assert path.stat().st_mtime_ns > before
        with claimed(path) as is_ours:
            assert not is_ours
    monkeypatch.undo()
    with claimed(path):
        path.unlink()
        text = write_elsewhere(path)
    assert path.read_text() == text
