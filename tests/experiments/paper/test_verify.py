import json
from collections.abc import Callable
from pathlib import Path
from shutil import copytree

import numpy as np
import pandas as pd
import pytest
import typer
from typer.testing import CliRunner

from experiments.paper import verify as check
from experiments.paper import verify_files as check_files
from experiments.paper.comparison import PUBLISHED
from experiments.paper.esim import csv_text, runs_from_csv
from experiments.paper.results import save_results
from experiments.paper.verify import part_cells, run_findings, tolerances, verify_command
from experiments.paper.verify_files import (
    Finding,
    ablation_findings,
    file_findings,
    sanity_findings,
    text_difference,
)
from experiments.run.grid import named_config
from experiments.run.schedule import Outcome
from ssac.errors import SsacError
from ssac.tool.registry import METHODS, OURS
from tests.experiments.reported import made_up_runs

NAMES = tuple(method.name for method in OURS)
PROVENANCE = {"command": "ssac tables", "commit": "0123456789ab", "wall_time_s": 1.0}

app = typer.Typer()
app.command()(verify_command)


@pytest.fixture(scope="module")
def committed(tmp_path_factory) -> Path:
    """Results as `make tables` leaves them, with made-up numbers."""
    folder = tmp_path_factory.mktemp("committed")
    runs = made_up_runs(NAMES)
    runs["t_d_error_ms"] = runs["t_d_error_ms"].clip(upper=900.0)  # within the search
    runs["t_d_estimate_ms"] = runs["t_d_ms"] + runs["t_d_error_ms"]
    save_results(runs, folder, PROVENANCE)
    for name in ("runs", "comparison", "esim_10", "esim_20"):
        (folder / f"{name}.provenance.json").write_text(json.dumps(PROVENANCE))
    return folder


@pytest.fixture
def results(committed, tmp_path) -> Path:
    return Path(copytree(committed, tmp_path / "results"))


@pytest.fixture
def runs(committed) -> pd.DataFrame:
    return runs_from_csv((committed / "runs.csv").read_text())


def faulty(findings: list[Finding]) -> list[Finding]:
    return [finding for finding in findings if finding.faults]


def change(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))


def part_of(runs: pd.DataFrame) -> pd.DataFrame:
    """Return what a run of `part_cells` gives when nothing changed, with the columns of a grid."""
    chosen = runs[
        (runs["duration_s"] == 10.0) & runs["angle_deg"].isin([30.0, 150.0]) & (runs["flight"] == 0)
    ]
    names = {"duration_s": "sim.spline.duration_s", "angle_deg": "sim.angle_deg"}
    rows = chosen.rename(columns=names).reset_index(drop=True)
    return rows.assign(**{"sim.t_d_s": rows["t_d_ms"] / 1e3})


# --- Files ---


def test_good_results_have_no_fault(results):
    findings = file_findings(results)
    assert faulty(findings) == []
    assert len(findings) > 12


@pytest.mark.parametrize("name", ["esim_10.csv", "esim_20.csv", "comparison.csv", "README.md"])
def test_a_changed_file_is_found(results, name):
    text = (results / name).read_text()
    last = max(n for n, char in enumerate(text) if char in "123456789")
    (results / name).write_text(text[:last] + "0" + text[last + 1 :])
    (found,) = faulty(file_findings(results))
    assert found.what == f"{name} follows from runs.csv"


def test_a_changed_run_is_found_in_the_tables(results):
    path = results / "runs.csv"
    runs = runs_from_csv(path.read_text())
    row = (runs["method"] == "ssac") & (runs["flight"] == 4) & (runs["duration_s"] == 20.0)
    runs.loc[row, "r_error_deg"] += 0.01
    path.write_text(csv_text(runs))
    found = {finding.what for finding in faulty(file_findings(results))}
    names = ("esim_20.csv", "comparison.csv", "README.md")
    assert found == {f"{name} follows from runs.csv" for name in names}


LAST = f"20 s, 150 deg, t_d 500 ms, flight 9, {NAMES[-1]}"


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
    first = faulty(file_findings(results))[0]
    assert first.what == "runs.csv has every run of esim_10 and esim_20"
    assert first.faults[0] == fault


@pytest.mark.parametrize("commit", ["0123456789ab-dirty", "unknown"])
def test_results_of_uncommitted_code_are_found(results, commit):
    (results / "esim_10.provenance.json").write_text(json.dumps({**PROVENANCE, "commit": commit}))
    (found,) = faulty(file_findings(results))
    assert found.what == "esim_10.csv was made at a clean commit"


def test_a_changed_published_number_is_found(results, tmp_path, monkeypatch):
    published = Path(copytree(PUBLISHED, tmp_path / "published"))
    monkeypatch.setattr(check_files, "PUBLISHED", published)
    assert faulty(file_findings(results)) == []
    change(published / "esim_20.csv", "0.13", "0.14")
    (found,) = faulty(file_findings(results))
    assert found.what == "published/esim_20.csv is the paper's table"


