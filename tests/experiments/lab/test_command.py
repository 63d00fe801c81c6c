"""The shared parts of all commands that run cells."""

import json
import os
from dataclasses import replace
from typing import Annotated

import numpy as np
import pandas as pd
import pytest
import typer

from experiments.lab import schedule, study
from experiments.lab.cache import Cache
from experiments.lab.cell import CRASHED, Measure
from experiments.lab.command import command_of, finish, on_screen
from experiments.lab.schedule import Outcome
from experiments.lab.study import How, Made, Runs, merge
from ssac.cli.exits import BUG
from ssac.cli.options import number
from ssac.errors import SsacError
from tests.experiments.command import run
from tests.experiments.lab.squares import SQUARES, SquareRow, load_nothing, process_row

NOT_SIMULATED = "recording: SimError: a.obj has no faces"
THEIRS, OURS = "mine: PluginError: p 1.0", "ssac: KeyError: 3"


def outcome(*reasons: str) -> Outcome:
    status = [CRASHED if reason else "ok" for reason in reasons]
    return Outcome(pd.DataFrame({"status": status, "reason": reasons}), 1, 0, 0.0)


def test_what_cannot_be_simulated_is_the_inputs_fault(tmp_path):
    with pytest.raises(SsacError, match=r"1 runs have no recording, the first .*: a\.obj has no"):
        finish([outcome("", NOT_SIMULATED), outcome("")], Cache(tmp_path))
    finish([outcome("")], Cache(tmp_path))


@pytest.mark.parametrize("reasons", [[THEIRS], [THEIRS, OURS], [OURS, NOT_SIMULATED]])
def test_whose_bug_it_is_is_said(tmp_path, capsys, reasons):
    with pytest.raises(typer.Exit) as ended:
        finish([outcome("", *reasons)], Cache(tmp_path))
    assert ended.value.exit_code == BUG
    whose = "this program" if OURS in reasons else "other packages' methods"
    assert f"error: a bug in {whose}: {len(reasons)} runs crashed" in capsys.readouterr().err


def test_a_table_fits_a_screen_and_says_that_there_is_no_refusal():
    errors = {
        f"{name}_{of}": [value, np.nan]
        for name in ("t_d_error_ms", "r_error_deg", "t_error_deg")
        for of, value in (("mean", 1.23456), ("low", 1.0), ("high", 1.46912), ("median", 1.2))
    }
    point = {"sim.angle_deg": [30, 150], "method": ["tangency-known", "ssac"], "runs": 10}
    table = pd.DataFrame(point | {"refusals": [np.nan, "no_match 10"]} | errors)
    header, first, second = on_screen(table).splitlines()
    assert max(map(len, (header, first, second))) <= 120
    assert header.split()[:5] == ["sim.angle_deg", "method", "runs", "refusals", "t_d_error_ms"]
    assert first.split() == ["30", "tangency-known", "10", "0", *["1.23±0.23", "1.2"] * 3]
    assert second.split() == ["150", "ssac", "10", "no_match", "10"]


def up_to(last: Annotated[int, number("Last number.", 2, 99)] = 7, even: bool = True):
    return [one for one in SQUARES.cells() if one.number <= last and (even or one.number % 2)]


@pytest.fixture
def files_of(tmp_path, monkeypatch):
    """A call that runs a command of some studies in a folder, and returns its files by name."""
    monkeypatch.setattr(schedule, "run_key", lambda recordings, inputs, code: f"square{inputs}")
    monkeypatch.setattr(study, "context_or_none", lambda: None)

    def files(words, *studies, out="out", **parts):
        app = typer.Typer()
        app.command()(command_of(parts or {"all": studies}, "Squares."))
        run(*words.split(), "--out", tmp_path / out, "--cache", tmp_path / "cache", app=app)
        return {path.name: path for path in (tmp_path / out).iterdir()}

    return files


OPTIONAL = replace(SQUARES, cells=up_to, command="ssac squares", numbers={}, checks=())


def test_parameters_of_the_cells_are_options_and_stand_in_the_provenance(files_of):
    files = files_of("--last 4 --no-even --workers 1", OPTIONAL)
    assert list(pd.read_csv(files["squares_runs.csv"])["number"]) == [3]
    content = json.loads(files["squares_runs.provenance.json"].read_text())
    assert content["command"] == "ssac squares --last 4 --no-even"
    assert content["config"]["options"] == {"last": 4, "even": False}
    with pytest.raises(SsacError, match="--last: expected 2 to 99, got 100"):
        files_of("--last 100", OPTIONAL)


def test_merged_shards_are_drawn_of_the_flights_of_their_options(files_of, tmp_path):
    filmed = []
    made = Made("squares.md", lambda results: "", lambda **given: filmed.append(given) or ())
    optional = replace(OPTIONAL, makes=(made,))
    parts = [
        files_of(f"--last 4 --workers 1 --shard {part}", optional, out=part[0])["squares_runs.csv"]
        for part in ("1/2", "2/2")
    ]
    merge(parts, tmp_path / "squares_runs.csv", lambda config: optional, Cache(tmp_path))
    assert filmed == [{"last": 4}]


def test_parts_of_a_command_are_its_studies(files_of):
    other = replace(SQUARES, name="others", runs=Runs("others.csv", ("number",)), makes=())
    files = files_of("second --workers 1", first=(OPTIONAL,), second=(other,))
    assert set(files) == {"others.csv", "others.provenance.json", "SHA256SUMS"}


def test_cells_measured_alone_have_processes_of_their_own_and_are_not_kept(files_of, tmp_path):
    measure = Measure(load_nothing, process_row, SquareRow)
    files = files_of("--last 3", replace(OPTIONAL, measure=measure, how=How.ALONE, makes=()))
    runs = pd.read_csv(files["squares_runs.csv"])
    assert list(runs["status"]) == ["ok", "unusable"]
    assert runs["square"].iloc[0] != os.getpid()
    assert runs["reason"].iloc[1] == "its process ended with code 3"
    assert not (tmp_path / "cache" / "runs").exists()
