"""The studies of the bench: their recordings, and what is made of their rows."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from experiments.lab.files import csv_text
from experiments.lab.results import Results
from experiments.studies import error_budget, light_latency, mini
from experiments.worlds.bench import KINDS

STUDIES = (*mini.STUDIES, *error_budget.STUDIES, *light_latency.STUDIES)


def test_tables_share_recordings_and_set_ups_and_a_trial_run_says_that_it_has_fewer() -> None:
    cells = mini.cells(10.0)
    assert len({cell.recordings for cell in cells}) == len({cell.seed for cell in cells}) == 4 * 10
    assert len({cell.sim.setup_seed for cell in cells}) == 4
    for study in STUDIES:
        cells = study.cells(recordings=1)
        per_place = {(cell.sim.angle_deg, cell.seed) for cell in cells}
        assert len(per_place) == len({cell.sim.angle_deg for cell in cells})
        assert study.command_line({"recordings": None}) == "ssac physical"
        assert study.command_line({"recordings": 1}) == "ssac physical --recordings 1"


def test_the_papers_own_tables_agree_with_themselves(tmp_path: Path) -> None:
    names = {"ssac": "ssac_t_d", "r": "ssac_r", "t": "ssac_t"}
    for duration_s, table in mini.published_tables().items():
        ours = table.assign(n_runs=10, ssac_failed=0).rename(
            columns={f"{theirs}_error_{unit}_{part}": f"{name}_error_{unit}_{part}"
                     for theirs, name in names.items() for unit in ("ms", "deg")
                     for part in ("mean", "std")}
        )  # fmt: skip
        (tmp_path / f"mini_{duration_s:g}.csv").write_text(csv_text(ours))
    comparison = mini.comparison(Results(tmp_path))
    assert len(comparison) == len(mini.DURATIONS_S) * 12 * 3
    assert (comparison["verdict"] == "agrees").all()


def test_the_budget_counts_and_averages_what_was_answered() -> None:
    runs = pd.DataFrame(
        {
            "kind": kind, "angle_deg": 43.14, "flight": flight, "method": method, "status": "ok",
            "t_d_ms": 50.0, "t_d_estimate_ms": 50.0 + error_ms, "t_d_error_ms": abs(error_ms),
            "r_error_deg": 1.0, "t_error_deg": 2.0, "t_d_std_ms": 1.0,
        }
        for kind in KINDS
        for method in error_budget.METHODS
        for flight, error_ms in enumerate((-1.0, 3.0, 0.5))
    )  # fmt: skip
    runs.loc[0, "status"] = "ambiguous_offset"
    table = error_budget.budget_table(runs)
    assert len(table) == len(KINDS) * 3
    first, second = table.iloc[0], table.iloc[1]
    assert (first["runs"], first["answered"]) == (3, 2)
    assert first["t_d_error_ms_mean"] == pytest.approx(1.75)
    assert second["t_d_bias_ms"] == pytest.approx(2.5 / 3)
    assert second["t_d_held"] == pytest.approx(2 / 3)  # 3 ms are more than 1.96 deviations


def test_swapping_the_lights_takes_a_latency_away_and_leaves_the_clocks_offset() -> None:
    clock_ms = 0.2
    runs = pd.DataFrame(
        {"light_ratio": ratio, "polarity": polarity, "flight": flight, "t_d_std_ms": 0.1,
         "status": "ok", "t_d_ms": 50.0,
         "t_d_estimate_ms": 50.0 + clock_ms + scale * np.log(ratio)}
        for flight in range(2)
        for ratio in light_latency.RATIOS
        for polarity, scale in (("both", -1.0), ("on", -0.5), ("off", -1.5))
    )  # fmt: skip
    table = light_latency.latency_table(runs)
    np.testing.assert_allclose(table["swapped_ms"], clock_ms, atol=1e-9)  # of logarithms of 32
    effects = [cell.sim.effects for cell in light_latency.cells(1)]
    lights = {(one.illuminance_lux, one.illuminance_lux * one.camera2_light) for one in effects}
    rounded = {(round(first, 6), round(second, 6)) for first, second in lights}
    # A ratio and its inverse are the same cameras with their lights swapped.
    assert {(second, first) for first, second in rounded} == rounded
