"""A recording on the bench from nothing to its rows, and what is made of rows."""

from io import StringIO
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

from experiments.cli import app
from experiments.lab.cache import Cache
from experiments.lab.files import csv_text
from experiments.lab.schedule import Workers, run_cells
from experiments.physical.budget import budget_figure, budget_table
from experiments.physical.catalogue import STUDIES
from experiments.physical.cells import cells_of, motion_seed, setup_seed
from experiments.physical.imperfections import ANGLES_DEG, KINDS, NONE, bench_of, only
from experiments.physical.latency import RATIOS, latency_cells, latency_figure, latency_table
from experiments.physical.measure import PHYSICAL
from experiments.physical.mini import (
    DURATIONS_S,
    comparison_text,
    mini_cells,
    mini_figure,
    published_tables,
)

ANGLE_DEG, DURATION_S, FLIGHT = 95.18, 6.0, 50_000


def test_a_short_recording_gives_its_offset_and_kinds_of_it_share_it(tmp_path: Path) -> None:
    setup = setup_seed(ANGLE_DEG, FLIGHT)
    cells = [
        cell
        for kind in (NONE, only("wire"))
        for cell in cells_of(
            bench_of(kind, ANGLE_DEG, DURATION_S, setup),
            {"kind": kind},
            FLIGHT,
            (5.0, 50.0),
            ("ssac", "joint", "tangency"),
        )
    ]
    outcome = run_cells(cells, Cache(tmp_path), Workers(1), show_progress=False, measure=PHYSICAL)
    runs = outcome.runs
    assert outcome.n_simulated == 1
    assert (runs["status"] == "ok").all(), runs["reason"]
    assert (runs["seed"] == motion_seed(DURATION_S, ANGLE_DEG, FLIGHT)).all()
    # Six seconds on an ideal bench leave `ssac` 0.2 to 1.6 ms (four recordings): a drone of
    # 26 px moves a pixel in 6 ms, and its middle is no point of it. Twice the most, for any method.
    assert runs["t_d_error_ms"].max() < 3.3
    # `tangency`, which states 0.04 to 0.07 ms, leaves up to 0.09: four deviations at the least.
    ideal = (runs["kind"] == NONE) & (runs["method"] == "tangency")
    assert runs.loc[ideal, "t_d_error_ms"].max() < 0.3
    # The offsets of a recording differ in the clock alone, which the methods follow exactly.
    errors = runs.pivot_table(index=["kind", "method"], columns="t_d_ms", values="t_d_error_ms")
    np.testing.assert_allclose(errors[5.0], errors[50.0], atol=1e-6)
    counts = runs.groupby("kind")["n_events_cam1"].first()
    assert counts[only("wire")] > counts[NONE]
    again = run_cells(cells, Cache(tmp_path), Workers(1), show_progress=False, measure=PHYSICAL)
    pd.testing.assert_frame_equal(again.runs, runs)
    assert again.n_recordings == 0


def test_the_tables_share_recordings_among_offsets_and_set_ups_among_recordings() -> None:
    cells = mini_cells(10.0)
    recordings = {cell.recordings for cell in cells}
    assert len(recordings) == 4 * 10
    assert len({cell.sim.setup_seed for cell in cells}) == 4
    assert len({cell.seed for cell in cells}) == 4 * 10


def test_seeds_of_tables_budget_and_latency_are_their_own() -> None:
    seeds = [
        {cell.seed for cell in study.cells()}  # type: ignore[attr-defined]
        for study in STUDIES
    ]
    assert sum(map(len, seeds)) == len(set().union(*seeds))


def test_the_papers_own_tables_agree_with_themselves(tmp_path: Path) -> None:
    for duration_s, table in published_tables().items():
        ours = table.assign(n_runs=10, ssac_failed=0).rename(
            columns={
                f"{theirs}_{part}": f"ssac_{name}_{part}"
                for theirs, name in (
                    ("ssac_error_ms", "t_d_error_ms"),
                    ("r_error_deg", "r_error_deg"),
                    ("t_error_deg", "t_error_deg"),
                )
                for part in ("mean", "std")
            }
        )
        (tmp_path / f"mini_{duration_s:g}.csv").write_text(csv_text(ours))
    comparison = pd.read_csv(StringIO(comparison_text(tmp_path)))
    assert len(comparison) == len(DURATIONS_S) * 12 * 3
    assert (comparison["verdict"] == "agrees").all()


