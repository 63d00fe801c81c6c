"""`ssac tables` from runs to files, and what must hold of any runs; the runs are made up."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

from experiments.cli import app
from experiments.lab import study as lab
from experiments.lab.cell import CRASHED
from experiments.lab.files import SUMS_FILE, csv_text
from experiments.lab.results import Results
from experiments.lab.schedule import Outcome
from experiments.paper.esim import ordered_runs, runs_from_csv
from experiments.studies import tables
from experiments.studies.tables import CHECKS, STUDIES
from ssac.cli.exits import BUG
from tests.experiments.reported import made_up_runs

FLIGHTS = 11  # one more than the paper's


@pytest.fixture(scope="module")
def runs() -> pd.DataFrame:
    """Whole tables of few flights, within the search."""
    runs = made_up_runs(flights=FLIGHTS)
    runs["t_d_error_ms"] = runs["t_d_error_ms"].clip(upper=900.0)
    return runs.assign(t_d_estimate_ms=runs["t_d_ms"] + runs["t_d_error_ms"])


def make_tables(folder: Path, monkeypatch: pytest.MonkeyPatch, runs: pd.DataFrame):
    """Run the command, whose runs are these."""
    few = [cell for cell in tables.table_cells() if cell.flight < FLIGHTS]
    monkeypatch.setattr(tables, "table_cells", lambda: few)
    asked = []

    def run_cells(cells, *_, **__):
        asked.extend(cells)
        return Outcome(runs, 100, 60, 800.0)

    monkeypatch.setattr(lab, "run_cells", run_cells)
    monkeypatch.setattr(lab, "context_or_none", lambda: None)
    arguments = ["tables", "--out", str(folder), "--cache", str(folder / "cache")]
    return CliRunner().invoke(app, arguments), asked


def test_every_file_is_written_and_the_columns_tell_the_runs_apart(tmp_path, monkeypatch, runs):
    result, asked = make_tables(tmp_path, monkeypatch, runs)
    assert result.exit_code == 0, result.output
    assert len(asked) == 10 * 2 * 5 * 3 * FLIGHTS
    (study,) = STUDIES
    assert {path.name for path in tmp_path.iterdir() if path.is_file()} == {
        *study.files, *study.provenances, SUMS_FILE,
    }  # fmt: skip
    table = pd.read_csv(tmp_path / "esim_20.csv")
    assert list(table["angle_deg"]) == [angle for angle in (30, 60, 90, 120, 150) for _ in range(3)]
    assert list(table["t_d_ms"]) == [5, 50, 500] * 5
    content = json.loads((tmp_path / "esim_20.provenance.json").read_text())
    assert content["recordings_simulated"] == 60
    assert content["peak_mb_per_worker"] == 800
    # The cells are in the order of the rows.
    written = runs_from_csv((tmp_path / "runs.csv").read_text())
    for name in ("duration_s", "angle_deg", "t_d_ms", "flight", "method", "seed"):
        assert [cell.columns[name] for cell in asked] == list(written[name])


def test_crashed_runs_stand_in_the_tables_and_in_the_exit_code(tmp_path, monkeypatch, runs):
    crashed = runs.copy()
    crashed.loc[[0, 9], ["status", "reason"]] = CRASHED, "ssac: KeyError: 3"
    result, _ = make_tables(tmp_path, monkeypatch, crashed)
    assert result.exit_code == BUG
    assert "2 runs crashed" in result.output
    assert (pd.read_csv(tmp_path / "runs.csv")["status"] == CRASHED).sum() == 2


# --- What must hold of any runs ---


def faulty(folder: Path, runs: pd.DataFrame) -> list[str]:
    (folder / "runs.csv").write_text(csv_text(runs))
    results = Results(folder)
    return [what for what, check in CHECKS if check(results)]


def test_possible_runs_have_no_fault(tmp_path, runs):
    assert faulty(tmp_path, runs) == []
    assert len(ordered_runs(runs)) == len(runs)


@pytest.mark.parametrize(
    ("of", "changed", "what"),
    [
        ("ssac", {"status": CRASHED}, "no run crashed"),
        ("ssac", {"t_d_error_ms": -1.0}, "errors are possible ones"),
        ("ssac", {"t_d_error_ms": np.nan}, "errors are possible ones"),
        ("ssac", {"r_error_deg": 181.0}, "errors are possible ones"),
        ("ssac", {"t_error_deg": -0.1}, "errors are possible ones"),
        ("ssac", {"t_d_estimate_ms": 77.0}, "errors are those of the estimates"),
        ("ssac", {"t_d_estimate_ms": np.nan}, "errors are those of the estimates"),
        ("ssac", {"r_error_deg": np.nan}, "a method gives a pose always or never"),
        ("ssac", {"n_events_cam1": 7}, "all methods and offsets saw the same recording"),
        ("ssac", {"n_events_cam2": 7}, "all methods and offsets saw the same recording"),
        ("ssac", {"seed": 7}, "all methods and offsets saw the same recording"),
        # The search around 500 ms ends at 1500 ms.
        (
            "zncc_e",
            {"t_d_error_ms": 1.5e3, "t_d_estimate_ms": -1e3},
            "errors are possible ones",
        ),
        # Of 1412.345 ms the CSV has six digits, which are equal enough.
        ("zncc_e", {"t_d_error_ms": 912.345, "t_d_estimate_ms": 1412.345}, None),
    ],
)
def test_an_impossible_run_is_found(tmp_path, runs, of, changed, what):
    runs = runs.copy()
    of_method = (runs["method"] == of) & (runs["t_d_ms"] == 500.0) & (runs["status"] == "ok")
    place = runs.index[of_method][7]
    for column, value in {"reason": "made up", **changed}.items():
        runs.loc[place, column] = value
    found = faulty(tmp_path, runs)
    assert (what in found) if what else not found


def test_a_failure_without_a_reason_is_found(tmp_path, runs):
    failed = runs.index[runs["status"] != "ok"]
    unsaid = runs["reason"].where(runs.index != failed[0], "")
    assert faulty(tmp_path, runs.assign(reason=unsaid)) == ["every failed run has a reason"]
