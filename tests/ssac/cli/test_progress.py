"""Progress on stderr: lines where it is a file, and a bar on a terminal."""

import sys

import numba
import pytest

from ssac.cli import progress as module
from ssac.cli.progress import compilation_told, progress, say


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


@pytest.fixture
def said(capsys, monkeypatch):
    """Do things of equal length, one after the other; give the lines."""

    def lines(total, step_s, n_done, is_brief):
        now_s = [0.0]
        monkeypatch.setattr(module.time, "monotonic", lambda: now_s[0])
        with progress(total, "flights", is_brief) as advance:
            for n in range(1, n_done + 1):
                now_s[0] += step_s
                advance(n)
        return capsys.readouterr().err.splitlines()

    return lines


@pytest.mark.parametrize(
    ("total", "step_s", "n_done", "is_brief", "told"),
    [
        (300, 0.5, 300, False, range(30, 301, 30)),  # each tenth
        (100, 12.0, 9, False, (3, 6, 9)),  # every 30 s
        *((n, 1.0, n, False, range(1, n + 1)) for n in (1, 3, 7)),  # of few things each
        (100, 0.2, 100, True, ()),  # brief work says nothing until it is long
        (100, 1.0, 100, True, range(30, 101, 10)),
    ],
)
def test_lines_come_at_each_tenth_and_every_30_s(total, step_s, n_done, is_brief, told, said):
    lines = said(total, step_s, n_done, is_brief)
    assert [line.split(" done")[0] for line in lines] == [f"flights: {n} of {total}" for n in told]
    if total == 300:
        assert lines[0] == "flights: 30 of 300 done after 00:15, 02:15 left"
        assert lines[-1] == "flights: 300 of 300 done after 02:30"


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


def test_a_terminal_has_a_bar(capsys, monkeypatch):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    shown(2)
    err = capsys.readouterr().err
    assert "\rflights: 100%|" in err
    assert "2/2 [" in err
    assert "done after" not in err
