"""`ssac tables` from runs to files; the runs themselves are made up."""

import json

import pandas as pd
import pytest
from typer.testing import CliRunner

from experiments.cli import app
from experiments.lab.files import SUMS_FILE
from experiments.lab.schedule import Outcome
from experiments.lab.task import CRASHED
from experiments.paper import tables as reproduce
from ssac.cli.exits import BUG
from tests.experiments.reported import made_up_runs

pytestmark = pytest.mark.render  # provenance names the GL driver


def outcome(**changes) -> Outcome:
    """Return what `run_cells` would: parameters under dotted names."""
    runs = made_up_runs().assign(**changes)
    runs["sim.t_d_s"] = 1e-3 * runs["t_d_ms"]
    names = {"duration_s": "sim.spline.duration_s", "angle_deg": "sim.angle_deg"}
    return Outcome(runs.rename(columns=names).drop(columns="t_d_ms"), 100, 60, 800.0)


def make_tables(folder, monkeypatch, result):
    asked = []

    def run_cells(cells, *_):
        asked.extend(cells)
        return result

    monkeypatch.setattr(reproduce, "run_cells", run_cells)
    arguments = ["tables", "--out", str(folder), "--cache", str(folder / "cache")]
    return CliRunner().invoke(app, arguments), asked


def test_every_table_is_written_with_its_provenance(tmp_path, monkeypatch):
    result, asked = make_tables(tmp_path, monkeypatch, outcome())
    assert result.exit_code == 0, result.output
    assert len(asked) == 9000  # 10 methods in 900 runs each
    tables = ("runs", "comparison", "comparison_summary", "esim_10", "esim_20")
    names = {f"{name}{suffix}" for name in tables for suffix in (".csv", ".provenance.json")}
    assert {path.name for path in tmp_path.iterdir()} == names | {"README.md", SUMS_FILE}
    assert len(pd.read_csv(tmp_path / "runs.csv")) == 3000
    table = pd.read_csv(tmp_path / "esim_20.csv")
    assert list(table["angle_deg"]) == [angle for angle in (30, 60, 90, 120, 150) for _ in range(3)]
    assert list(table["t_d_ms"]) == [5, 50, 500] * 5
    content = json.loads((tmp_path / "esim_20.provenance.json").read_text())
    assert content["recordings_simulated"] == 60
    assert content["peak_mb_per_worker"] == 800


def test_crashed_runs_stand_in_the_tables_and_in_the_exit_code(tmp_path, monkeypatch):
    crashed = outcome()
    crashed.runs.loc[[0, 9], ["status", "reason"]] = CRASHED, "ssac: KeyError: 3"
    result, _ = make_tables(tmp_path, monkeypatch, crashed)
    assert result.exit_code == BUG
    assert "2 runs crashed" in result.output
    runs = pd.read_csv(tmp_path / "runs.csv")
    assert (runs["status"] == CRASHED).sum() == 2
    assert runs["reason"].str.contains("KeyError").sum() == 2
