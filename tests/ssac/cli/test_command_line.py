"""A table of commands: each is imported when it is called, and none for the list."""

import sys
from importlib.metadata import version

import pytest

from ssac.cli.command_line import Entry, command_line, run
from ssac.cli.exits import BAD_INPUT, DONE

LONG = "A summary of some length, which a narrow list of commands would cut."
ENTRIES = (
    Entry("greet", "Use", LONG, "greeting_of_a_test", "greet"),
    Entry("broken", "Reproduce", "Cannot be imported.", "no_such_module", "f"),
)
MODULE = '''
from pathlib import Path
from typing import Annotated
import typer

def greet(
    name: Annotated[str, typer.Argument(metavar="NAME")],
    loud: Annotated[bool, typer.Option("--loud")] = False,
    again: Annotated[str, typer.Option("--name")] = "",
) -> None:
    """Say hello."""
    typer.echo(f"hello {name}{'!' * loud}")
    if name == "nobody":
        raise typer.Exit(1)

def help_sections():
    return {"People": [("ada", "wrote programs")]}
'''


@pytest.fixture(autouse=True)
def module(tmp_path, monkeypatch):
    (tmp_path / "greeting_of_a_test.py").write_text(MODULE)
    monkeypatch.syspath_prepend(str(tmp_path))
    yield
    sys.modules.pop("greeting_of_a_test", None)


def ssac(*args: str) -> int:
    return run(command_line(ENTRIES, "What it is."), args, "ssac")


@pytest.mark.parametrize("flag", ["-h", "--help"])
def test_the_list_is_grouped_whole_and_imports_nothing(flag, capsys):
    assert ssac(flag) == DONE
    shown = " ".join(capsys.readouterr().out.split())
    assert "What it is. Options: " in shown
    assert f"Use: greet {LONG} Reproduce: broken Cannot be imported." in shown
    assert "greeting_of_a_test" not in sys.modules


def test_a_command_is_imported_and_run_and_its_help_has_its_lists(capsys):
    assert ssac("greet", "ada", "--loud") == DONE
    assert capsys.readouterr().out == "hello ada!\n"
    assert ssac("greet", "nobody") == 1
    capsys.readouterr()
    assert ssac("greet", "--help") == DONE
    shown = " ".join(capsys.readouterr().out.split())
    usage = "Usage: ssac greet [OPTIONS] NAME Say hello. Arguments: NAME [required]"
    assert shown.startswith(usage)
    assert shown.endswith("People: ada wrote programs")


def test_the_version_goes_to_stdout_and_the_list_without_a_command_to_stderr(capsys):
    assert ssac("--version") == DONE
    assert capsys.readouterr().out == f"ssac {version('ssac-suite')}\n"
    assert ssac() == BAD_INPUT
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("Usage: ssac [OPTIONS] COMMAND")


@pytest.mark.parametrize(
    ("args", "line"),
    [
        (("greets",), "there is no command 'greets': did you mean greet?; see ssac --help"),
        (("xyz",), "there is no command 'xyz'; see ssac --help"),
        (("--xyz",), "No such option: --xyz; see ssac --help"),
        (("greet", "--name"), "Option '--name' requires an argument; see ssac greet --help"),
        (("greet",), "Missing argument 'NAME'; see ssac greet --help"),
        (("greet", "a", "b"), "Got unexpected extra argument(s) (b); see ssac greet --help"),
    ],
)
def test_bad_usage_is_one_line(args, line, capsys):
    assert ssac(*args) == BAD_INPUT
    assert capsys.readouterr() == ("", f"error: {line}\n")


@pytest.mark.parametrize(
    ("typed", "place", "shown"), [("ssac gr", 1, "greet"), ("ssac greet --l", 2, "--loud")]
)
def test_a_shell_completes_names_without_importing_and_options(
    typed, place, shown, capsys, monkeypatch
):
    monkeypatch.setenv("_SSAC_COMPLETE", "complete_bash")
    monkeypatch.setenv("COMP_WORDS", typed)
    monkeypatch.setenv("COMP_CWORD", str(place))
    with pytest.raises(SystemExit) as end:
        ssac()
    assert end.value.code == 0
    assert capsys.readouterr().out.split() == [shown]
    assert ("greeting_of_a_test" in sys.modules) == (shown == "--loud")
