"""Locks whose holder is gone; `test_study.py` tests that a lock has one holder at a time."""

import os
import socket
import time

import pytest

from experiments.lab import cache
from experiments.lab.cache import claimed, remove_lapsed
from tests.left_over import ended_process


@pytest.fixture
def path(tmp_path):
    return tmp_path / "claims" / ".abc.claim"


def left_by(path, old, new):
    """Write the lock of another process: ours, with `old` replaced by `new`; return its text."""
    with claimed(path):
        mine = path.read_text()
    assert mine.count(old) == 1
    path.write_text(mine.replace(old, new))
    return path.read_text()


def test_what_a_killed_process_held_is_free_at_once(path):
    kept = path.with_name(".kept.claim")
    left = left_by(path, f"pid={os.getpid()}\n", f"pid={ended_process()}\n")
    with claimed(path) as is_ours:
        assert is_ours
    # Locks that nobody asks for again are removed, also the empty one of a process killed early.
    for text in (left, ""):
        path.write_text(text)
        with claimed(kept):
            remove_lapsed(path.parent)
            assert list(path.parent.iterdir()) == [kept]


def test_a_holder_elsewhere_keeps_it_until_it_is_silent_for_long(path, monkeypatch):
    now_s = 0.0
    monkeypatch.setattr(time, "monotonic", lambda: now_s)
    text = left_by(path, socket.gethostname(), "elsewhere")  # its process id is in use on this host

    def is_free_after(share):
        nonlocal now_s
        now_s += share * cache.LAPSES_S
        with claimed(path) as is_ours:
            return is_ours

    assert not is_free_after(0.0)
    assert not is_free_after(0.9)
    assert path.read_text() == text
    os.utime(path)  # a sign of life
    assert [is_free_after(share) for share in (0.9, 0.9, 0.2)] == [False, False, True]
    assert list(path.parent.iterdir()) == []
