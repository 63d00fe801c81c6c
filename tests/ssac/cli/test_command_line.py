"""The command line: its list of commands, options, progress, exit codes and one-line errors."""

import json
import os
import signal
import subprocess
import sys
import termios
from functools import partial
from importlib.metadata import version
from itertools import product
from unittest.mock import Mock

import numba
import pytest

from ssac import Config, PluginError, SsacError
from ssac.cli import exits, paths, sync
from ssac.cli.command_line import COMMANDS, Entry, command_line, run
from ssac.cli.exits import BAD_INPUT, BUG, DONE, NO_ESTIMATE, fail, guarded
from ssac.cli.options import config_of
from ssac.cli.progress import compilation_told, progress, say
from ssac.screen import COLUMNS, columns
from tests.recorded import T_D_S

LONG = "A summary of some length, which a narrow list of commands would cut."
ENTRIES = (
    Entry("greet", "Use", LONG, "greeting_of_a_test", "greet"),
    Entry("measure", "Use", "Measure.", "greeting_of_a_test", "measure"),
    Entry("broken", "Reproduce", "Cannot be imported.", "no_such_module", "f"),
)
MODULE = '''
from pathlib import Path
from typing import Annotated
import typer
from ssac.cli.options import number

def greet(
    name: Annotated[str, typer.Argument(metavar="NAME")],
    loud: Annotated[bool, typer.Option("--loud")] = False,
    again: Annotated[str, typer.Option("--name")] = "",
) -> None:
    """Say hello."""
    typer.echo(f"hello {name}{'!' * loud}")
    if name == "nobody":
        raise typer.Exit(1)

def measure(
    half_window: Annotated[float, number("Of a sample.", 0.001, 0.25, "seconds")] = 0.02,
    size: Annotated[tuple[int, int], number("Of a sensor.", 1, 99, metavar="W H")] = (9, 9),
    extent: Annotated[float | None, number("Of a thing.", 1, 2, "metres")] = None,
) -> None:
    """Measure."""
    typer.echo(f"{half_window} {size} {extent}")

def help_sections():
    return {"People": [("ada", "wrote programs")]}
'''


@pytest.fixture(autouse=True)
def module(tmp_path, monkeypatch):
    (tmp_path / "greeting_of_a_test.py").write_text(MODULE)
    monkeypatch.syspath_prepend(str(tmp_path))
    yield
    sys.modules.pop("greeting_of_a_test", None)


def ssac(*args):
    return run(command_line(ENTRIES, "What it is."), args, "ssac")


def helped(capsys, *args):
    assert ssac(*args) == DONE
    return " ".join(capsys.readouterr().out.split())


@pytest.mark.parametrize("flag", ["-h", "--help"])
def test_the_list_is_grouped_whole_and_imports_nothing(flag, capsys):
    shown = helped(capsys, flag)
    assert "What it is. Options: " in shown
    assert f"Use: greet {LONG} measure Measure. Reproduce: broken Cannot be imported." in shown
    assert "greeting_of_a_test" not in sys.modules
    assert [entry.name for entry in COMMANDS] == ["sync", "track", "import", "compare"]


def test_a_command_is_imported_and_run_and_its_help_has_its_lists(capsys):
    assert ssac("greet", "ada", "--loud") == DONE
    assert capsys.readouterr().out == "hello ada!\n"
    assert ssac("greet", "nobody") == 1
    capsys.readouterr()
    shown = helped(capsys, "greet", "--help")
    usage = "Usage: ssac greet [OPTIONS] NAME Say hello. Arguments: NAME [required]"
    assert shown.startswith(usage)
    assert shown.endswith("People: ada wrote programs")
    shown = helped(capsys, "measure", "--help")
    assert "--half-window SECONDS Of a sample. From 0.001 to 0.25 seconds. [default: 0.02]" in shown
    assert "--size W H Of a sensor. From 1 to 99. [default: 9, 9]" in shown
    assert "--extent METRES Of a thing. From 1 to 2 metres." in shown
    for args, taken in (
        ("", "0.02 (9, 9) None"),
        ("--half-window 0.001 --size 1 99", "0.001 (1, 99) None"),
        ("--half-window 0.25 --extent 2", "0.25 (9, 9) 2.0"),
    ):
        assert ssac("measure", *args.split()) == DONE
        assert capsys.readouterr().out == f"{taken}\n"


def test_the_version_goes_to_stdout_and_the_list_without_a_command_to_stderr(capsys):
    assert ssac("--version") == DONE
    assert capsys.readouterr().out == f"ssac {version('ssac-suite')}\n"
    assert ssac() == BAD_INPUT
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("Usage: ssac [OPTIONS] COMMAND")


