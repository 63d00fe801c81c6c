import numpy as np
import pandas as pd
import pytest

from experiments.lab.files import csv_text
from experiments.paper.comparison import load_published
from experiments.paper.esim import (
    YOUNGER,
    esim_table,
    esim_tables,
    method_order,
    missing_runs,
    ordered_runs,
    pose_methods,
    runs_from_csv,
)
from ssac.errors import SsacError
from ssac.pipeline.registry import METHODS
from tests.experiments.reported import made_up_runs


@pytest.fixture(scope="module")
def runs() -> pd.DataFrame:
    return made_up_runs()


def place(
    runs: pd.DataFrame, method: str, duration_s: float = 10.0, angle_deg: float = 60.0,
    t_d_ms: float = 50.0,
) -> pd.Series:  # fmt: skip
    """Which rows are the runs of a method in one cell of a table."""
    return (
        (runs["duration_s"] == duration_s)
        & (runs["angle_deg"] == angle_deg)
        & (runs["t_d_ms"] == t_d_ms)
        & (runs["method"] == method)
    )


def cell(table: pd.DataFrame, angle_deg: float = 60.0, t_d_ms: float = 50.0) -> pd.Series:
    return table[(table["angle_deg"] == angle_deg) & (table["t_d_ms"] == t_d_ms)].iloc[0]


def failing(runs: pd.DataFrame, rows: pd.Series) -> pd.DataFrame:
    """Return the runs with some of them failed."""
    runs = runs.copy()
    runs.loc[rows, "status"] = "search_bound"
    return runs


def test_the_order_of_the_rows_of_runs_changes_no_byte(runs):
    shuffled = runs.sample(frac=1.0, random_state=1)
    assert csv_text(ordered_runs(shuffled)) == csv_text(ordered_runs(runs))
    for duration_s, table in esim_tables(runs).items():
        assert csv_text(esim_table(shuffled, duration_s)) == csv_text(table)


def test_rows_are_in_the_order_of_the_paper(runs):
    for duration_s, published in load_published().items():
        ours = esim_table(runs, duration_s)
        pd.testing.assert_frame_equal(
            ours[["angle_deg", "t_d_ms"]], published[["angle_deg", "t_d_ms"]], check_dtype=False
        )


def test_means_and_deviations_are_over_the_flights(runs):
    errors = runs.loc[place(runs, "ssac"), "r_error_deg"].to_numpy()
    row = cell(esim_table(runs, 10.0))
    assert row["ssac_r_error_deg_mean"] == pytest.approx(np.mean(errors))
    # Over n, not n - 1.
    assert row["ssac_r_error_deg_std"] == pytest.approx(
        np.sqrt(np.mean(errors**2 - errors.mean() ** 2))
    )
    assert row["n_runs"] == len(errors) == 10


def test_columns_are_those_of_the_methods_in_order(runs):
    expected = ["angle_deg", "t_d_ms", "n_runs"]
    for name in METHODS:
        if name not in set(runs["method"]):
            continue
        errors = ["t_d_error_ms"]
        if name in ("ssac", "joint", "tangency", "albl"):
            errors += ["r_error_deg", "t_error_deg"]
        expected += [f"{name}_{error}_{part}" for error in errors for part in ("mean", "std")]
        expected.append(f"{name}_failed")
    assert list(esim_table(runs, 20.0).columns) == expected


def test_a_method_that_gives_a_pose_at_one_duration_has_its_columns_at_all(runs):
    runs = failing(runs, (runs["method"] == "joint") & (runs["duration_s"] == 10.0))
    poses = ["r_error_deg", "t_error_deg"]
    runs.loc[runs["status"] != "ok", poses] = np.nan
    table = esim_table(runs, 10.0)
    assert table["joint_r_error_deg_mean"].isna().all()
    assert (table["joint_failed"] == 10).all()


def test_methods_of_other_packages_come_last_by_name():
    assert method_order(["zzz", "zncc_e", "aaa", "joint", "zzz"]) == [
        "joint",
        "zncc_e",
        "aaa",
        "zzz",
    ]


def test_a_failed_run_does_not_enter_the_means_but_is_counted(runs):
    which = place(runs, "ssac") & (runs["flight"] == 3)
    assert which.sum() == 1
    before, after = (cell(esim_table(table, 10.0)) for table in (runs, failing(runs, which)))
    left = runs.loc[place(runs, "ssac") & (runs["flight"] != 3), "t_d_error_ms"]
    assert len(left) == 9
    assert after["ssac_t_d_error_ms_mean"] == pytest.approx(left.mean())
    assert (before["ssac_failed"], after["ssac_failed"]) == (0, 1)
    assert before["n_runs"] == after["n_runs"] == 10
    others = [name for name in before.index if not name.startswith("ssac_")]
    pd.testing.assert_series_equal(before[others], after[others])


