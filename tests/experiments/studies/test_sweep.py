"""The table and figure of a user's own grid, of made-up runs; `sweep` beside has real ones."""

import numpy as np
import pandas as pd
import pytest
from scipy.stats import t as student
from typer.testing import CliRunner

from experiments import commands
from experiments.cli import app
from experiments.lab import study as lab
from experiments.lab.schedule import Outcome
from experiments.paper.quantities import ERRORS
from experiments.studies.sweep import points_figure, points_table
from ssac.errors import SsacError

TOML = """
title = "mine"
flights = 4
methods = ["ssac", "event_rate"]
[grid]
sim.angle_deg = [30, 90]
"""


def runs() -> pd.DataFrame:
    rows = [
        {"sim.angle_deg": angle_deg, "flight": flight, "seed": 1, "method": method,
         "status": "ok", "reason": "", "t_d_error_ms": 1.0 + flight + angle_deg,
         "r_error_deg": 0.5 if method == "ssac" else np.nan,
         "t_error_deg": 0.5 if method == "ssac" else np.nan}
        for angle_deg in (30, 90)
        for flight in range(4)
        for method in ("ssac", "event_rate")
    ]  # fmt: skip
    table = pd.DataFrame(rows)
    table.loc[[0, 2], "status"] = "search_bound"
    table.loc[4, "status"] = "no_match"
    return table


def test_a_point_has_counts_refusals_means_medians_and_intervals():
    table = points_table(runs(), ["sim.angle_deg"])
    assert list(zip(table["sim.angle_deg"], table["method"], strict=True)) == [
        (30, "ssac"), (30, "event_rate"), (90, "ssac"), (90, "event_rate"),
    ]  # fmt: skip
    refused, all_there = table.iloc[0], table.iloc[1]
    assert (refused["runs"], refused["answered"]) == (4, 1)
    assert refused["refusals"] == "no_match 1, search_bound 2"
    assert refused["t_d_error_ms_mean"] == 34.0
    assert np.isnan(refused["t_d_error_ms_low"])  # one run has no interval
    assert all_there["refusals"] == ""
    values = np.array([31.0, 32.0, 33.0, 34.0])
    half = student.ppf(0.975, 3) * values.std(ddof=1) / 2.0
    assert all_there["t_d_error_ms_mean"] == all_there["t_d_error_ms_median"] == 32.5
    assert all_there["t_d_error_ms_low"] == pytest.approx(32.5 - half)
    assert all_there["t_d_error_ms_high"] == pytest.approx(32.5 + half)
    assert all_there[[f"{error}_mean" for error in ERRORS][1:]].isna().all()


@pytest.mark.parametrize("kind", [float, str])
def test_the_figure_has_a_panel_for_each_error_and_a_line_for_each_method(kind):
    table = points_table(runs(), ["sim.angle_deg"]).astype({"sim.angle_deg": kind})
    figure = points_figure(table, ["sim.angle_deg"])
    assert len(figure.axes) == 3
    if kind is float:  # words are drawn by their methods
        assert [len(axes.containers) for axes in figure.axes] == [2, 2, 2]
        assert [text.get_text() for text in figure.legends[0].get_texts()] == ["ssac", "event_rate"]


@pytest.mark.parametrize(
    ("line", "names"),
    [
        (("ablate", "{}"), {"my_runs.csv", "my_runs.provenance.json", "my.csv",
                            "my.provenance.json", "my.png"}),
        (("sweep", "{}"), {"rows.csv", "rows.provenance.json", "rows_cells.csv",
                           "rows_cells.provenance.json", "rows.png"}),
    ],
)  # fmt: skip
def test_ones_own_file_ends_in_a_table_and_a_figure(tmp_path, monkeypatch, line, names):
    config, out = tmp_path / "my.toml", tmp_path / "out"
    config.write_text(TOML)
    table = runs().drop(columns=["sim.angle_deg"])

    def run_cells(cells, *_, **__):
        return Outcome(pd.concat([pd.DataFrame([cell.columns for cell in cells])["sim.angle_deg"],
                                  table], axis=1), 8, 8, 1.0)  # fmt: skip

    monkeypatch.setattr(lab, "run_cells", run_cells)
    monkeypatch.setattr(lab, "context_or_none", lambda: None)
    target = out / "rows.csv" if line[0] == "sweep" else out
    arguments = [*(word.format(config) for word in line), "--out", str(target)]
    result = CliRunner().invoke(app, [*arguments, "--cache", str(tmp_path)], catch_exceptions=False)
    assert result.exit_code == 0, result.output
    assert {path.name for path in out.iterdir()} == names
    assert "t_d_error_ms ± median" in result.output  # the table is shown, too


def test_a_file_of_ones_own_is_checked_before_the_work(tmp_path):
    config = tmp_path / "my.toml"
    config.write_text(TOML.replace("sim.angle_deg", "sim.angel_deg"))
    for command in ("ablate", "sweep"):
        with pytest.raises(SsacError, match=r"my\.toml: unknown parameter 'sim\.angel_deg'"):
            CliRunner().invoke(app, [command, str(config)], catch_exceptions=False)
    with pytest.raises(SsacError, match="unknown ablation 'mine'"):
        commands.ablate_command(names=["mine"])
