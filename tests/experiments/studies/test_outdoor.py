"""The outdoor study: what is found on true tracks, one short flight, and what is made of rows."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

from experiments.cli import app
from experiments.lab.results import Results
from experiments.studies import outdoor
from experiments.studies.outdoor import KINDS, MEASURED, OutdoorCell, OutdoorRow, oracle_table
from tests.experiments.worlds.test_outdoor import DURATION_S, outdoor_truth

(STUDY,) = outdoor.STUDIES


def test_what_is_true_is_found_and_errors_are_within_their_deviations(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(outdoor, "truths_of", lambda folders: (outdoor_truth(),))
    row = outdoor.outdoor_row(OutdoorCell(0, "all_true", DURATION_S), (tmp_path,))
    assert row.status == "ok", row.reason
    # Tracks are exact to the file's 1e-4 px, but points are interpolated between 20 ms.
    assert row.t_d_error_ms < 0.1
    assert row.skew_error_ppm < 2.0
    assert row.rmse_m < 0.04  # RTK's noise alone is 0.024 m
    assert row.icp_rmse_m < row.rmse_m
    assert row.scale_error_percent < 0.1
    assert row.coverage > 0.8


@pytest.mark.render
def test_a_short_flight_gives_both_tables_and_from_the_cache_again(tmp_path: Path) -> None:
    texts = []
    for name in ("first", "again"):
        out = tmp_path / name
        out.mkdir()
        args = ["outdoor", "--flights", "1", "--duration", "10", "--out", str(out)]
        result = CliRunner().invoke(app, [*args, "--cache", str(tmp_path / "cache")])
        assert result.exit_code == 0, result.output
        texts.append([(out / name).read_text() for name in ("outdoor.csv", "outdoor_oracle.csv")])
    assert texts[0] == texts[1]
    recordings = (tmp_path / "cache" / "recordings").iterdir()
    assert sum(path.is_dir() for path in recordings) == 2  # one has the third camera
    runs = Results(tmp_path / "first").table("outdoor")
    assert list(runs) == list(STUDY.runs.columns)
    assert list(runs["kind"]) == list(KINDS)
    # 10 s may be too little motion for the pose, which is then refused and says why.
    assert runs.loc[runs["rmse_m"].isna(), "reason"].notna().all()
    assert (tmp_path / "first" / "outdoor.png").exists() == bool(
        runs.set_index("kind")["rmse_m"].notna()["two_at_once"]
    )


def test_options_are_those_of_the_cells_and_stand_in_the_command_line() -> None:
    given = {"flights": 2, "duration": 30.0, "third": False}
    assert STUDY.command_line(STUDY.options) == "ssac outdoor"
    assert STUDY.command_line(given) == "ssac outdoor --flights 2 --duration 30.0 --no-third"
    cells = outdoor.cells(**given)
    assert [cell.kind for cell in cells] == [*KINDS[:-1]] * 2
    assert {cell.config.spline.duration_s for cell in cells} == {30.0}
    with_third = [cell for cell in outdoor.cells(1) if len(cell.recordings) == 2]
    assert [cell.kind for cell in with_third] == ["three_cameras"]


def test_the_oracle_table_has_the_means_of_what_was_answered(tmp_path: Path) -> None:
    ones = vars(OutdoorRow("ok", **dict.fromkeys(MEASURED, 1.0)))
    rows = [ones | {"kind": kind} for kind in ("a", "a", "b")]
    rows[0]["rmse_m"], rows[0]["t_d_error_ms"], rows[2]["rmse_m"] = 3.0, 3.0, np.nan
    runs = pd.DataFrame(rows)
    table = oracle_table(runs).set_index("kind")
    assert table.loc["a", "rmse_m"] == 2.0
    assert list(table["answered"]) == [2, 0]
    assert list(table["of"]) == [2, 1]
    runs.to_csv(tmp_path / "outdoor.csv", index=False)
    cells = outdoor.page_table(Results(tmp_path)).splitlines()[2].split("|")
    shown = [cell.strip() for cell in cells]
    assert shown[1:4] == ["a", "2 of 2", "2.000"]
    assert "1, 2" in shown  # 3 ms are no 1.96 deviations of 1 ms
    assert "2.000 (3.000)" in shown
