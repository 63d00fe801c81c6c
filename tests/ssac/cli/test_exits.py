"""What a command raises, as the exit code and the one line that a script and a person see."""

import os
import signal
import subprocess
import sys
from functools import partial

import pytest

from ssac.cli.exits import BAD_INPUT, BUG, DONE, INTERRUPTED, NO_ESTIMATE, PIPE_CLOSED, guarded
from ssac.errors import PluginError, SsacError


class OwnError(ValueError):
    pass


def raising(error: BaseException):
    def run() -> int:
        raise error

    return run


@pytest.mark.parametrize("code", [DONE, NO_ESTIMATE, BAD_INPUT])
def test_a_command_says_its_own_code_though_its_output_is_closed(code, capsys, monkeypatch):
    assert guarded(lambda: code) == code
    assert capsys.readouterr() == ("", "")
    monkeypatch.setattr(sys, "stdout", None)  # as Python has it then
    assert guarded(lambda: code) == code


@pytest.mark.parametrize(
    ("error", "line"),
    [
        (SsacError("a.h5: expected events,\n  got none"), "a.h5: expected events, got none"),
        (FileNotFoundError(2, "No such file", "a.h5"), "[Errno 2] No such file: 'a.h5'"),
        (OwnError("of another package"), "of another package"),
    ],
)
def test_what_is_wrong_with_the_input_is_one_line(error, line, capsys):
    assert guarded(raising(error), (OwnError,)) == BAD_INPUT
    assert capsys.readouterr() == ("", f"error: {line}\n")


@pytest.mark.parametrize(
    ("error", "start"),
    [
        (OwnError("x"), "a bug in this program, OwnError"),
        (MemoryError(), "a bug in this program, MemoryError"),
        (PluginError("mine 1.2: KeyError"), "mine 1.2: KeyError; please report it"),  # not ours
    ],
)
def test_a_bug_is_one_line_and_a_traceback_in_a_file(error, start, capsys, tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    assert guarded(raising(error)) == BUG
    out, err = capsys.readouterr()
    (file,) = tmp_path.glob("ssac-bug-*/traceback.txt")
    assert (out, err.count("\n")) == ("", 1)
    assert err.startswith(f"error: {start}")
    assert err.rstrip().endswith(str(file))
    assert "in run\n    raise error" in file.read_text()


def test_a_bug_without_a_temporary_folder_is_still_one_line(capsys, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", "/no/such/folder")
    assert guarded(raising(KeyError("x"))) == BUG
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert "raise error" in err


def guarded_process(body: str, **options) -> subprocess.Popen:
    code = f"""
import sys
from ssac.cli.exits import guarded
def run():
{body}
sys.exit(guarded(run))
"""
    # Whoever runs the tests in the background may have made them deaf to interrupts.
    heed = partial(signal.signal, signal.SIGINT, signal.SIG_DFL)
    command = [sys.executable, "-c", code]
    return subprocess.Popen(command, stderr=subprocess.PIPE, preexec_fn=heed, **options)


def test_a_reader_that_stops_reading_is_no_crash():
    read, write = os.pipe()
    os.close(read)
    process = guarded_process("    print('x')\n    return 0", stdout=write)
    os.close(write)
    assert process.communicate() == (None, b"")
    assert process.returncode == PIPE_CLOSED


SLEEP = "import time\n{0}print('here', flush=True)\n{0}time.sleep(60)\n"
SWALLOWED = f"""
    try:
        {SLEEP.format(8 * " ")}
    except BaseException:
        print('swallowed', flush=True)
    time.sleep(60)"""


@pytest.mark.parametrize(("body", "said"), [("    import slow", b""), (SWALLOWED, b"swallowed\n")])
def test_an_interrupt_is_one_line_amid_an_import_and_though_it_is_swallowed(body, said, tmp_path):
    """As when the user changes their mind in the first second."""
    (tmp_path / "slow.py").write_text(SLEEP.format(""))
    body = f"    sys.path.insert(0, {str(tmp_path)!r})\n{body}"
    process = guarded_process(body, stdout=subprocess.PIPE)
    assert process.stdout is not None
    assert process.stdout.readline() == b"here\n"
    process.send_signal(signal.SIGINT)
    assert process.communicate(timeout=30) == (said, b"interrupted\n")
    assert process.returncode == INTERRUPTED


def test_an_interrupt_is_one_line_and_leaves_the_callers_signals_as_they_were(capsys):
    numbers = (signal.SIGINT, signal.SIGALRM, signal.SIGTERM)
    before = [signal.getsignal(number) for number in numbers]
    assert guarded(raising(KeyboardInterrupt())) == INTERRUPTED == 130
    assert capsys.readouterr().err == "interrupted\n"
    assert [signal.getsignal(number) for number in numbers] == before
