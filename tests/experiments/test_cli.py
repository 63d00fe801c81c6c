"""The table of commands: each is there, is named as its module, and ends with the right code."""

import inspect
import os
import re
import signal
import subprocess
import sys
import time
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace

import pytest

from experiments import cli
from experiments.__main__ import main
from sim.errors import SimError
from tests.experiments.command import run


def test_every_command_is_where_the_table_says_with_a_summary_of_one_line():
    widest = max(len(entry.name) for entry in cli.COMMANDS)
    for entry in cli.COMMANDS:
        assert inspect.getdoc(getattr(import_module(entry.module), entry.function)), entry.name
        assert len(f"  {'':{widest}}  {entry.summary}") <= 80, entry.name
        assert entry.summary.endswith((".", "?")), entry.name
    names = [entry.name for entry in cli.COMMANDS]
    assert len(set(names)) == len(names)
    groups = [entry.group for entry in cli.COMMANDS]
    assert groups == sorted(groups, key=("Use", "Reproduce").index)
    assert names[:3] == ["simulate", "sync", "demo"]


def test_make_calls_commands_and_studies_that_there_are():
    makefile = Path("Makefile").read_text()
    called = re.findall(r"\.venv/bin/ssac ([\w-]+)", makefile)
    assert called
    assert set(called) <= {entry.name for entry in cli.COMMANDS}
    listed = {line.split()[0] for line in run("study", "--list").splitlines()}
    studied = re.findall(r"ssac study (.+)", makefile)
    assert studied
    assert {name for names in studied for name in names.split()} <= listed


def test_what_the_simulator_refuses_is_one_line(monkeypatch, capsys):
    def fails() -> None:
        raise SimError("no such thing")

    monkeypatch.setitem(sys.modules, "experiments.scenes.demo", SimpleNamespace(demo_command=fails))
    monkeypatch.setattr(sys, "argv", ["ssac", "demo"])
    with pytest.raises(SystemExit) as end:
        main()
    assert end.value.code == 2
    assert capsys.readouterr().err == "error: no such thing\n"


@pytest.mark.render
@pytest.mark.parametrize(
    ("number", "said", "code"),
    [(signal.SIGINT, "interrupted\n", 130), (signal.SIGTERM, "terminated\n", 143)],
)
def test_an_interrupted_simulation_leaves_nothing(tmp_path, number, said, code):
    """One line at most, no bar, and none of what was written until then."""
    command = [sys.executable, "-m", "experiments", "simulate", "out", "--duration", "60"]
    process = subprocess.Popen(
        command, cwd=tmp_path, stderr=subprocess.PIPE, text=True,
        env=os.environ | {"PYTHONPATH": os.getcwd()},
    )  # fmt: skip
    while process.poll() is None and not list(tmp_path.glob("*/cam1.h5")):
        time.sleep(0.1)
    process.send_signal(number)
    shown = process.communicate(timeout=120)[1].splitlines(keepends=True)
    # On a slow machine it has said by then how far it was.
    assert [line for line in shown if not line.startswith("simulating: ")] == [said]
    assert process.returncode == code
    assert list(tmp_path.iterdir()) == []