@pytest.mark.parametrize("status", ["search_bound", "too_few_samples", "skipped", "crashed"])
def test_where_no_run_is_ok_the_means_are_empty_cells(runs, status):
    runs = runs.copy()
    runs.loc[place(runs, "zncc_e"), "status"] = status
    table = esim_table(runs, 10.0)
    row = cell(table)
    assert row["zncc_e_failed"] == 10
    assert np.isnan(row["zncc_e_t_d_error_ms_mean"])
    (line,) = (line for line in csv_text(table).splitlines() if line.startswith("60,50,10,"))
    cells = dict(zip(table.columns, line.split(","), strict=True))
    assert cells["zncc_e_t_d_error_ms_mean"] == cells["zncc_e_t_d_error_ms_std"] == ""


def one_run(runs: pd.DataFrame, method: str = "joint") -> pd.Series:
    return place(runs, method) & (runs["flight"] == 7)


def without_cell(runs: pd.DataFrame) -> pd.DataFrame:
    in_cell = (runs["angle_deg"] == 60.0) & (runs["t_d_ms"] == 50.0) & (runs["duration_s"] == 10.0)
    return runs[~in_cell]


def without_error(runs: pd.DataFrame) -> pd.DataFrame:
    return runs.assign(t_d_error_ms=runs["t_d_error_ms"].mask(one_run(runs, "ssac")))


@pytest.mark.parametrize(
    ("spoilt", "read", "match"),
    [
        (lambda r: r[~one_run(r)], ordered_runs, "10 s, 60 deg, t_d 50 ms, flight 7, joint$"),
        (
            lambda r: r[~one_run(r)],
            esim_tables,
            "missing: 10 s, 60 deg, t_d 50 ms, flight 7, joint$",
        ),
        (without_cell, ordered_runs, "and 95 more"),  # 10 flights, 10 methods, 5 shown
        (
            lambda r: pd.concat([r, r[one_run(r)]]),
            ordered_runs,
            "more than once: 10 s, 60 deg, t_d",
        ),
        (without_error, esim_tables, '"ok" without an error of t_d: .* flight 7, ssac'),
        (lambda r: r.drop(columns="status"), ordered_runs, r"not there: \['status'\]"),
        (lambda r: r.iloc[:0], ordered_runs, "got none"),
        (
            lambda r: r,
            lambda r: esim_table(r, 30.0),
            "no run has a duration of 30 s: there are 10, 20",
        ),
        (lambda _: "", runs_from_csv, "not a table of runs"),
        (lambda _: "a,b\n1,2\n", runs_from_csv, r"not there: \['duration_s'"),
        (
            lambda r: csv_text(r).replace("10,30,5,0,", "ten,30,5,0,"),
            runs_from_csv,
            "not a table of",
        ),
    ],
)
def test_bad_tables_are_refused(runs, spoilt, read, match):
    with pytest.raises(SsacError, match=match):
        read(spoilt(runs))
    assert len(missing_runs(runs[~one_run(runs)])) == 1
    assert missing_runs(runs).empty


def test_runs_of_before_a_column_was_there_can_be_read(runs):
    old = runs.drop(columns=list(YOUNGER))
    read = runs_from_csv(csv_text(old))
    assert read[list(YOUNGER)].isna().all(axis=None)
    assert csv_text(ordered_runs(read)) == csv_text(ordered_runs(old)) == csv_text(runs)


def test_runs_survive_being_written_and_read(runs):
    runs = runs.copy()
    runs.loc[0, ["status", "reason"]] = "crashed", 'a "quoted", reason: nan'
    text = csv_text(ordered_runs(runs))
    read = runs_from_csv(text)
    assert csv_text(ordered_runs(read)) == text
    assert read.loc[0, "reason"] == 'a "quoted", reason: nan'
    assert (read.loc[runs["status"] == "ok", "reason"] == "").all()
    # Six significant digits; counts whole.
    np.testing.assert_allclose(read["t_d_error_ms"], runs["t_d_error_ms"], rtol=5e-6)
    assert (read["n_events_cam2"] == runs["n_events_cam2"]).all()


def test_counts_are_not_rounded(runs):
    assert ",1242193," in csv_text(ordered_runs(runs.assign(n_events_cam1=1242193.0)))


def test_poses_tell_who_gives_one(runs):
    assert pose_methods(runs) == ["ssac", "joint", "tangency", "albl"]