def test_a_table_is_drawn_beside_what_the_paper_has_of_it() -> None:
    runs = pd.DataFrame(
        [
            {"duration_s": 10.0, "angle_deg": angle_deg, "flight": flight, "method": method,
             "status": "ok", "t_d_error_ms": 0.5, "r_error_deg": 1.0, "t_error_deg": 1.0}
            for angle_deg in ANGLES_DEG
            for flight in range(2)
            for method in ("ssac", "zncc_e")  # of which the paper has no physical table
        ]
    )  # fmt: skip
    axes = mini_figure(runs, runs).axes
    stars = [[line for line in one.get_lines() if line.get_marker() == "*"] for one in axes]
    assert [len(lines) for lines in stars] == [1, 1, 1]


def runs_of(rows: list[dict]) -> pd.DataFrame:
    return pd.DataFrame(rows).assign(status="ok", t_d_ms=50.0)


def test_the_budget_counts_and_averages_what_was_answered() -> None:
    rows = [
        {
            "kind": kind, "angle_deg": 43.14, "flight": flight, "method": method,
            "t_d_estimate_ms": 50.0 + error_ms, "t_d_error_ms": abs(error_ms),
            "r_error_deg": 1.0, "t_error_deg": 2.0, "t_d_std_ms": 1.0,
        }
        for kind in KINDS
        for method in ("ssac", "joint", "tangency")
        for flight, error_ms in enumerate((-1.0, 3.0, 0.5))
    ]  # fmt: skip
    runs = runs_of(rows)
    runs.loc[0, "status"] = "ambiguous_offset"
    table = budget_table(runs)
    assert len(table) == len(KINDS) * 3
    first, second = table.iloc[0], table.iloc[1]
    assert (first["runs"], first["answered"]) == (3, 2)
    assert first["t_d_error_ms_mean"] == pytest.approx(1.75)
    assert second["t_d_bias_ms"] == pytest.approx(2.5 / 3)
    assert second["t_d_held"] == pytest.approx(2 / 3)  # 3 ms are more than 1.96 deviations
    assert len(budget_figure(table, runs).axes) == 9


def test_swapping_the_lights_takes_a_latency_away_and_leaves_the_clocks_offset() -> None:
    rows = [
        {"light_ratio": ratio, "polarity": polarity, "flight": flight, "t_d_std_ms": 0.1,
         "t_d_estimate_ms": 50.0 + clock_ms + scale * np.log(ratio)}
        for clock_ms in (0.2,)
        for flight in range(2)
        for ratio in RATIOS
        for polarity, scale in (("both", -1.0), ("on", -0.5), ("off", -1.5))
    ]  # fmt: skip
    table = latency_table(runs_of(rows))
    np.testing.assert_allclose(table["swapped_ms"], 0.2, atol=1e-9)
    assert len(latency_figure(table, table).axes) == 1


def test_a_ratio_and_its_inverse_are_the_same_cameras_with_their_lights_swapped() -> None:
    lights = {
        (
            round(cell.sim.effects.illuminance_lux, 6),
            round(cell.sim.effects.illuminance_lux * cell.sim.effects.camera2_light, 6),
        )
        for cell in latency_cells(1)
    }
    assert {(second, first) for first, second in lights} == lights


def test_a_part_or_a_folder_that_is_not_there_is_refused(tmp_path: Path) -> None:
    result = CliRunner().invoke(app, ["physical", "weather", "--out", str(tmp_path)])
    assert "unknown part 'weather': use one of tables, budget, latency" in str(result.exception)
    result = CliRunner().invoke(app, ["physical", "--out", str(tmp_path / "none")])
    assert "there is no such folder" in str(result.exception)