HALF_WINDOW = "--half-window: expected 0.001 to 0.25 seconds, got"


@pytest.mark.parametrize(
    ("args", "line"),
    [
        ("greets", "there is no command 'greets': did you mean greet?; see ssac --help"),
        ("xyz", "there is no command 'xyz'; see ssac --help"),
        ("--xyz", "No such option: --xyz; see ssac --help"),
        ("greet --name", "Option '--name' requires an argument; see ssac greet --help"),
        ("greet", "Missing argument 'NAME'; see ssac greet --help"),
        ("greet a b", "Got unexpected extra argument(s) (b); see ssac greet --help"),
        *(
            (f"measure --half-window {value}", f"{HALF_WINDOW} {value}")
            for value in ("20", "nan", "-inf")
        ),
        ("measure --size 9 100", "--size: expected 1 to 99, got 100"),
        ("measure --extent 0.99", "--extent: expected 1 to 2 metres, got 0.99"),
    ],
)
def test_bad_usage_is_one_line(args, line, capsys):
    assert guarded(lambda: ssac(*args.split())) == BAD_INPUT
    assert capsys.readouterr() == ("", f"error: {line}\n")


@pytest.mark.parametrize(
    ("typed", "place", "shown"), [("ssac gr", 1, "greet"), ("ssac greet --l", 2, "--loud")]
)
def test_a_shell_completes_names_and_options(typed, place, shown, capsys, monkeypatch):
    monkeypatch.setenv("_SSAC_COMPLETE", "complete_bash")
    monkeypatch.setenv("COMP_WORDS", typed)
    monkeypatch.setenv("COMP_CWORD", str(place))
    with pytest.raises(SystemExit) as end:
        ssac()
    assert end.value.code == 0
    assert capsys.readouterr().out.split() == [shown]
    assert ("greeting_of_a_test" in sys.modules) == (shown == "--loud")


# --- Fields of the config ---


@pytest.mark.parametrize("options", [sync.OPTIONS, paths.OPTIONS], ids=["sync", "track"])
def test_an_option_sets_its_field_and_no_other(options):
    defaults, given = {name: one.parameter[1] for name, one in options.items()}, object()
    assert config_of(options, defaults) == Config()
    for name, option in options.items():
        value = given if option.value is None else option.value
        fields = {option.field: value} if option.field else {}
        assert config_of(options, defaults | {name: given}) == Config(**fields)
        assert all(getattr(Config(), field) != value for field in fields)


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


@pytest.mark.parametrize(
    ("total", "step_s", "n_done", "is_brief", "told"),
    [
        (300, 0.5, 300, False, range(30, 301, 30)),  # at each tenth
        (100, 12.0, 9, False, (3, 6, 9)),  # every 30 s
        *((n, 1.0, n, False, range(1, n + 1)) for n in (1, 3, 7)),  # each of a few things
        (100, 0.2, 100, True, ()),  # brief work says nothing until it is long
        (100, 1.0, 100, True, range(30, 101, 10)),
    ],
)
def test_lines_come_at_each_tenth_and_every_30_s(
    total, step_s, n_done, is_brief, told, capsys, monkeypatch
):
    now_s = [0.0]
    monkeypatch.setattr("ssac.cli.progress.time.monotonic", lambda: now_s[0])
    with progress(total, "flights", is_brief) as advance:
        for n in range(1, n_done + 1):
            now_s[0] += step_s
            advance(n)
    lines = capsys.readouterr().err.splitlines()
    assert [line.split(" done")[0] for line in lines] == [f"flights: {n} of {total}" for n in told]
    if total == 300:
        assert lines[0] == "flights: 30 of 300 done after 00:15, 02:15 left"
        assert lines[-1] == "flights: 300 of 300 done after 02:30"


@pytest.mark.parametrize("is_terminal", [True, False])
def test_only_a_terminal_has_a_bar_that_is_written_over(is_terminal, capsys, monkeypatch):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: is_terminal)
    for total, is_shown in ((0, True), (5, False)):
        with progress(total, "flights", is_shown=is_shown) as advance:
            advance(total)
    assert capsys.readouterr().err == ""
    with progress(2, "flights") as advance:
        for n_done in range(3):
            advance(n_done)
            if n_done == 1:
                say("a worker died")
    out, err = capsys.readouterr()
    assert out == ""
    if is_terminal:
        assert "\rflights: 100%|" in err
        assert "2/2 [" in err
        assert "done after" not in err
    else:
        assert err == (
            "flights: 1 of 2 done after 00:00, 00:00 left\na worker died\n"
            "flights: 2 of 2 done after 00:00\n"
        )


