"""The paper's tables, made of runs: in the paper's order, with failed runs counted."""

from collections.abc import Sequence

import numpy as np
import pandas as pd
import pytest

from experiments.lab.results import csv_text, read_table
from experiments.paper.comparison import load_published
from experiments.paper.esim import esim_table, esim_tables, method_order, ordered_runs, pose_methods
from ssac.pipeline.registry import METHODS
from tests.experiments.reported import made_up_runs

RUNS = made_up_runs()


def place(method: str, flights: Sequence[int] = tuple(range(10))) -> pd.Series:
    of = {"duration_s": 10.0, "angle_deg": 60.0, "t_d_ms": 50.0, "method": method}
    return (RUNS[list(of)] == pd.Series(of)).all(axis=1) & RUNS["flight"].isin(flights)


def with_status(rows: pd.Series) -> pd.DataFrame:
    return RUNS.assign(status=RUNS["status"].mask(rows, "search_bound"))


def test_rows_are_in_the_order_of_the_paper_whatever_the_order_of_the_runs():
    shuffled = RUNS.sample(frac=1.0, random_state=1)
    assert csv_text(ordered_runs(shuffled)) == csv_text(ordered_runs(RUNS))
    tables, places = esim_tables(RUNS), ["angle_deg", "t_d_ms"]
    for duration_s, published in load_published().items():
        table = tables[duration_s]
        assert csv_text(esim_table(shuffled, duration_s)) == csv_text(table)
        pd.testing.assert_frame_equal(table[places], published[places], check_dtype=False)


def test_columns_are_those_of_the_methods_in_order():
    expected = ["angle_deg", "t_d_ms", "n_runs"]
    posed = ["ssac", "joint", "tangency", "albl"]
    for name in [name for name in METHODS if name in set(RUNS["method"])]:
        errors = ["t_d_error_ms", *(["r_error_deg", "t_error_deg"] if name in posed else [])]
        expected += [f"{name}_{error}_{part}" for error in errors for part in ("mean", "std")]
        expected.append(f"{name}_failed")
    assert list(esim_table(RUNS, 20.0).columns) == expected
    assert pose_methods(RUNS) == posed
    # A method that gives a pose at one duration has columns of the pose at all durations.
    lost = (RUNS["method"] == "joint") & (RUNS["duration_s"] == 10.0)
    runs = with_status(lost)
    runs.loc[lost, ["r_error_deg", "t_error_deg"]] = np.nan
    table = esim_table(runs, 10.0)
    assert table["joint_r_error_deg_mean"].isna().all()
    assert (table["joint_failed"] == 10).all()
    # Methods of other packages come last, by name.
    ordered = method_order(["zzz", "zncc_e", "aaa", "joint", "zzz"])
    assert ordered == ["joint", "zncc_e", "aaa", "zzz"]


def test_means_and_deviations_are_over_the_flights_without_a_failed_run_which_is_counted():
    runs = with_status(place("ssac", [3]))
    tables = (esim_table(one, 10.0).set_index(["angle_deg", "t_d_ms"]) for one in (RUNS, runs))
    before, after = (table.loc[60.0, 50.0] for table in tables)
    for row, flights in ((before, range(10)), (after, [0, 1, 2, *range(4, 10)])):
        for error in ("t_d_error_ms", "r_error_deg", "t_error_deg"):
            values = RUNS.loc[place("ssac", flights), error].to_numpy()
            assert len(values) == len(flights)
            assert row[f"ssac_{error}_mean"] == pytest.approx(np.mean(values))
            # The deviation is over n, not n - 1.
            assert row[f"ssac_{error}_std"] == pytest.approx(np.std(values, ddof=0))
    assert (before["ssac_failed"], after["ssac_failed"]) == (0, 1)
    assert before["n_runs"] == after["n_runs"] == 10
    others = [name for name in before.index if not name.startswith("ssac_")]
    pd.testing.assert_series_equal(before[others], after[others])


def test_runs_survive_being_written_and_read():
    runs = RUNS.copy()
    runs.loc[0, ["status", "reason"]] = "crashed", 'a "quoted", reason: nan'
    runs.loc[0, "n_events_cam1"] = 1242193
    text = csv_text(ordered_runs(runs))
    assert ",1242193," in text  # counts are written with all digits
    read = read_table(text)
    assert csv_text(ordered_runs(read)) == text
    assert read.loc[0, "reason"] == 'a "quoted", reason: nan'
    assert read.loc[runs["status"] == "ok", "reason"].isna().all()
    np.testing.assert_allclose(read["t_d_error_ms"], runs["t_d_error_ms"], rtol=5e-6)  # six digits
    assert (read["n_events_cam2"] == runs["n_events_cam2"]).all()
