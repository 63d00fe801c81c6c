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
from experiments.lab.results import SUMS_FILE, Results, csv_text, read_table
from experiments.lab.schedule import Outcome
from experiments.paper.esim import ordered_runs
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


def test_every_file_is_written_in_the_order_of_the_cells_with_the_runs_that_crashed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, runs: pd.DataFrame
) -> None:
    few, asked = [cell for cell in tables.table_cells() if cell.flight < FLIGHTS], []
    runs = runs.copy()
    runs.loc[[0, 9], ["status", "reason"]] = CRASHED, "ssac: KeyError: 3"
    monkeypatch.setattr(tables, "table_cells", lambda: few)
    monkeypatch.setattr(
        lab, "run_cells", lambda cells, *_, **__: asked.extend(cells) or Outcome(runs, 100, 60, 800)
    )
    monkeypatch.setattr(lab, "context_or_none", lambda: None)
    arguments = ["tables", "--out", str(tmp_path), "--cache", str(tmp_path / "cache")]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == BUG
    assert "2 runs crashed" in result.output
    (study,) = STUDIES
    assert {path.name for path in tmp_path.iterdir() if path.is_file()} == {
        *study.files, *study.provenances, SUMS_FILE,
    }  # fmt: skip
    content = json.loads((tmp_path / "esim_20.provenance.json").read_text())
    assert (content["recordings_simulated"], content["peak_mb_per_worker"]) == (60, 800)
    assert len(asked) == 10 * 2 * 5 * 3 * FLIGHTS
    written = read_table((tmp_path / "runs.csv").read_text())
    assert (written["status"] == CRASHED).sum() == 2
    for name in ("duration_s", "angle_deg", "t_d_ms", "flight", "method", "seed"):
        assert [cell.columns[name] for cell in asked] == list(written[name])


# --- What must hold of any runs ---


def faulty(folder: Path, runs: pd.DataFrame) -> list[str]:
    (folder / "runs.csv").write_text(csv_text(runs))
    results = Results(folder)
    return [what for what, check in CHECKS if check(results)]


def test_possible_runs_have_no_fault_and_a_failure_has_a_reason(tmp_path, runs):
    assert faulty(tmp_path, runs) == []
    assert len(ordered_runs(runs)) == len(runs)
    failed = runs.index[runs["status"] != "ok"]
    unsaid = runs["reason"].where(runs.index != failed[0], "")
    assert faulty(tmp_path, runs.assign(reason=unsaid)) == ["every failed run has a reason"]


@pytest.mark.parametrize(
    ("of", "changed", "what"),
    [
        ("ssac", {"status": CRASHED}, "no run crashed"),
        ("ssac", {"t_d_error_ms": -1.0}, "errors are possible ones"),
        ("ssac", {"t_d_error_ms": np.nan}, "errors are possible ones"),
        ("ssac", {"r_error_deg": 181.0}, "angles are angles"),
        ("ssac", {"t_error_deg": -0.1}, "angles are angles"),
        ("ssac", {"t_d_estimate_ms": 77.0}, "errors are those of the estimates"),
        ("ssac", {"t_d_estimate_ms": np.nan}, "errors are possible ones"),
        ("ssac", {"r_error_deg": np.nan}, "a method gives a pose always or never"),
        ("ssac", {"n_events_cam1": 7}, "all runs on a flight saw the same events"),
        ("ssac", {"n_events_cam2": 7}, "all runs on a flight saw the same events"),
        ("ssac", {"seed": 7}, "all runs on a flight saw the same events"),
        # The search around 500 ms ends at 1500 ms.
        ("zncc_e", {"t_d_error_ms": 1.5e3, "t_d_estimate_ms": -1e3}, "errors are possible ones"),
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
