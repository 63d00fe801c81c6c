"""Progress on stderr: lines where it is a file, and a bar on a terminal."""

import sys
import time

import numba
import pytest

from ssac.cli import progress as module
from ssac.cli.progress import Lines, compilation_told, progress, say


def test_compiling_is_told_once_and_only_where_something_is_compiled(capsys):
    with compilation_told():
        one, other = (numba.njit(lambda x, k=k: x + k) for k in (1, 2))
        assert capsys.readouterr().err == ""
        assert one(1) + other(1) == 5
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("compiling kernels")
    with compilation_told():
        one(1)
    assert capsys.readouterr().err == ""


class Clock:
    """A clock that is set by hand."""

    now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


def said(capsys, total: int, step_s: float, n_done: int = 0, **options: bool) -> list[str]:
    """Do things of equal length, one after the other; give the lines."""
    clock = Clock()
    lines = Lines(total, "flights", clock=clock, **options)
    for n in range(1, (n_done or total) + 1):
        clock.now_s += step_s
        lines(n)
    return capsys.readouterr().err.splitlines()


def test_each_tenth_is_a_line(capsys):
    lines = said(capsys, 300, 0.5)
    assert [line.split(" done")[0] for line in lines] == [
        f"flights: {n} of 300" for n in range(30, 301, 30)
    ]
    assert lines[0] == "flights: 30 of 300 done after 00:15, 02:15 left"
    assert lines[-1] == "flights: 300 of 300 done after 02:30"


def test_between_tenths_there_is_a_line_every_30_s_and_before_the_first_is_done(capsys):
    lines = said(capsys, 100, 12.0, n_done=9)
    assert [line[:10] for line in lines] == ["flights: 3", "flights: 6", "flights: 9"]
    clock = Clock()
    waiting = Lines(2, "flights", clock=clock)
    for _ in range(70):
        clock.now_s += 1.0
        waiting.look()
    assert capsys.readouterr().err.splitlines() == [
        "flights: 0 of 2 done after 00:30",
        "flights: 0 of 2 done after 01:00",
    ]


@pytest.mark.parametrize("total", [1, 3, 7, 12])
def test_few_things_are_a_line_each_and_the_last_says_all(capsys, total):
    lines = said(capsys, total, 1.0)
    assert len(lines) == min(total, 10)
    assert lines[-1].startswith(f"flights: {total} of {total} done after ")


def test_brief_work_says_nothing_until_it_is_long(capsys):
    assert said(capsys, 100, 0.2, is_brief=True) == []
    lines = said(capsys, 100, 1.0, is_brief=True)
    assert lines[0] == "flights: 30 of 100 done after 00:30, 01:10 left"
    assert lines[-1] == "flights: 100 of 100 done after 01:40"


def shown(total: int) -> None:
    """Do so many things, and say something else amid them."""
    with progress(total, "flights") as advance:
        for n_done in range(total + 1):
            advance(n_done)
            if n_done == 1:
                say("a worker died")


def test_where_stderr_is_no_terminal_nothing_is_written_over(capsys):
    for total, is_shown in ((0, True), (5, False)):
        with progress(total, "flights", is_shown=is_shown) as advance:
            advance(total)
    assert capsys.readouterr().err == ""
    shown(2)
    out, err = capsys.readouterr()
    assert out == ""
    assert "\r" not in err
    assert err.splitlines() == [
        "flights: 1 of 2 done after 00:00, 00:00 left",
        "a worker died",
        "flights: 2 of 2 done after 00:00",
    ]


def test_one_thing_that_takes_long_is_not_silent(capsys, monkeypatch):
    monkeypatch.setattr(module, "EVERY_S", 0.01)
    monkeypatch.setattr(module, "_LOOK_S", 0.01)
    said = ""
    with progress(1, "flights") as advance:
        while said.count("\n") < 3:
            time.sleep(0.01)
            said += capsys.readouterr().err
        advance(1)
    assert set(said.splitlines()) == {"flights: 0 of 1 done after 00:00"}


def test_a_terminal_has_a_bar(capsys, monkeypatch):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    shown(2)
    err = capsys.readouterr().err
    assert "\rflights: 100%|" in err
    assert "2/2 [" in err
    assert "done after" not in err
