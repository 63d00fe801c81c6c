"""Efficiency: runs beside the bounds of their flights, their summary and its figure."""

from itertools import product

import numpy as np
import pandas as pd
import pytest

from experiments.drawing.errors import pooled
from experiments.studies.efficiency import (
    efficiency_table,
    runs_beside_bounds,
)
from experiments.worlds.bound import KNOWN_POSE, SAMPLES
from tests.experiments.reported import made_up_runs

METHODS = ("ssac", "ssac-known", "joint", "joint-known", "tangency", "tangency-known", "zncc_e")
BOUNDED = METHODS[:-1]
T_DS_MS = (5.0, 50.0, 500.0)


def made_up_bounds(flights: int = 3) -> pd.DataFrame:
    """Bounds of all methods, each another one."""
    flown = product((10.0, 20.0), (30.0, 60.0, 90.0, 120.0, 150.0), range(flights), SAMPLES)
    table = pd.DataFrame(flown, columns=["duration_s", "angle_deg", "flight", "method"])
    known = table["method"].isin(KNOWN_POSE)
    t_d_bound_ms = 1e-3 * (table["angle_deg"] + table["flight"]) / np.sqrt(table["duration_s"])
    return table.assign(
        status="ok",
        sigma_px=0.3,
        n_samples=340,
        t_d_bound_ms=t_d_bound_ms,
        r_bound_deg=np.where(known, np.nan, 0.06),
        t_bound_deg=np.where(known, np.nan, 0.03),
    )


def beside_bounds(methods: tuple[str, ...] = METHODS, flights: int = 3) -> pd.DataFrame:
    return runs_beside_bounds(made_up_runs(methods, flights), made_up_bounds(flights))


def test_every_run_stands_beside_the_bound_of_its_recording() -> None:
    beside = beside_bounds()
    assert len(beside) == 2 * 5 * 3 * 3 * len(BOUNDED)
    for row in beside.to_dict("records"):
        expected_ms = 1e-3 * (row["angle_deg"] + row["flight"]) / np.sqrt(row["duration_s"])
        assert row["t_d_bound_ms"] == pytest.approx(expected_ms)
        given = row["method"] in KNOWN_POSE
        assert np.isnan(row["r_bound_deg"]) == np.isnan(row["t_error_deg"]) == given
        if not given:
            assert row["t_bound_deg"] == 0.03


def test_efficiency_is_the_ratio_of_root_mean_squares() -> None:
    beside = beside_bounds()
    cells = efficiency_table(beside)
    assert len(cells) == 2 * 5 * 3 * len(BOUNDED)
    cell = cells[(cells["method"] == "joint") & (cells["t_d_ms"] == 50.0)].iloc[0]
    same = (beside["method"] == "joint") & (beside["t_d_ms"] == 50.0)
    same &= beside["duration_s"] == cell["duration_s"]
    same &= beside["angle_deg"] == cell["angle_deg"]
    own = beside[same]
    assert cell["n_runs"] == len(own) == 3
    assert cell["t_d_bound_ms"] ** 2 == pytest.approx((own["t_d_bound_ms"] ** 2).mean())
    assert cell["t_d_rms_ms"] ** 2 == pytest.approx((own["t_d_error_ms"] ** 2).mean())
    for parameter, unit in (("t_d", "ms"), ("r", "deg"), ("t", "deg")):
        ratio = cell[f"{parameter}_bound_{unit}"] / cell[f"{parameter}_rms_{unit}"]
        assert cell[f"{parameter}_efficiency"] == pytest.approx(ratio)


def test_errors_as_large_as_the_bound_lets_expect_have_efficiency_one() -> None:
    beside = pd.concat([beside_bounds(("joint",), 30)] * 10, ignore_index=True)
    noise = np.random.default_rng(0).standard_normal(len(beside))
    beside["t_d_error_ms"] = np.abs(noise) * beside["t_d_bound_ms"]
    efficiencies = efficiency_table(beside)["t_d_efficiency"]
    # 300 errors in each of 30 cells: deviations of 1 / sqrt(600), four of which are 0.16.
    assert np.all(np.abs(efficiencies - 1.0) < 0.16)
    assert efficiencies.mean() == pytest.approx(1.0, abs=0.03)


def test_neither_failed_runs_nor_flights_without_a_bound_are_compared() -> None:
    runs, bounds = made_up_runs(("joint",), 3), made_up_bounds(3)
    runs.loc[0, ["status", "t_d_error_ms"]] = ["too_few_samples", np.nan]
    bounds.loc[bounds["flight"] == 2, "status"] = "unusable"
    cells = efficiency_table(runs_beside_bounds(runs, bounds))
    assert sorted(cells["n_runs"].unique()) == [1, 2]
    assert cells["t_d_efficiency"].notna().all()


def test_offsets_are_pooled_as_many_runs_as_each_has() -> None:
    cells = pd.DataFrame(
        {"angle_deg": [30.0, 30.0, 60.0], "n_runs": [1, 3, 2], "t_d_rms_ms": [2.0, 1.0, 5.0]}
    )
    found = pooled(cells, ["t_d_rms_ms"])["t_d_rms_ms"]
    assert list(found) == pytest.approx([np.sqrt((4.0 + 3.0) / 4.0), 5.0])
