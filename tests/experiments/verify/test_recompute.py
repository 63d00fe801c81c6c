"""Drawing recordings, and putting their runs made anew beside the committed ones."""

from pathlib import Path

import pandas as pd
import pytest
import typer
from typer.testing import CliRunner

from experiments.run import task
from experiments.run.schedule import Workers
from experiments.run.task import tasks_of
from experiments.studies.study import CELL
from experiments.verify import verify as command
from experiments.verify.finding import Finding
from experiments.verify.recompute import recomputed, row_faults, tolerances
from experiments.verify.sample import SLOW, TABLES, Drawn, Source, draw, sources_of
from ssac.errors import SsacError
from ssac.tool.registry import METHODS
from tests.experiments.verify.conftest import N_FLIGHTS, NAMES, SQUARES, STUDIES
from tests.experiments.verify.damage import double_a_number

SQUARES_SOURCE = Source("squares", SQUARES.runs_file, SQUARES.cells(), SQUARES.measure, (CELL,))


# --- Drawing ---


@pytest.fixture(scope="module")
def sources() -> list[Source]:
    return sources_of(STUDIES)


def names(drawn: list[Drawn]) -> list[tuple]:
    return [(one.source.name, one.task.recordings) for one in drawn]


def test_the_same_seed_draws_the_same_and_another_others(sources) -> None:
    assert names(draw(sources, 6, 7)) == names(draw(sources, 6, 7))
    seen = {place for seed in range(20) for place in names(draw(sources, 6, seed))}
    assert len(seen) > 30  # of 120 recordings: no fixed part


def test_every_recording_can_be_drawn_and_none_twice(sources) -> None:
    everything = names(draw(sources, 1000, 0))
    assert len(everything) == len(set(everything)) == 2 * 5 * N_FLIGHTS + 1
    assert {name for name, _ in everything} == {TABLES, "squares"}


def test_half_of_them_are_of_the_tables_and_slow_ones_are_left_out_unless_asked_for() -> None:
    from experiments.studies.catalogue import STUDIES as ALL

    drawn = [name for name, _ in names(draw(sources_of(ALL), 40, 1))]
    assert drawn[::2] == [TABLES] * 20
    assert TABLES not in drawn[1::2]
    assert not set(SLOW) & {source.name for source in sources_of(ALL)}
    assert set(SLOW) <= {source.name for source in sources_of(ALL, slow=True)}


def test_a_drawn_recording_of_the_tables_comes_with_every_method_and_offset(sources) -> None:
    one = draw(sources, 1, 0)[0]
    assert {cell.method for cell in one.task.cells} == set(NAMES)
    assert {cell.t_d_s for cell in one.task.cells} == {0.005, 0.05, 0.5}


# --- Running again ---


def test_runs_from_nothing_are_as_committed_and_a_doubled_number_is_found(
    results: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(task, "run_key", lambda recordings, inputs, code: f"square{inputs}")
    drawn = [Drawn(SQUARES_SOURCE, one) for one in tasks_of(SQUARES_SOURCE.cells)]

    def again(name: str) -> list[Finding]:
        (tmp_path / name).mkdir()
        return recomputed(drawn, results, tmp_path / name, Workers(1))

    (same,) = again("first")
    assert same.faults == ()
    assert same.what.startswith("squares_runs.csv: 6 runs on the recording of number 2")
    double_a_number(results / SQUARES.runs_file)
    (other,) = again("second")
    assert other.faults == ("cell 5: square is 49, committed: 98. ",)


def row(**changes: str) -> pd.DataFrame:
    values = {"flight": "3", "method": "tangency", "status": "ok", "reason": "",
              "t_d_estimate_ms": "50.0123", "r_error_deg": "0.05", "t_error_deg": "0.04",
              "t_d_std_ms": "0.06", "n_samples": "350", "n_events_cam1": "1234567"}  # fmt: skip
    return pd.DataFrame([values | changes])


KEYS = ("flight", "method")


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("status", "search_bound"),
        ("t_d_estimate_ms", "50.0124"),
        ("t_d_std_ms", "0.05"),
        ("n_samples", "349"),
        ("n_events_cam1", "1234599"),
        ("r_error_deg", ""),
    ],
)
def test_on_the_same_machine_every_number_counts(name: str, value: str) -> None:
    assert row_faults(row(), row(), KEYS, exactly=True) == ()
    (fault,) = row_faults(row(), row(**{name: value}), KEYS, exactly=True)
    assert f"{name} is " in fault


