"""Recordings drawn at random, whose repeated runs are compared with the committed ones."""

from dataclasses import replace
from functools import partial
from pathlib import Path

import pandas as pd
import pytest

from experiments import commands
from experiments.lab import again, schedule
from experiments.lab.again import draw, sources_of
from experiments.lab.results import Results
from experiments.lab.schedule import Workers
from experiments.lab.study import Runs
from experiments.studies import all_studies
from ssac.errors import SsacError
from ssac.pipeline.registry import OURS
from tests.experiments.command import run
from tests.experiments.lab.squares import SQUARES, change_a_status, double_a_number


def names(drawn):
    return [(study.name, task[0].recordings) for study, task in drawn]


def test_what_is_drawn():
    sources = sources_of(all_studies())[:4]
    assert names(draw(sources, 6, 7)) == names(draw(sources, 6, 7))
    assert len({name for seed in range(3) for name in names(draw(sources, 6, seed))}) > 12
    everything = names(draw([*sources[:1], SQUARES], 1000, 0))
    assert len(everything) == len(set(everything)) == 2 * 5 * 30 + 1
    assert {name for name, _ in everything} == {"tables", "squares"}
    drawn = [name for name, _ in names(draw(sources, 40, 1))]
    assert drawn[::2] == ["tables"] * 20
    assert "tables" not in drawn[1::2]
    ((_, one),) = draw(sources, 1, 0)
    assert {cell.method for cell in one} == {method.name for method in OURS}
    assert {cell.t_d_s for cell in one} == {0.005, 0.05, 0.5}


def test_slow_studies_are_drawn_from_only_if_asked_for():
    studies = all_studies()
    slow = {study.name for study in studies.values() if not study.again}
    assert "fidelity" in slow
    assert not slow & {study.name for study in sources_of(studies)}
    assert [one.name for one in sources_of(studies, only="fidelity")] == ["fidelity"]
    assert draw(sources_of(studies, only="renderers"), 9, 0) == []  # OpenGL drivers render unlike
    with pytest.raises(SsacError, match="--only: expected a study of squares, got cubes"):
        sources_of({"squares": SQUARES}, only="cubes")


@pytest.mark.parametrize(
    ("damage", "fault"),
    [
        (str, None),
        (double_a_number, "cell 5: square is 49, committed: 98. "),
        (change_a_status, "cell 5: status is ok, committed: no_match. "),
        (None, "SsacError: "),
    ],
)
def test_runs_from_nothing_are_as_committed_and_a_damage_is_found(
    results, tmp_path, monkeypatch, damage, fault
):
    monkeypatch.setattr(schedule, "run_key", lambda recordings, inputs, code: f"square{inputs}")
    text, there = (results / "squares_runs.csv").read_text(), tmp_path / "none"
    committed = Results(there, {"squares_runs.csv": damage(text)} if damage else {})
    (finding,) = again.recomputed(draw([SQUARES], 1, 0), committed, tmp_path, Workers(1))
    assert finding.what.startswith("squares_runs.csv: 6 runs on the recording of number 2")
    assert len(finding.faults) == (fault is not None)
    assert "".join(finding.faults).startswith(fault or "")


def row(**changes):
    values = {"flight": "3", "method": "joint", "status": "ok", "reason": "",
              "t_d_estimate_ms": "50.0123", "t_d_error_ms": "0.0123", "r_error_deg": "0.0512345",
              "t_error_deg": "0.04", "t_d_std_ms": "0.06", "r_z_normalised": "-1.00001",
              "n_samples": "350", "n_events_cam1": "1234567", "d_avg_px": "0.186781"}  # fmt: skip
    return pd.DataFrame([values | changes])


RUNS = Runs("runs.csv", ("flight", "method"), numbered=False)
TABLES = replace(all_studies()["tables"], runs=RUNS)
WORDS = "23 sample times are valid at 0.055 s, 33 % beyond, 5 deg apart: 30 are needed"


def faults(mine, committed):
    theirs = Results(Path(), {"runs.csv": committed.to_csv(index=False)})
    return again.row_faults(mine, TABLES, theirs)


