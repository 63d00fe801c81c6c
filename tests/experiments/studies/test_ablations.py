"""Ablations and users' own grids: tables and figures of their runs, and tangency's variants."""

from itertools import product
from pathlib import Path
from shutil import copy

import numpy as np
import pandas as pd
import pytest
from scipy.stats import t as student

from experiments.lab import study as lab
from experiments.lab.grid import grid_from_content
from experiments.lab.results import Results, csv_text, record_checksums
from experiments.lab.schedule import Outcome
from experiments.paper.esim import ERRORS
from experiments.studies.ablations import ablation_table, points_figure, points_table, sweep_study
from experiments.studies.tangency import AS_IT_IS, VARIANTS
from ssac.errors import SsacError
from ssac.rules import TangencyRules
from tests.experiments.command import run
from tests.experiments.reported import RESULTS

VARIED = ["sim.angle_deg"]
TOML = """
title = "mine"
flights = 4
methods = ["ssac", "event_rate"]
[grid]
sim.angle_deg = [30, 90]
"""


def runs() -> pd.DataFrame:
    """Return runs at two angles on four flights, of a method with poses and one without; 3 fail."""
    rows = [
        {"sim.angle_deg": angle_deg, "sim.distance_m": angle_deg / 7.5, "flight": flight,
         "seed": 1, "method": method, "status": "ok", "reason": "", "n_samples": 300 + flight,
         "t_d_error_ms": 1.0 + flight + angle_deg,
         "r_error_deg": 0.5 + flight if method == "ssac" else np.nan,
         "t_error_deg": 0.5 if method == "ssac" else np.nan}
        for angle_deg, flight, method in product((30, 90), range(4), ("ssac", "event_rate"))
    ]  # fmt: skip
    table = pd.DataFrame(rows)
    table.loc[[0, 2], "status"] = "search_bound"
    table.loc[4, "status"] = "no_match"
    return table


@pytest.mark.parametrize("table", [ablation_table(runs(), VARIED), points_table(runs(), VARIED)])
def test_each_point_is_a_row_with_the_means_of_what_was_answered(table: pd.DataFrame) -> None:
    points = zip(table["sim.angle_deg"], table["method"], strict=True)
    assert list(points) == list(product((30, 90), ("ssac", "event_rate")))
    assert list(table["t_d_error_ms_mean"]) == [34.0, 32.5, 92.5, 92.5]
    assert list(table["t_d_error_ms_median"]) == [34.0, 32.5, 92.5, 92.5]
    assert list(table["r_error_deg_mean"].dropna()) == [3.5, 2.0]
    assert table.iloc[1][["r_error_deg_mean", "t_error_deg_mean"]].isna().all()


def test_ablations_and_points_count_what_was_refused_and_how_runs_scatter() -> None:
    means, points = ablation_table(runs(), VARIED), points_table(runs(), VARIED)
    assert list(means["n_runs"]) == list(points["runs"]) == [4, 4, 4, 4]
    assert list(means["failed"]) == [3, 0, 0, 0]
    assert means["n_samples_mean"][1] == 301.5
    assert list(points["answered"]) == [1, 4, 4, 4]
    assert list(points["refusals"]) == ["no_match 1, search_bound 2", "", "", ""]
    values = np.array([31.0, 32.0, 33.0, 34.0])
    assert means["t_d_error_ms_std"][1] == pytest.approx(values.std())
    half = student.ppf(0.975, 3) * values.std(ddof=1) / 2.0
    ends = points[["t_d_error_ms_low", "t_d_error_ms_high"]]
    assert tuple(ends.iloc[1]) == pytest.approx((32.5 - half, 32.5 + half))
    assert np.isnan(ends.iloc[0]).all()  # one run has no interval


def test_the_figure_has_a_panel_for_each_error_where_words_are_drawn_over_the_methods() -> None:
    grid = grid_from_content("my", {"grid": {"sim": {"angle_deg": [30, 90]}}})
    figure = points_figure(points_table(runs(), VARIED).astype({"sim.angle_deg": str}), grid)
    assert len(figure.axes) == len(ERRORS)


def test_the_figure_of_ones_own_grid_has_the_axis_that_its_file_asks_for() -> None:
    look = {"x": "sim.angle_deg", "label": "angle [mrad]", "scale": 17.45, "log": True}
    both = {"sim": {"angle_deg": [30, 90], "distance_m": [4.0, 12.0]}}
    grid = grid_from_content("my", {"together": {"both": both}, "figure": look})
    points = points_table(runs(), grid.varied)
    (draw,) = (one for one in sweep_study(grid, "my.csv", "").makes if one.file == "my.png")
    figure = draw.make(Results(Path(), {"my_cells.csv": csv_text(points)}))
    assert len(figure.axes) == len(ERRORS)
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["ssac", "event_rate"]
    for axes in figure.axes:
        assert len(axes.containers) == 2  # a line for each method
        assert (axes.get_xlabel(), axes.get_xscale()) == ("angle [mrad]", "log")
        for bars in axes.containers:
            assert list(bars.lines[0].get_xdata()) == pytest.approx([523.5, 1570.5])


@pytest.mark.parametrize(
    ("command", "place", "tables", "figure"),
    [("ablate", "", ("my_runs", "my"), "my"), ("sweep", "a.csv", ("a", "a_cells"), "a")],
)
def test_ones_own_file_ends_in_a_table_and_a_figure(
    tmp_path, monkeypatch, command, place, tables, figure
) -> None:
    (tmp_path / "my.toml").write_text(TOML)
    monkeypatch.setattr(lab, "run_cells", lambda *_, **__: Outcome(runs(), 8, 8, 1.0))
    monkeypatch.setattr(lab, "context_or_none", lambda: None)
    folders = "--out", tmp_path / "out" / place, "--cache", tmp_path
    assert "t_d_error_ms ± median" in run(command, tmp_path / "my.toml", *folders)  # the table
    names = {f"{name}{end}" for name in tables for end in (".csv", ".provenance.json")}
    assert {path.name for path in (tmp_path / "out").iterdir()} == {*names, f"{figure}.png"}


def test_ones_own_grid_does_not_replace_a_result_of_the_project(tmp_path) -> None:
    out = tmp_path / "results"
    out.mkdir()
    for name in ("esim_10.csv", "ablation_window.csv"):
        copy(RESULTS / name, out)
    record_checksums(out, out.iterdir())
    before = sorted((path, path.read_bytes()) for path in out.iterdir())
    for command, name, where in (
        ("sweep", "esim_10", out / "esim_10.csv"),
        ("sweep", "a", out / "ablation_window.csv"),
        ("ablate", "ablation_window", out),
    ):
        (tmp_path / f"{name}.toml").write_text(TOML)
        with pytest.raises(SsacError, match=r"\.csv: is a result of the project"):
            run(command, tmp_path / f"{name}.toml", "--out", where, "--cache", tmp_path)
    assert sorted((path, path.read_bytes()) for path in out.iterdir()) == before


def test_the_variants_of_tangency_differ_from_it_and_from_each_other() -> None:
    assert VARIANTS[AS_IT_IS] == TangencyRules()
    assert len(set(VARIANTS.values())) == len(VARIANTS)
