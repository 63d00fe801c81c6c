"""Coverage: of errors drawn as the deviations say, of runs that fail, and of real flights."""

import numpy as np
import pandas as pd
import pytest

from experiments.studies.coverage import (
    LEVELS,
    QUANTITIES,
    confidence,
    coverage_table,
    sampling_bounds,
)

T_D_S = 0.05
OF_CLOCKS = {"t_d", "skew"}  # what is found where the pose is known


def made_up_runs(n=400, scale=1.0, seed=0):
    """Runs of two methods at two angles; errors are `scale` of the stated deviations."""
    rng = np.random.default_rng(seed)
    rows = []
    for number in range(n):
        for method in ("joint", "joint-known"):
            angles = scale * rng.normal(size=5)
            error_ms = 0.2 * scale * rng.normal()
            row = {
                "sim.t_d_s": T_D_S,
                "sim.angle_deg": 30.0 if number % 2 else 90.0,
                "flight": 1000 + number // 2,
                "method": method,
                "status": "ok",
                "t_d_estimate_ms": 1e3 * T_D_S + error_ms,
                "t_d_std_ms": 0.2,
                "skew_error_ppm": abs(30.0 * scale * rng.normal()),
                "skew_std_ppm": 30.0,
            }
            names = [q.column for name, q in QUANTITIES.items() if name not in OF_CLOCKS]
            known = [np.linalg.norm(angles[:3]), np.linalg.norm(angles[3:]), *angles]
            values = known if method == "joint" else [np.nan] * 7
            rows.append(row | dict(zip(names, values, strict=True)))
    return pd.DataFrame(rows)


def cells(table, quantity, method="joint", angle="all"):
    chosen = table[
        (table["quantity"] == quantity)
        & (table["method"] == method)
        & (table["angle_deg"] == angle)
    ]
    (row,) = chosen.to_dict("records")
    return row


@pytest.mark.parametrize("quantity", QUANTITIES)
def test_right_deviations_cover_what_they_say(quantity):
    row = cells(coverage_table(made_up_runs()), quantity)
    assert row["n_runs"] == 400
    assert row["refused"] == 0
    # 400 runs: 1 / sqrt(800) of the root mean square and sqrt(p (1 - p) / 400), four times each.
    assert row["rms_normalised"] == pytest.approx(1.0, abs=0.14)
    for level in LEVELS:
        name = f"coverage_{100 * level:g}"
        assert row[name] == pytest.approx(level, abs=0.2 * np.sqrt(level * (1.0 - level)))
        assert row[f"{name}_low"] < row[name] < row[f"{name}_high"] or row[name] == 1.0


@pytest.mark.parametrize(("scale", "sign"), [(1.5, -1), (0.6, 1)])
@pytest.mark.parametrize("quantity", ["t_d", "R", "t"])
def test_wrong_deviations_are_found_out(scale, sign, quantity):
    row = cells(coverage_table(made_up_runs(scale=scale)), quantity)
    assert row["rms_normalised"] == pytest.approx(scale, rel=0.14)
    assert sign * (row["coverage_68"] - 0.68) > 0.1
    bound = row["coverage_95_low" if sign > 0 else "coverage_95_high"]
    assert sign * (bound - 0.95) > 0.0


def test_angles_are_told_apart_and_a_known_pose_has_no_region():
    table = coverage_table(made_up_runs(100))
    assert set(table["angle_deg"]) == {"all", "30", "90"}
    assert cells(table, "t_d", angle="30")["n_runs"] == 50
    of_known = table[table["method"] == "joint-known"]
    assert set(of_known["quantity"]) == OF_CLOCKS


def test_a_refused_run_is_counted_and_covers_nothing():
    runs = made_up_runs(100)
    out = runs["method"].eq("joint") & runs["flight"].lt(1005)
    runs.loc[out, "status"] = "degenerate_pose"
    runs.loc[out, "t_d_estimate_ms"] = 0.0  # far from the truth
    before, after = (cells(coverage_table(table), "t_d") for table in (made_up_runs(100), runs))
    assert (after["n_runs"], after["refused"]) == (100, 10)
    inside = np.round(100 * before["coverage_99"]), np.round(90 * after["coverage_99"])
    assert inside[0] - 10 <= inside[1] <= inside[0]


def test_bounds_are_clopper_and_pearsons():
    # Their closed forms at the ends: (1 - share)^n = 0.025, and the mirror of it for all inside.
    assert sampling_bounds(0, 20) == pytest.approx((0.0, 1.0 - 0.025 ** (1 / 20)))
    assert sampling_bounds(20, 20) == pytest.approx((0.025 ** (1 / 20), 1.0))
    low, high = sampling_bounds(475, 500)
    assert (low, high) == pytest.approx((0.927, 0.967), abs=0.001)  # their table


def test_the_levels_of_one_two_and_three_parameters():
    assert confidence(np.array([1.96, -1.96]), 1) == pytest.approx(0.95, abs=1e-4)
    assert confidence(np.array([2.4477]), 2) == pytest.approx(0.95, abs=1e-4)
    assert confidence(np.array([2.7955]), 3) == pytest.approx(0.95, abs=1e-4)
