"""Coverage of errors drawn with their stated deviations, and efficiency for made-up bounds."""

from itertools import product
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy.stats import binomtest

from experiments.drawing.errors import pooled
from experiments.studies import coverage, efficiency
from experiments.studies.coverage import QUANTITIES, coverage_table
from tests.experiments.reported import made_up_runs

T_D_MS = 50.0
OF_CLOCKS = {"t_d", "skew"}  # quantities that are estimated where the pose is known


def drawn_runs(n: int = 400, scale: float = 1.0) -> pd.DataFrame:
    """Return runs of two methods at two angles; errors are `scale` times the stated deviations."""
    rng, rows = np.random.default_rng(0), []
    of_pose = [one.column for name, one in QUANTITIES.items() if name not in OF_CLOCKS]
    for number, method in product(range(n), ("joint", "joint-known")):
        angles = scale * rng.normal(size=5)
        pose = [np.linalg.norm(angles[:3]), np.linalg.norm(angles[3:]), *angles]
        error_ms, skew_ppm = 0.2 * scale * rng.normal(), abs(30.0 * scale * rng.normal())
        row = {
            "sim.t_d_s": 1e-3 * T_D_MS, "sim.angle_deg": 30.0 if number % 2 else 90.0,
            "flight": 1000 + number // 2, "method": method, "status": "ok",
            "t_d_estimate_ms": T_D_MS + error_ms, "t_d_std_ms": 0.2,
            "skew_error_ppm": skew_ppm, "skew_std_ppm": 30.0,
        }  # fmt: skip
        if method == "joint":
            row |= dict(zip(of_pose, pose, strict=True))
        rows.append(row)
    return pd.DataFrame(rows)


def row_of(table: pd.DataFrame, quantity: str, angle: str = "all") -> dict[str, Any]:
    is_it = (table["quantity"] == quantity) & (table["angle_deg"] == angle)
    (row,) = table[is_it & (table["method"] == "joint")].to_dict("records")
    return row


RIGHT = coverage_table(drawn_runs())


@pytest.mark.parametrize("quantity", QUANTITIES)
def test_right_deviations_cover_what_they_say(quantity: str) -> None:
    row = row_of(RIGHT, quantity)
    assert (row["n_runs"], row["refused"]) == (400, 0)
    # Four standard errors of 400 runs: 1 / sqrt(800) of the RMS, sqrt(p (1 - p) / 400) of a share.
    assert row["rms_normalised"] == pytest.approx(1.0, abs=0.14)
    for level in coverage.LEVELS:
        name = f"coverage_{100 * level:g}"
        assert row[name] == pytest.approx(level, abs=0.2 * np.sqrt(level * (1.0 - level)))
        assert row[f"{name}_low"] < row[name] < row[f"{name}_high"] or row[name] == 1.0


@pytest.mark.parametrize(("scale", "sign"), [(1.5, -1), (0.6, 1)])
def test_wrong_deviations_are_found_out(scale: float, sign: int) -> None:
    table = coverage_table(drawn_runs(scale=scale))
    for quantity in ("t_d", "R", "t"):
        row = row_of(table, quantity)
        assert row["rms_normalised"] == pytest.approx(scale, rel=0.14)
        assert sign * (row["coverage_68"] - 0.68) > 0.1
        assert sign * (row["coverage_95_low" if sign > 0 else "coverage_95_high"] - 0.95) > 0.0


def test_angles_are_told_apart_and_a_known_pose_has_no_region() -> None:
    assert set(RIGHT["angle_deg"]) == {"all", "30", "90"}
    assert row_of(RIGHT, "t_d", "30")["n_runs"] == 200
    assert set(RIGHT.loc[RIGHT["method"] == "joint-known", "quantity"]) == OF_CLOCKS