@pytest.mark.parametrize(
    ("method", "name", "mine", "committed", "is_same"),
    [
        ("joint", "status", "ok", "search_bound", False),
        ("joint", "n_events_cam1", "1234567", "1234568", False),
        ("joint", "t_d_estimate_ms", "50.0123", "50.0125", False),
        ("joint", "r_error_deg", "0.0512345", "", False),
        ("joint", "n_samples", "350", "350.1", False),
        ("joint", "reason", "", "no reason", False),
        # Such differences occur on a processor without AVX-512.
        ("joint", "t_d_error_ms", "0.0658834", "0.0658835", True),
        ("joint", "t_d_estimate_ms", "999999", "1e+06", True),
        ("joint", "r_z_normalised", "-1.00001", "-1", True),
        # The error is the difference of two nearly equal numbers.
        ("joint", "t_d_error_ms", "2.84217e-14", "0", True),
        ("joint", "t_d_error_ms", "3.99794e-05", "3.99771e-05", True),
        ("joint", "n_events_cam1", "1234567", "1.23457e+06", True),  # a count that a table rounds
        # A method that follows a body may differ by a little more.
        ("tangency", "t_d_error_ms", "0.0658834", "0.0668834", True),
        ("tangency", "n_samples", "1201", "1200", True),
        ("tangency", "t_d_error_ms", "0.0658834", "0.265883", False),
        ("tangency", "n_samples", "1100", "1200", False),
        ("tangency", "n_events_cam1", "1234567", "1234568", False),
        ("tangency", "status", "ok", "search_bound", False),
        # A reason may differ in the last digit of a measured number, not in a count or a word.
        *(("joint", "reason", WORDS.replace(*change), WORDS, True)
          for change in (("0.055", "0.056"), ("33 %", "34 %"), ("5 deg", "4 deg"))),
        *(("joint", "reason", WORDS.replace(*change), WORDS, False)
          for change in (("0.055", "0.057"), ("33 %", "66 %"), ("5 deg", "10 deg"),
                         ("23 sample", "24 sample"), ("30 are", "31 are"), ("0.055", "-0.055"),
                         ("0.055", "0.06"), ("beyond", "within"))),
    ],
)  # fmt: skip
def test_every_number_counts_and_may_differ_by_rounding(method, name, mine, committed, is_same):
    assert mine != committed
    for one, other in ((mine, committed), (committed, mine)):
        found = faults(row(method=method, **{name: one}), row(method=method, **{name: other}))
        assert (found == []) == is_same
        assert all(f"{name} is " in fault for fault in found)
    assert 1000.0 * again.ROUNDING < 0.01  # the paper's tables print 0.01 ms and 0.01 deg


def test_no_number_may_be_doubled_halved_or_negated_and_no_column_or_run_gone():
    assert faults(row(), row()) == []
    for name, value in row().iloc[0].items():
        if name in again.measured_by(TABLES) or str(name).startswith("n_"):
            for factor in (2.0, 0.5, -1.0):
                other = f"{factor * float(value):.6g}"
                assert len(faults(row(), row(**{str(name): other}))) == 1, name
            (fault,) = faults(row(), row().drop(columns=name))
            assert f"{name} is {value}, committed: no column" in fault
            (fault,) = faults(row().drop(columns=name), row())
            assert f"{name} is no column, committed" in fault
    (fault,) = faults(row(), row(flight="4"))
    assert fault == "flight 3, method joint: no such run is committed"
    crash = row(status="crashed", reason="tangency: KeyError: 1")
    (fault,) = faults(crash, crash)
    assert "KeyError" in fault


def test_the_command_says_what_it_drew_and_fails_on_a_difference(results, monkeypatch):
    seen = []
    monkeypatch.setattr(commands, "all_studies", lambda: {"squares": SQUARES})
    monkeypatch.setattr(commands, "PUBLISHED_SHA256", {})
    monkeypatch.setattr(commands, "recomputed", lambda drawn, *_: seen.append(names(drawn)) or [])
    (results.parent / "README.md").write_text("<!--n:squares.sum-->29<!--/n-->")
    verify = partial(run, "verify", "--results", results, "--workers", 1)
    output = verify("--recordings", 3)
    assert output.endswith("all of it as committed\n")
    verify("--recordings", 3, "--sample-seed", output.partition("--sample-seed ")[2].split()[0])
    assert seen[0] == seen[1]
    assert "--recordings 300 --only squares\n" in verify("--recordings", 300, "--only", "squares")
    assert [name for name, _ in seen.pop()] == ["squares"]
    (results / "squares.csv").unlink()
    assert "        - squares.csv\n" in verify("--recordings", 0, exit_code=1)
    assert len(seen) == 2
