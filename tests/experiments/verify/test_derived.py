"""What follows from the runs: tables with runs too few or too many, and impossible runs."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from experiments.lab.files import csv_text, save_csv
from experiments.lab.finding import Finding, text_difference
from experiments.lab.grid import named_config
from experiments.paper.esim import runs_from_csv
from experiments.studies.fidelity import DIFFERENCES, RENDERER_TOLERANCE_MS, RENDERERS_STUDY
from experiments.studies.grids import ablation_study
from experiments.verify.derived import (
    renderer_findings,
    sanity_findings,
    study_findings,
    table_findings,
    table_key,
)
from tests.experiments.verify.conftest import N_FLIGHTS, NAMES

RESULTS = Path(__file__).resolve().parents[3] / "results"


@pytest.fixture
def runs(complete) -> pd.DataFrame:
    return runs_from_csv((complete / "runs.csv").read_text())


def faulty(findings: list[Finding]) -> list[Finding]:
    return [finding for finding in findings if finding.faults]


# --- Runs ---


LAST = f"20 s, 150 deg, t_d 500 ms, flight {N_FLIGHTS - 1}, {NAMES[-1]}"


@pytest.mark.parametrize(
    ("edit", "fault"),
    [
        (lambda lines: lines[:-1], f"{LAST} is missing"),
        (lambda lines: [*lines, lines[-1]], f"{LAST} is there twice"),
        (
            lambda lines: [*lines, lines[-1].replace("20,150,", "20,170,")],
            f"{LAST.replace('150', '170')} is in no grid",
        ),
        (
            lambda lines: [*lines, lines[-1].replace(f",{NAMES[-1]},", ",zzz,")],
            f"{LAST.replace(NAMES[-1], 'zzz')} is in no grid",
        ),
        (
            lambda lines: [line for line in lines if ",joint," not in line],
            "10 s, 30 deg, t_d 5 ms, flight 0, joint is missing",
        ),
    ],
    ids=["removed", "twice", "another angle", "unknown method", "removed method"],
)
def test_a_run_too_few_or_too_many_is_found(results, edit, fault):
    path = results / "runs.csv"
    path.write_text("\n".join(edit(path.read_text().splitlines())) + "\n")
    first = faulty(table_findings(results))[0]
    assert first.what == "runs.csv has every run of the tables"
    assert first.faults[0] == fault


def test_text_difference_names_the_line():
    assert text_difference("a\nb\n", "a\nb\n") == ()
    assert text_difference("a\nb\n", "a\nc\n") == ("line 2 is b", "line 2 should be c")
    assert text_difference("a\n", "a\nc\n") == ("line 2 is nothing", "line 2 should be c")
    assert text_difference("a\r\n", "a\n") == ("the ends of lines are not the same",)
    assert len(text_difference("x" * 1000, "")[0]) < 200


def test_only_the_first_faults_are_listed():
    lines = list(Finding("something", tuple("abcdefgh")).lines())
    assert lines[0] == "differs something"
    assert lines[-1].strip() == "- and 3 more"
    assert len(lines) == 1 + 5 + 1
    assert list(Finding("something").lines()) == ["ok      something"]


# --- Sanity ---


@pytest.mark.parametrize(
    ("column", "value", "what"),
    [
        ("status", "crashed", "no run crashed"),
        ("t_d_error_ms", 0.5, "errors are those of the estimates"),
        ("t_d_estimate_ms", np.nan, "errors are those of the estimates"),
        ("r_error_deg", 190.0, "errors are possible ones"),
        ("t_error_deg", -0.1, "errors are possible ones"),
        ("t_error_deg", np.nan, "a method gives a pose always or never"),
        ("n_events_cam2", 5, "all methods and offsets saw the same recording"),
    ],
)
def test_an_impossible_run_is_found(runs, column, value, what):
    assert faulty(sanity_findings(runs)) == []
    place = runs.index[(runs["method"] == "ssac") & (runs["status"] == "ok")][7]
    runs.loc[place, column] = value
    runs.loc[place, "reason"] = "made up"
    assert what in [finding.what for finding in faulty(sanity_findings(runs))]


def test_an_error_beyond_the_search_is_found(runs):
    place = runs.index[(runs["method"] == "zncc_e") & (runs["status"] == "ok")][0]
    runs.loc[place, "t_d_error_ms"] = 1500.0
    runs.loc[place, "t_d_estimate_ms"] = runs.loc[place, "t_d_ms"] - 1500.0
    (found,) = faulty(sanity_findings(runs))
    assert found.what == "errors are possible ones"


def test_a_failure_without_a_reason_is_found(runs):
    failed = runs.index[runs["status"] != "ok"]
    assert len(failed) > 0
    runs.loc[failed[0], "reason"] = ""
    (found,) = faulty(sanity_findings(runs))
    assert found.what == "every failed run has a reason"


def test_estimates_of_six_digits_are_equal_enough(runs):
    """An error of 912.345 ms at 500 ms is an estimate of 1412.35 ms in the CSV."""
    place = runs.index[(runs["method"] == "zncc_e") & (runs["t_d_ms"] == 500.0)][0]
    runs.loc[place, ["t_d_error_ms", "t_d_estimate_ms"]] = 912.345, 1412.345
    assert faulty(sanity_findings(runs_from_csv(csv_text(runs)))) == []


# --- Renderers ---


def test_renderers_that_differ_beyond_the_tolerance_are_found(tmp_path):
    near = dict.fromkeys(DIFFERENCES, 0.9 * RENDERER_TOLERANCE_MS)
    far = {**near, DIFFERENCES[-1]: 1.1 * RENDERER_TOLERANCE_MS}
    table = pd.DataFrame([{"duration_s": 10.0, **near}, {"duration_s": 20.0, **near}])
    studies = {RENDERERS_STUDY.name: RENDERERS_STUDY}
    assert renderer_findings(tmp_path, {}) == []
    assert faulty(renderer_findings(tmp_path, studies))  # not there
    save_csv(tmp_path / "renderers.csv", table)
    assert not faulty(renderer_findings(tmp_path, studies))
    save_csv(tmp_path / "renderers.csv", pd.DataFrame([{"duration_s": 10.0, **far}]))
    (found,) = faulty(renderer_findings(tmp_path, studies))
    assert found.faults == ("10 s: tangency_t_d_difference_ms is 0.0055",)


def test_the_committed_renderers_agree():
    assert not faulty(renderer_findings(RESULTS, {RENDERERS_STUDY.name: RENDERERS_STUDY}))


# --- Runs that a study shares with the tables ---


def test_a_run_that_is_not_the_tables_own_is_found(results, runs):
    study = ablation_study("angle")
    by_key = runs.set_index(["duration_s", "angle_deg", "t_d_ms", "flight", "method"])
    rows = []
    for number, cell in enumerate(named_config("ablation_angle").cells()):
        row = by_key.loc[table_key(cell)]
        rows.append({"cell": number, **cell.columns, **row.drop("seed")})
    path = results / study.runs_file
    table = pd.DataFrame(rows).astype(dict.fromkeys(("n_samples", "n_events_cam1"), int))
    save_csv(path, table.astype({"n_events_cam2": int}))
    what = f"{study.runs_file} has the rows of runs.csv where the runs are the same"
    assert what not in [one.what for one in faulty(study_findings(results, {"it": study}))]
    text = path.read_text()
    path.write_text(text.replace(",350,", ",351,", 1))
    (found,) = [one for one in study_findings(results, {"it": study}) if one.what == what]
    assert found.faults[0].endswith("n_samples is 351, there 350")
    # Fewer rows than the study has cells: a fault too, where it was a crash.
    path.write_text("".join(text.splitlines(keepends=True)[:5]))
    assert what in [one.what for one in faulty(study_findings(results, {"it": study}))]