@pytest.mark.parametrize(
    "name", ["runs.csv", "esim_20.csv", "comparison.csv", "README.md", "runs.provenance.json"]
)
def test_a_missing_file_is_no_verdict_but_an_error(results, name):
    (results / name).unlink()
    with pytest.raises(SsacError, match=f"{name} cannot be read, `make tables` writes it"):
        file_findings(results)


@pytest.mark.parametrize("text", ["[1]", "{", ""])
def test_an_unreadable_provenance_is_an_error(results, text):
    (results / "runs.provenance.json").write_text(text)
    with pytest.raises(SsacError, match=r"runs\.provenance\.json (is no JSON|holds no provenance)"):
        file_findings(results)


def test_text_difference_names_the_line():
    assert text_difference("a\nb\n", "a\nb\n") == ()
    assert text_difference("a\nb\n", "a\nc\n") == ("line 2 is b", "line 2 should be c")
    assert text_difference("a\n", "a\nc\n") == ("line 2 is nothing", "line 2 should be c")
    assert text_difference("a\r\n", "a\n") == ("the ends of lines are not the same",)
    assert len(text_difference("x" * 1000, "")[0]) < 200


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


# --- Ablations ---


def window_ablation(runs: pd.DataFrame) -> pd.DataFrame:
    """Make the ablation of the half-window; where it is the default the means are the tables'."""
    table = runs[(runs["duration_s"] == 20.0) & (runs["t_d_ms"] == 50.0)]
    means = table[table["status"] == "ok"].groupby(["angle_deg", "method"])["t_d_error_ms"].mean()
    grid = named_config("ablation_window")
    points = dict.fromkeys(
        (cell.sim.angle_deg, cell.estimator.half_window_s, cell.method) for cell in grid.cells()
    )
    return pd.DataFrame(
        [
            {
                "sim.angle_deg": angle_deg,
                "ssac.half_window_s": half_window_s,
                "method": method,
                "t_d_error_ms_mean": means[angle_deg, method] if half_window_s == 0.02 else 7.0,
            }
            for angle_deg, half_window_s, method in points
        ]
    )


def table_cells() -> list:
    return [cell for name in ("esim_10", "esim_20") for cell in named_config(name).cells()]


def test_an_ablation_that_fits_the_tables_has_no_fault(runs, tmp_path):
    assert ablation_findings(tmp_path, runs, table_cells()) == []
    (tmp_path / "ablation_window.csv").write_text(csv_text(window_ablation(runs)))
    (finding,) = ablation_findings(tmp_path, runs, table_cells())
    assert finding.faults == ()
    n_points = len(named_config("ablation_window").methods) * 3  # at the default, by angle
    assert finding.what.endswith(f": {n_points} points")


def test_an_ablation_of_another_code_than_the_tables_is_found(runs, tmp_path):
    ablation = window_ablation(runs)
    default = ablation["ssac.half_window_s"] == 0.02
    ablation.loc[default.idxmax(), "t_d_error_ms_mean"] *= 1.001
    (tmp_path / "ablation_window.csv").write_text(csv_text(ablation))
    (finding,) = ablation_findings(tmp_path, runs, table_cells())
    assert len(finding.faults) == 1
    (tmp_path / "ablation_window.csv").write_text(csv_text(ablation[~default]))
    (finding,) = ablation_findings(tmp_path, runs, table_cells())
    assert len(finding.faults) == default.sum()
    (tmp_path / "ablation_window.csv").write_text(csv_text(ablation.drop(columns="method")))
    with pytest.raises(SsacError, match=r"ablation_window\.csv lacks the columns method"):
        ablation_findings(tmp_path, runs, table_cells())


# --- Runs again ---


def test_the_part_is_small_and_has_every_method_of_ours():
    cells = part_cells()
    assert {cell.method for cell in cells} == set(NAMES)
    assert len({(cell.sim, cell.seed) for cell in cells}) == 2  # recordings
    assert {cell.t_d_s for cell in cells} == {0.005, 0.05, 0.5}
    assert {cell.sim.spline.duration_s for cell in cells} == {10.0}
    assert len(cells) == 2 * 3 * len(NAMES)


def test_the_same_runs_have_no_fault(runs):
    part = check.runs_of_grid(part_of(runs))
    findings = run_findings(part, runs)
    assert faulty(findings) == []
    assert {finding.what.partition(":")[0] for finding in findings} == set(NAMES)


