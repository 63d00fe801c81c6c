"""The table of commands: each exists, and wrong input ends in one line."""

import inspect
import re
import sys
from importlib import import_module
from pathlib import Path

import pytest

from experiments import cli
from experiments.__main__ import main
from sim.errors import SimError
from ssac.errors import SsacError
from tests.experiments.command import run


def test_every_command_is_where_the_table_says_with_a_summary_of_one_line():
    names = [entry.name for entry in cli.COMMANDS]
    assert len(set(names)) == len(names)
    for entry in cli.COMMANDS:
        assert inspect.getdoc(getattr(import_module(entry.module), entry.function)), entry.name
        assert 2 + max(map(len, names)) + 2 + len(entry.summary) <= 80, entry.name
        assert entry.summary.endswith((".", "?")), entry.name
    groups = [entry.group for entry in cli.COMMANDS]
    assert groups == sorted(groups, key=("Use", "Reproduce").index)
    assert names[:3] == ["simulate", "sync", "demo"]


def test_make_calls_commands_and_studies_that_there_are():
    makefile = Path("Makefile").read_text()
    called = set(re.findall(r"\.venv/bin/ssac ([\w-]+)", makefile))
    studied = set(" ".join(re.findall(r"ssac study (.+)", makefile)).split())
    listed = {line.split()[0] for line in run("study", "--list").splitlines()}
    for names, there in ((called, {entry.name for entry in cli.COMMANDS}), (studied, listed)):
        assert set() < names <= there


FILES = {
    "drone.obj": b"v 0 0\nf 1 2 3\n",
    "mesh.toml": b'[fixed]\nsim.drone_file = "drone.obj"\n',
    "small.toml": b"[grid]\nsim.angle_deg = [30, 90]\n",
    "negative.toml": b"[fixed]\nsim.spline.duration_s = -1\n",
    "syntax.toml": b"title = \n",
    "latin.toml": b'title = "\xff"\n',
    "flight.csv": b"".join(b"%d,0,0,1,0,0,0,1\n" % t for t in range(4)),
}


@pytest.mark.parametrize(
    ("words", "fault"),
    [
        ("study", "name a study: coverage, "),
        ("study roots", "unknown study 'roots': use one of coverage, "),
        *((f"study coverage --shard {text}", "--shard: expected i/n")
          for text in ("0/2", "3/2", "1", "a/b", "-1/2")),
        ("study efficiency", "`ssac study efficiency` needs runs.csv in results"),
        ("study efficiency spread", "spread: is of your own data: run it by itself"),
        ("study spread a b", "expected CAM1 CAM2 RIG behind it, got 'a b'"),
        ("study spread a b c", "a: no such file"),
        ("study spread . . .", r"\.: no such file"),
        ("physical odd", "unknown part 'odd': use one of "),
        ("figures fig3_preprocessing fig6", "unknown figure 'fig6': use one of fig3"),
        ("ablate windows", r"unknown ablation 'windows': use one of .*window"),
        ("ablate small.toml ./small.toml", r"small_runs\.csv would be written twice"),
        ("sweep mesh.toml", r"drone\.obj"),
        ("merge runs.txt part.csv", r"runs\.txt: the table is a CSV, and its name must end with"),
        ("sweep negative.toml", r"negative\.toml: duration_s must be a positive number"),
        ("sweep syntax.toml", r"syntax\.toml: cannot be read as TOML"),
        ("sweep latin.toml", r"latin\.toml: cannot be read as TOML: .* can't decode"),
        ("sweep none.toml", r"none\.toml: cannot be read as TOML"),
        ("verify --results none", "no such folder: run `make tables"),
        *((f"simulate out {options}", fault) for options, fault in (
            ("--angle 180", "--angle: expected 1 to 179 degrees, got 180"),
            ("--cameras 5", "5 of them, 90 deg from each to the next, go once round: use an angle "
             "below 90 deg"),
            ("--cameras 3 --background a.png --background b.png", "one image for all"),
            ("--distortion 0.1 0 0 0", "--distortion: needs --distortion-model radtan or equi"),
            ("--drone hawk", "expected a mesh file, or one of quadrotor, two-tone, bird, plane"),
            ("--trajectory missing.csv", "cannot read the trajectory missing.csv"),
            ("--seed 4294967296", "--seed: expected 0 to 4294967295, got 4294967296"),
            ("--second-object 1 --trajectory flight.csv", "leave out one of them"),
            ("--second-object 1 --preset davis346", "--effect frame_gap_s=0"),
            ("--lamp 60 --resolution 64 48", "a lamp of 60 x 60 px does not fit into a view"),
            ("--preset davis", "--preset: expected one of davis346, davis346-dim, evk4"),
            ("--preset evk4 --noise davis346", "leave one out"),
            ("--noise loud", "expected one of ideal, davis346, got 'loud'"),
            ("--effect latency=1", "expected NAME=VALUE with a name of illuminance_lux"),
            ("--effect threshold_on=0.1", "expected NAME=VALUE"),  # an option of its own
            ("--lattice 32 1", "--lattice: expected 0 to 31, got 32"),
            ("--effect latency_s=late", "--effect latency_s: expected a number, got 'late'"),
            ("--effect hot_clusters=1.5", "expected a whole number, got '1.5'"),
            ("--illuminance 9 --effect illuminance_lux=8", "are one: leave one out"),
        )),
    ],
)  # fmt: skip
def test_what_is_asked_wrongly_is_one_line_and_leaves_nothing(tmp_path, monkeypatch, words, fault):
    monkeypatch.chdir(tmp_path)
    for name, content in FILES.items():
        Path(name).write_bytes(content)
    with pytest.raises((SimError, SsacError), match=fault) as error:
        run(*words.split())
    assert "\n" not in str(error.value)
    assert {path.name for path in tmp_path.iterdir()} == {*FILES}


def test_what_the_simulator_refuses_is_one_line(monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["ssac", "simulate", "."])
    with pytest.raises(SystemExit) as end:
        main()
    assert end.value.code == 2
    assert re.fullmatch(r"error: \. is not empty, .*\n", capsys.readouterr().err)