@pytest.mark.parametrize(
    ("width", "expected"),
    [(60, 60), (500, COLUMNS), (3, 40), (0, COLUMNS)],  # 0: the terminal states no width
)
def test_lines_fit_the_terminal(width, expected, monkeypatch):
    reader, end = os.openpty()
    termios.tcsetwinsize(end, (24, width))
    message = " ".join(20 * ["a.h5: expected events, got none"])
    with open(end, "w") as terminal:
        assert columns(terminal) == expected
        monkeypatch.setattr(sys, "stderr", terminal)
        fail(message, BAD_INPUT)
        terminal.flush()
        shown = os.read(reader, 10_000).decode()
    os.close(reader)
    assert max(map(len, shown.splitlines())) in range(expected - 9, expected + 1)
    assert shown.split() == ["error:", *message.split()]


@pytest.mark.parametrize("code", [DONE, NO_ESTIMATE, BAD_INPUT])
def test_a_command_says_its_own_code_though_its_output_is_closed(code, capsys, monkeypatch):
    assert guarded(lambda: code) == code
    assert capsys.readouterr() == ("", "")
    monkeypatch.setattr(sys, "stdout", None)  # as Python sets it then
    assert guarded(lambda: code) == code


@pytest.mark.parametrize(
    ("error", "line"),
    [
        (SsacError("a.h5: expected events,\n  got none"), "a.h5: expected events, got none"),
        (FileNotFoundError(2, "No such file", "a.h5"), "[Errno 2] No such file: 'a.h5'"),
        (UnicodeError("of another package"), "of another package"),
        (RuntimeError("cannot cache 'f': no locator available for 'f.py'"), exits.NO_KERNELS),
    ],
)
def test_what_is_wrong_with_the_input_is_one_line(error, line, capsys):
    assert guarded(Mock(side_effect=error), (UnicodeError,)) == BAD_INPUT
    assert capsys.readouterr() == ("", f"error: {line}\n")


@pytest.mark.parametrize(
    ("error", "start"),
    [
        (UnicodeError("x"), "a bug in this program, UnicodeError: x"),
        (MemoryError(), "a bug in this program, MemoryError"),
        (PluginError("mine 1.2: KeyError"), "mine 1.2: KeyError; please report it"),  # not ours
    ],
)
def test_a_bug_is_one_line_and_a_traceback_in_a_file(error, start, capsys, tmp_path, monkeypatch):
    """The command line is in the file, too, also a name in it that is not UTF-8."""
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    monkeypatch.setattr(sys, "argv", ["ssac", "sync", os.fsdecode(b"M\xfcnchen.csv")])
    assert guarded(Mock(side_effect=error)) == BUG
    out, err = capsys.readouterr()
    (file,) = tmp_path.glob("ssac-bug-*/traceback.txt")
    assert (out, err.count("\n")) == ("", 1)
    assert err.startswith(f"error: {start}")
    assert err.rstrip().endswith(str(file))
    assert "raise effect" in file.read_text()
    assert r"M\udcfcnchen.csv" in file.read_text()
    monkeypatch.setattr("tempfile.tempdir", "/no/such/folder")
    monkeypatch.setattr(sys, "argv", ["ssac"])
    assert guarded(Mock(side_effect=error)) == BUG
    err = capsys.readouterr().err  # holds the traceback, then
    assert err.count("\n") == 1
    assert "raise effect" in err


def test_a_name_that_is_not_utf_8_can_be_printed():
    body = "    print('M\\udcfcnchen.csv')\n    return 0"
    environment = os.environ | {"PYTHONIOENCODING": "utf-8:strict"}
    process = guarded_process(body, stdout=subprocess.PIPE, env=environment)
    assert process.communicate() == (b"M\\udcfcnchen.csv\n", b"")
    assert process.returncode == 0


def guarded_process(body, **options):
    code = f"""
import sys
from ssac.cli.exits import guarded
def run():
{body}
sys.exit(guarded(run))
"""
    # A shell that runs the tests in the background may make them ignore interrupts.
    heed = partial(signal.signal, signal.SIGINT, signal.SIG_DFL)
    command = [sys.executable, "-c", code]
    return subprocess.Popen(command, stderr=subprocess.PIPE, preexec_fn=heed, **options)