@pytest.mark.parametrize("method", NAMES)
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_a_run_outside_its_tolerance_is_found_and_one_inside_is_not(runs, method, sign):
    part = check.runs_of_grid(part_of(runs))
    row = part.index[(part["method"] == method) & (part["status"] == "ok")][1]
    for column, tolerance in tolerances(method).items():
        if np.isnan(part.loc[row, column]):
            continue
        # 0.9 and 1.1: six digits of 500.123 ms round by 1 % of the smallest tolerance.
        for factor, n_faults in ((0.9, 0), (1.1, 1)):
            moved = part.copy()
            moved.loc[row, column] += sign * factor * tolerance
            found = faulty(run_findings(moved, runs))
            assert len(found) == n_faults
            assert all(f"{method}: {column}: largest" in finding.what for finding in found)


def test_tolerances_are_far_below_what_they_guard():
    """Half a percent of the search interval, or a pose error that no table would show."""
    for name in NAMES:
        for column, tolerance in tolerances(name).items():
            assert 0.0 < tolerance <= (20.0 if column == "t_d_estimate_ms" else 0.1)
            assert "zncc" in name or name == "event_rate" or tolerance <= 0.1


def edited(runs: pd.DataFrame, **values: object) -> pd.DataFrame:
    """Return the runs with one run of ssac, which is run again, changed."""
    runs = runs.copy()
    row = runs.index[(runs["method"] == "ssac") & (runs["angle_deg"] == 150.0)][0]
    for name, value in values.items():
        runs.loc[row, name] = value
    return runs


CRASH = {"status": "crashed", "reason": "ssac: KeyError: 1", "t_d_estimate_ms": np.nan,
         "t_d_error_ms": np.nan, "r_error_deg": np.nan, "t_error_deg": np.nan}  # fmt: skip


@pytest.mark.parametrize(
    "committed_edit",
    [
        lambda runs: edited(runs, **CRASH),
        lambda runs: runs.drop(runs.index[edited(runs, flight=-1)["flight"] == -1]),
        lambda runs: edited(runs, status="search_bound"),
        lambda runs: edited(runs, r_error_deg=np.nan),
    ],
    ids=["crashed", "missing", "failed", "no pose"],
)
def test_a_committed_run_that_is_not_what_it_was_is_found(
    runs, committed_edit: Callable[[pd.DataFrame], pd.DataFrame]
):
    part = check.runs_of_grid(part_of(runs))
    found = faulty(run_findings(part, committed_edit(runs)))
    assert found
    assert all(finding.what.startswith("ssac: ") for finding in found)


def test_a_run_that_crashes_again_is_found_even_if_it_is_committed_so(runs):
    crashed = edited(runs, **CRASH)
    found = faulty(run_findings(check.runs_of_grid(part_of(crashed)), crashed))
    assert [finding.what for finding in found] == ["ssac: status of 6 runs"]
    assert "KeyError" in found[0].faults[0]


# --- The command ---


def verify(results: Path, *options: str) -> tuple[int, str]:
    arguments = ["--results", str(results), *options]
    result = CliRunner().invoke(app, arguments, catch_exceptions=False)
    return result.exit_code, result.output


def test_exit_codes_of_the_files(results):
    code, output = verify(results, "--no-recompute")
    assert code == 0
    assert output.endswith("all of it as committed\n")
    change(results / "esim_10.csv", "30,5,10,", "30,5,11,")
    code, output = verify(results, "--no-recompute")
    assert code == 1
    assert "differs esim_10.csv follows from runs.csv\n        - line 2 is 30,5,11," in output
    assert output.endswith("1 of the checks above differ\n")
    (results / "runs.csv").unlink()
    with pytest.raises(SsacError, match="cannot be read"):  # which `main` turns into exit code 2
        verify(results, "--no-recompute")


def test_a_small_part_is_run_from_nothing(results, runs, monkeypatch):
    folders = []

    def run_again(cells, cache, workers, label):
        assert cells == part_cells()
        assert list(cache.folder.iterdir()) == []  # nothing of an earlier run
        assert Path("cache").resolve() not in (cache.folder, *cache.folder.parents)
        folders.append(cache.folder)
        return Outcome(again, 2, 2, 0.0)

    monkeypatch.setattr(check, "run_cells", run_again)
    again = part_of(runs)
    code, output = verify(results)
    assert code == 0
    assert "ssac: t_d_estimate_ms: largest difference 0, tolerated 0.06\n" in output
    again.loc[again["method"] == "ssac", "t_d_estimate_ms"] += 0.5
    code, output = verify(results)
    assert code == 1
    assert "differs ssac: t_d_estimate_ms: largest difference 0.5, tolerated 0.06" in output
    assert len(folders) == 2
    assert not any(folder.exists() for folder in folders)


def test_only_the_first_faults_are_listed():
    lines = list(Finding("something", tuple("abcdefgh")).lines())
    assert lines[0] == "differs something"
    assert lines[-1].strip() == "- and 3 more"
    assert len(lines) == 1 + 5 + 1
    assert list(Finding("something").lines()) == ["ok      something"]


def test_the_registry_has_a_tolerance_for_every_method_of_ours():
    assert all(tolerances(name) for name in NAMES)
    assert set(NAMES) <= set(METHODS)