def test_a_count_that_a_table_rounds_to_six_digits_is_the_same() -> None:
    assert row_faults(row(), row(n_events_cam1="1.23457e+06"), KEYS, exactly=True) == ()


@pytest.mark.parametrize("method", NAMES)
def test_elsewhere_numbers_may_differ_by_their_tolerance(method: str) -> None:
    for name, tolerance in tolerances(method).items():
        if not name.startswith("n_events_cam2"):
            value = float(row()[name].iloc[0])
            reach = tolerance * value if name == "n_events_cam1" else tolerance
            for factor, n_faults in ((0.9, 0), (1.1, 1)):
                near = row(method=method, **{name: f"{value + factor * reach:.9g}"})
                found = row_faults(row(method=method), near, KEYS, exactly=False)
                assert len(found) == n_faults, name


def test_a_status_must_be_the_same_everywhere() -> None:
    assert row_faults(row(), row(status="search_bound"), KEYS, exactly=False)


def test_a_run_that_is_gone_or_crashes_again_is_found() -> None:
    (fault,) = row_faults(row(), row(flight="4"), KEYS, exactly=True)
    assert fault == "flight 3, method tangency: no such run is committed"
    crash = row(status="crashed", reason="tangency: KeyError: 1")
    (fault,) = row_faults(crash, crash, KEYS, exactly=True)
    assert "KeyError" in fault


def test_tolerances_are_far_below_what_they_guard() -> None:
    """Half a percent of the search interval, or a pose error that no table would show."""
    for name in METHODS:
        for column, tolerance in tolerances(name).items():
            assert 0.0 < tolerance <= (20.0 if column == "t_d_estimate_ms" else 0.1)
            assert "zncc" in name or name == "event_rate" or tolerance <= 0.1


# --- The command ---


app = typer.Typer()
app.command()(command.verify_command)


def verify(results: Path, *options: str) -> tuple[int, str]:
    arguments = ["--results", str(results), "--workers", "1", *options]
    result = CliRunner().invoke(app, arguments, catch_exceptions=False)
    return result.exit_code, result.output


def test_the_command_says_what_it_drew_and_fails_on_a_difference(
    results: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen = []

    def again(drawn, *_: object) -> list[Finding]:
        seen.append(names(drawn))
        return []

    monkeypatch.setattr(command, "ALL_STUDIES", STUDIES)
    monkeypatch.setattr(command, "CAMPAIGNS", ())
    monkeypatch.setattr(command, "recomputed", again)
    code, output = verify(results, "--recordings", "3")
    assert code == 0, output
    assert output.endswith("all of it as committed\n")
    seed = output.partition("--sample-seed ")[2].split()[0]
    verify(results, "--recordings", "3", "--sample-seed", seed)
    assert seen[0] == seen[1]
    verify(results, "--recordings", "3")
    assert seen[2] != seen[0]  # by a chance of one in thousands
    (results / "esim_10.csv").unlink()
    code, output = verify(results, "--recordings", "0")
    assert code == 1
    assert "        - esim_10.csv\n" in output
    assert len(seen) == 3


def test_no_folder_is_no_verdict_but_an_error(tmp_path: Path) -> None:
    with pytest.raises(SsacError, match="no such folder: run `make tables"):
        verify(tmp_path / "none")
