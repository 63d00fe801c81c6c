"""The command on one short flight: what is simulated is kept, and gives the same again."""

import pandas as pd
import pytest
from typer.testing import CliRunner

from experiments.cli import app
from experiments.outdoor.flights import DURATION_S, N_FLIGHTS
from experiments.outdoor.outdoor_command import (
    COMMAND,
    ORACLE_FILE,
    RUNS_FILE,
    command_of,
    kinds_of,
)
from experiments.outdoor.twin import COLUMNS

pytestmark = pytest.mark.render


def test_a_short_flight_gives_both_tables_and_from_the_cache_again(tmp_path):
    texts = []
    for name in ("first", "again"):
        out = tmp_path / name
        out.mkdir()
        args = ["outdoor", "--flights", "1", "--duration", "10", "--out", str(out)]
        result = CliRunner().invoke(app, [*args, "--cache", str(tmp_path / "cache")])
        assert result.exit_code == 0, result.output
        texts.append((out / RUNS_FILE).read_text() + (out / ORACLE_FILE).read_text())
    assert texts[0] == texts[1]
    recordings = (tmp_path / "cache" / "recordings").iterdir()
    assert sum(path.is_dir() for path in recordings) == 2  # one has the third camera
    runs = pd.read_csv(tmp_path / "first" / RUNS_FILE)
    assert list(runs) == list(COLUMNS)
    assert list(runs.kind) == list(kinds_of())
    # 10 s may be too little motion for the pose, which is then refused and says why.
    assert runs.set_index("kind").reason[runs.set_index("kind").rmse_m.isna()].notna().all()


def test_a_folder_that_is_not_there_is_refused(tmp_path):
    result = CliRunner().invoke(app, ["outdoor", "--out", str(tmp_path / "none")])
    assert "no such folder" in str(result.exception)


def test_the_provenance_has_the_command_line_that_was_given():
    assert command_of(N_FLIGHTS, DURATION_S, True) == COMMAND
    assert command_of(2, 30.0, False) == f"{COMMAND} --flights 2 --duration 30.0 --no-third"