def test_a_refused_run_is_counted_and_covers_nothing() -> None:
    runs = drawn_runs(100)
    refused = runs["method"].eq("joint") & runs["flight"].lt(1005)
    out = runs.assign(status=runs["status"].mask(refused, "degenerate_pose"))
    out.loc[refused, "t_d_estimate_ms"] = 0.0  # far from the truth
    before, after = (row_of(coverage_table(table), "t_d") for table in (runs, out))
    assert (after["n_runs"], after["refused"]) == (100, 10)
    inside = np.round(100 * before["coverage_99"]), np.round(90 * after["coverage_99"])
    assert inside[0] - 10 <= inside[1] <= inside[0]


def test_bounds_are_clopper_and_pearsons_and_levels_those_of_chi_squared() -> None:
    for n_inside, n in ((0, 20), (20, 20), (475, 500)):
        interval = binomtest(n_inside, n).proportion_ci(coverage.SAMPLING)
        assert coverage.sampling_bounds(n_inside, n) == pytest.approx(tuple(interval))
    for parameters, limit in ((1, 1.96), (1, -1.96), (2, 2.4477), (3, 2.7955)):
        assert coverage.confidence(np.array([limit]), parameters) == pytest.approx(0.95, abs=1e-4)


def made_up_bounds(flights: int = 3) -> pd.DataFrame:
    """Return made-up bounds of all methods, which differ by angle, flight and duration."""
    angles_deg = (30.0, 60.0, 90.0, 120.0, 150.0)
    flown = product((10.0, 20.0), angles_deg, range(flights), efficiency.SAMPLES)
    table = pd.DataFrame(flown, columns=["duration_s", "angle_deg", "flight", "method"])
    known = table["method"].str.endswith("-known")
    t_d_bound_ms = 1e-3 * (table["angle_deg"] + table["flight"]) / np.sqrt(table["duration_s"])
    return table.assign(
        status="ok", sigma_px=0.3, n_samples=340, t_d_bound_ms=t_d_bound_ms,
        r_bound_deg=np.where(known, np.nan, 0.06), t_bound_deg=np.where(known, np.nan, 0.03),
    )  # fmt: skip


def test_errors_as_large_as_the_bound_lets_expect_have_efficiency_one() -> None:
    beside = efficiency.runs_beside_bounds(made_up_runs(("joint",), 30), made_up_bounds(30))
    beside = pd.concat([beside] * 10, ignore_index=True)
    noise = np.random.default_rng(0).standard_normal(len(beside))
    beside["t_d_error_ms"] = np.abs(noise) * beside["t_d_bound_ms"]
    efficiencies = efficiency.efficiency_table(beside)["t_d_efficiency"]
    # 300 errors in each of 30 cells: 0.16 is four standard errors of 1 / sqrt(600).
    assert np.all(np.abs(efficiencies - 1.0) < 0.16)
    assert efficiencies.mean() == pytest.approx(1.0, abs=0.03)


def test_neither_failed_runs_nor_flights_without_a_bound_are_compared() -> None:
    runs, bounds = made_up_runs(("joint", "zncc_e"), 3), made_up_bounds()
    runs.loc[0, ["status", "t_d_error_ms"]] = ["too_few_samples", np.nan]
    bounds.loc[bounds["flight"] == 2, "status"] = "unusable"
    cells = efficiency.efficiency_table(efficiency.runs_beside_bounds(runs, bounds))
    assert set(cells["method"]) == {"joint"}
    assert sorted(cells["n_runs"].unique()) == [1, 2]
    assert cells["t_d_efficiency"].notna().all()


def test_offsets_are_pooled_as_many_runs_as_each_has() -> None:
    cells = pd.DataFrame(
        {"angle_deg": [30.0, 30.0, 60.0], "n_runs": [1, 3, 2], "t_d_rms_ms": [2.0, 1.0, 5.0]}
    )
    found = pooled(cells, ["t_d_rms_ms"])["t_d_rms_ms"]
    assert list(found) == pytest.approx([np.sqrt((4.0 + 3.0) / 4.0), 5.0])
