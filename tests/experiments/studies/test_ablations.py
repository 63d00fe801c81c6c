"""Ablations: what becomes of runs, one real one on a tiny grid, and tangency's variants."""

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

from experiments.cli import app
from experiments.lab.cache import Cache
from experiments.lab.files import SUMS_FILE
from experiments.lab.grid import grid_from_content
from experiments.lab.schedule import Workers
from experiments.lab.study import save_study
from experiments.studies.ablations import ABLATIONS, ablation_study, ablation_table
from experiments.studies.tangency import AS_IT_IS, VARIANTS, variant_means
from ssac.errors import SsacError
from ssac.methods.tangency import TangencyConfig

VARIED = ("sim.angle_deg", "sim.resolution")


def runs(**changes):
    """Two angles, two image sizes, two flights, one method."""
    rows = [
        {
            "sim.angle_deg": angle_deg,
            "sim.resolution": str(resolution),
            "flight": seed,
            "method": "ssac",
            "status": "ok",
            "reason": "",
            "t_d_error_ms": angle_deg + resolution[0] + seed,
            "r_error_deg": 0.5 + seed,
            "t_error_deg": np.nan,
            "n_samples": 300 + seed,
        }
        for angle_deg in (30, 90)
        for resolution in ([100, 50], [200, 100])
        for seed in (0, 2)
    ]
    return pd.DataFrame(rows).assign(**changes)


def test_each_point_is_a_row_with_the_means_of_its_flights():
    table = ablation_table(runs(), VARIED)
    assert list(table["sim.angle_deg"]) == [30, 30, 90, 90]
    assert list(table["sim.resolution"]) == ["[100, 50]", "[200, 100]"] * 2
    assert list(table["t_d_error_ms_mean"]) == [131, 231, 191, 291]
    assert (table["t_d_error_ms_std"] == 1.0).all()
    assert list(table["t_d_error_ms_median"]) == [131, 231, 191, 291]
    assert (table["r_error_deg_mean"] == 1.5).all()
    assert table["t_error_deg_mean"].isna().all()
    assert (table["n_runs"] == 2).all()
    assert (table["failed"] == 0).all()
    assert (table["n_samples_mean"] == 301).all()


def test_a_failed_run_is_counted_and_leaves_the_means():
    table = runs()
    table.loc[0, "status"] = "too_few_samples"
    table.loc[[2, 3], "status"] = "search_bound"
    means = ablation_table(table, VARIED)
    assert list(means["n_runs"]) == [2, 2, 2, 2]
    assert list(means["failed"]) == [1, 2, 0, 0]
    assert means["t_d_error_ms_mean"][0] == 132
    assert np.isnan(means["t_d_error_ms_mean"][1])


def test_the_order_of_flights_does_not_matter():
    shuffled = runs().sort_values("flight", kind="stable")
    pd.testing.assert_frame_equal(
        ablation_table(shuffled, VARIED).sort_values(list(VARIED), ignore_index=True),
        ablation_table(runs(), VARIED).sort_values(list(VARIED), ignore_index=True),
    )


def test_an_unknown_ablation_lists_the_known_ones():
    with pytest.raises(SsacError, match=r"unknown ablation 'windows': use one of .*window"):
        CliRunner().invoke(app, ["ablate", "windows"], catch_exceptions=False)
    assert {"window", "n_min", "samples", "contrast", "noise", "size", "speed"} <= set(ABLATIONS)


@pytest.mark.render
def test_a_real_ablation_leaves_csv_figure_and_provenance(tmp_path):
    content = {
        "flights": 1,
        "first_flight": 1,  # the first of these short ones moves too little
        "methods": ["ssac", "ssac-known"],
        "search_around_truth_s": [-0.1, 0.1],
        "fixed": {
            "sim": {
                "spline": {"duration_s": 3.0},
                "frames": {"rate_hz": 0.0},
                "render": {"lattice": {"a": 4}},
                "sampling": {"max_step_px": 0.5},
            },
            "ssac": {"trials": 200},
        },
        # No window holds a million events, so that value has nothing but failures.
        "grid": {"sim": {"angle_deg": [90]}, "ssac": {"n_min": [100, 200, 1000000]}},
        "figure": {"x": "ssac.n_min", "label": "events", "log": True},
    }
    grid = grid_from_content("ablation_tiny", content)
    study = ablation_study(grid)
    outcome, _ = save_study(study, tmp_path, Cache(tmp_path / "cache"), Workers(1))
    assert outcome.n_crashed == 0
    table = pd.read_csv(tmp_path / "ablation_tiny.csv")
    assert list(table["ssac.n_min"]) == [100, 100, 200, 200, 1000000, 1000000]
    assert list(table["failed"]) == [0, 0, 0, 0, 1, 1]
    # 3 s of a coarse flight: an estimate is within a few ms, or something is wrong.
    assert (table["t_d_error_ms_mean"].dropna() < 10.0).all()
    names = {path.name for path in tmp_path.iterdir()}
    assert names == {
        "ablation_tiny.csv", "ablation_tiny.png", "ablation_tiny.provenance.json", "cache",
        "ablation_tiny_runs.csv", "ablation_tiny_runs.provenance.json", SUMS_FILE,
    }  # fmt: skip


def variant_runs() -> pd.DataFrame:
    """Two angles, two variants; one run failed."""
    columns = ("variant", "angle_deg", "status", "t_d_error_ms", "normalised")
    rows = [
        (AS_IT_IS, 30.0, "ok", 0.1, 1.0),
        (AS_IT_IS, 30.0, "ok", 0.3, -1.0),
        (AS_IT_IS, 90.0, "ok", 0.5, 2.0),
        ("one pass", 30.0, "ok", 0.2, 3.0),
        ("one pass", 90.0, "no_convergence", np.nan, np.nan),
    ]
    table = pd.DataFrame(rows, columns=columns)
    return table.assign(r_error_deg=0.1, t_error_deg=0.05, t_d_bias_ms=0.01)


def test_means_are_of_runs_that_did_not_fail():
    means = variant_means(variant_runs()).set_index("variant")
    assert list(means.index) == [AS_IT_IS, "one pass"]
    assert means.loc[AS_IT_IS, "t_d_error_ms"] == pytest.approx(0.3)
    assert means.loc[AS_IT_IS, "t_d_error_ms_worst"] == pytest.approx(0.5)  # at 90 deg
    assert means.loc[AS_IT_IS, "normalised_rms"] == pytest.approx(np.sqrt(2.0))
    assert list(means["failed"]) == [0, 1]
    assert means.loc["one pass", "t_d_error_ms"] == pytest.approx(0.2)


def test_the_variants_differ_from_the_method_and_from_each_other():
    assert VARIANTS[AS_IT_IS] == TangencyConfig()
    assert len(set(VARIANTS.values())) == len(VARIANTS)