def test_a_reader_that_stops_reading_is_no_crash():
    read, write = os.pipe()
    os.close(read)
    process = guarded_process("    print('x')\n    return 0", stdout=write)
    os.close(write)
    assert process.communicate() == (None, b"")
    assert process.returncode == exits.PIPE_CLOSED
    process = guarded_process("    from ssac import load_rig\n    load_rig('none.yaml')")
    process.stderr.close()
    assert process.wait() == BAD_INPUT


SLEEP = "import time\n{0}print('here', flush=True)\n{0}time.sleep(60)\n"
SWALLOWED = f"""
    try:
        {SLEEP.format(8 * " ")}
    except BaseException:
        print('swallowed', flush=True)
    time.sleep(60)"""
FINALISED = f"""
    class Slow:
        def __del__(self):
            {SLEEP.format(12 * " ")}
    import time
    Slow()
    time.sleep(60)"""
BODIES = [("    import slow", b""), (SWALLOWED, b"swallowed\n"), (FINALISED, b"")]
SIGNALS = [(signal.SIGINT, "interrupted"), (signal.SIGTERM, "terminated")]


@pytest.mark.parametrize(("number", "word"), SIGNALS)
@pytest.mark.parametrize(("body", "said"), BODIES)
def test_a_signal_is_one_line_amid_imports_and_where_it_is_lost(body, said, number, word, tmp_path):
    (tmp_path / "slow.py").write_text(SLEEP.format(""))
    body = f"    sys.path.insert(0, {str(tmp_path)!r})\n{body}"
    process = guarded_process(body, stdout=subprocess.PIPE)
    assert process.stdout.readline() == b"here\n"
    process.send_signal(number)
    assert process.communicate(timeout=30) == (said, f"{word}\n".encode())
    assert process.returncode == 128 + number


def test_a_signal_amid_compiled_code_is_no_bug_and_the_callers_signals_stay(capsys):
    def within(raised):
        wrapped = SystemError("a function returned a result with an exception set")
        wrapped.__cause__ = SystemError("another did")
        wrapped.__cause__.__cause__ = raised
        return Mock(side_effect=wrapped)

    numbers = (signal.SIGINT, signal.SIGALRM, signal.SIGTERM)
    before = [signal.getsignal(number) for number in numbers]
    assert guarded(within(KeyboardInterrupt())) == 130
    assert [signal.getsignal(number) for number in numbers] == before
    assert guarded(within(SystemExit(143))) == 143
    assert capsys.readouterr().err == "interrupted\nterminated\n"


# --- What is imported: no simulator, no experiments, nothing else unneeded ---

RUN = """
import runpy
import sys

sys.argv[0] = "ssac"
try:
    runpy.run_module(sys.argv.pop(1), run_name="__main__", alter_sys=True)
finally:
    print("imported:", *sys.modules)
    from threadpoolctl import threadpool_info
    blas = [one for one in threadpool_info() if one["user_api"] == "blas"]
    print("threads:", *{one["num_threads"] for one in blas})
"""


def ran(*args):
    """Run a module's command line; return the process, its imports, and BLAS's thread count."""
    command = [sys.executable, "-c", RUN, *map(str, args)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    *_, modules, threads = done.stdout.splitlines()
    return done, set(modules.split()), threads


HEAVY = {
    *("faery", "matplotlib", "pandas", "scipy.signal", "scipy.stats", "scipy.interpolate"),
    *("ssac.network.solve", "ssac.network.ground", "ssac.pipeline.plots", "ssac.methods.albl"),
}
FOR_WORK = {"numba", "scipy", "cv2", "h5py", "pyrender", "trimesh"}


@pytest.mark.parametrize("method", ["tangency", "event_rate"])
def test_sync_needs_no_simulator_and_imports_no_more_than_it_needs(method, recorded, tmp_path):
    out = tmp_path / "out.json"
    args = (*recorded.pair, "--rig", recorded / "rig.yaml", "--method", method, "--json", out)
    done, imported, threads = ran("ssac.cli", "sync", *args)
    assert done.returncode == 0, done.stderr
    assert abs(json.loads(out.read_text())["t_d_s"] - T_D_S) < 0.05
    assert "scipy.ndimage" in imported  # the list works
    assert not (HEAVY | {"sim", "experiments"}) & imported
    assert threads == "threads: 1"


USES = [*product(("ssac.cli", "experiments"), ("--version", "sync --help", "sync"))]


@pytest.mark.parametrize(("program", "args"), [*USES, ("ssac", "")])
def test_nothing_heavy_is_imported_for_help_or_for_bad_usage_nor_by_the_package(program, args):
    _, imported, _ = ran(program, *args.split())
    assert ("typer" in imported) == (program != "ssac")
    assert not (HEAVY | FOR_WORK) & imported
