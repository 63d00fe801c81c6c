"""Real sweeps over a tiny grid, in one process or two: rows, shards, what is done already."""

import json

import pandas as pd
import pytest
from typer.testing import CliRunner

from experiments.cli import app
from experiments.lab import schedule
from experiments.lab.cache import Cache
from experiments.lab.grid import load_config
from experiments.lab.schedule import Workers, run_cells
from experiments.lab.study import numbered
from experiments.lab.task import tasks_of
from tests.experiments.sweep.tiny import sweep, without_runs

pytestmark = pytest.mark.render


def test_every_run_is_a_row_and_every_parameter_a_column(whole):
    runs = pd.read_csv(whole)
    assert list(runs["cell"]) == list(range(3 * 2 * 3))
    assert (runs["sim.spline.duration_s"] == 3.0).all()
    assert (runs["ssac.trials"] == 200).all()
    assert runs.groupby(["sim.t_d_s", "flight", "method"]).size().eq(1).all()
    rates = runs[runs["method"] == "event_rate"]
    assert (rates["status"] == "ok").all()
    expected_ms = (1e3 * rates["sim.t_d_s"] - rates["t_d_estimate_ms"]).abs()
    assert rates["t_d_error_ms"].to_numpy() == pytest.approx(expected_ms.to_numpy(), abs=1e-3)
    skipped = runs[runs["method"] == "zncc_f"]
    assert (skipped["status"] == "skipped").all()
    assert skipped["reason"].str.contains("there are none").all()
    assert (runs["n_events_cam1"] > 0).all()


def test_offsets_share_the_recording(whole):
    runs = pd.read_csv(whole)
    assert runs.groupby("flight")[["n_events_cam1", "n_events_cam2"]].nunique().eq(1).all().all()
    # The search is around the truth, so the same events at another offset have the same error, but
    # for the rounding of seconds in double precision.
    errors = runs[runs["method"] == "ssac"].pivot(
        index="flight", columns="sim.t_d_s", values="t_d_error_ms"
    )
    assert errors[0.005].to_numpy() == pytest.approx(errors[0.05].to_numpy(), abs=1e-3)


def test_provenance_says_what_it_was_made_with(whole):
    content = json.loads(whole.with_suffix(".provenance.json").read_text())
    assert content["config"]["grid"]["flights"] == 3
    assert content["gl"]["backend"] in ("osmesa", "egl")
    assert {"commit", "versions", "wall_time_s", "command"} <= set(content)


def test_two_processes_write_the_same_bytes(folder, config, whole):
    out = folder / "two.csv"
    cache = without_runs(folder, "cache_two")
    assert sweep(config, out, cache, "--workers", "2").exit_code == 0
    assert out.read_bytes() == whole.read_bytes()


def test_what_is_done_is_not_done_again(config, folder, whole, monkeypatch):
    def never(*_):
        raise AssertionError("all runs are in the cache")

    monkeypatch.setattr("experiments.lab.schedule.run_task", never)
    out = folder / "again.csv"
    assert sweep(config, out, folder / "cache", "--workers", "1").exit_code == 0
    assert out.read_bytes() == whole.read_bytes()


def test_a_stopped_sweep_goes_on_where_it_was(config, folder, whole, monkeypatch):
    cache = without_runs(folder, "cache_stopped")
    cells = load_config(config).cells()
    first, *others = tasks_of(cells)
    run_cells(first.cells, Cache(cache), Workers(1), show_progress=False)
    seen, run_task = [], schedule.run_task

    def noted(task, *rest):
        seen.append(task.recordings)
        return run_task(task, *rest)

    monkeypatch.setattr(schedule, "run_task", noted)
    out = folder / "stopped.csv"
    assert sweep(config, out, cache, "--workers", "1").exit_code == 0
    assert set(seen) == {task.recordings for task in others}
    assert out.read_bytes() == whole.read_bytes()


@pytest.mark.parametrize("n_shards", [2, 3, 4])
def test_shards_are_a_partition_that_splits_no_recording(config, n_shards):
    grid = load_config(config)
    shards = [numbered(grid.cells(), (index + 1, n_shards)) for index in range(n_shards)]
    numbers = [number for shard in shards for number, _ in shard]
    assert sorted(numbers) == list(range(len(grid.cells())))
    recordings = [{(cell.sim, cell.seed) for _, cell in shard} for shard in shards]
    assert sum(map(len, recordings)) == len(set().union(*recordings))


def test_merged_shards_are_the_same_bytes(folder, config, whole):
    parts = []
    for index in (1, 2):
        parts.append(folder / f"part{index}.csv")
        shard = ("--shard", f"{index}/2", "--workers", "1")
        assert sweep(config, parts[-1], folder / "cache", *shard).exit_code == 0
    out = folder / "merged.csv"
    arguments = ["merge", str(out), *map(str, reversed(parts))]
    assert CliRunner().invoke(app, arguments, catch_exceptions=False).exit_code == 0
    assert out.read_bytes() == whole.read_bytes()
    shards = json.loads(out.with_suffix(".provenance.json").read_text())["shards"]
    assert [one["config"]["shard"] for one in shards] == ["2/2", "1/2"]

    def merge(*paths):
        return CliRunner().invoke(app, ["merge", str(folder / "x.csv"), *map(str, paths)])

    # Of three recordings with six runs each the first shard has two.
    assert "6 of 18 cells are in none of the shards" in str(merge(parts[0]).exception)
    assert "is in" in str(merge(parts[0], parts[0]).exception)
    assert not (folder / "x.csv").exists()


def test_shards_of_two_grids_do_not_merge(folder, config, whole):
    other = folder / "other.toml"
    other.write_text(config.read_text().replace("flights = 3", "flights = 1"))
    out = folder / "other.csv"
    assert sweep(other, out, folder / "cache", "--workers", "1").exit_code == 0
    result = CliRunner().invoke(app, ["merge", str(folder / "x.csv"), str(whole), str(out)])
    assert "is of another grid" in str(result.exception)
    bare = folder / "bare.csv"
    bare.write_text(whole.read_text())
    result = CliRunner().invoke(app, ["merge", str(folder / "x.csv"), str(bare)])
    assert "expected bare.provenance.json beside it" in str(result.exception)


@pytest.mark.parametrize("shard", ["0/2", "3/2", "1", "a/b", "-1/2"])
def test_a_shard_that_is_none_is_an_error(config, folder, shard):
    result = CliRunner().invoke(app, ["sweep", str(config), "--shard", shard])
    assert "--shard: expected i/n" in str(result.exception)
