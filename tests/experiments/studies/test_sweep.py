"""Real sweeps over a tiny grid: any number of workers, shards, interruptions and crashes.

The flights are short and coarsely rendered: what is tested is the bookkeeping, not the accuracy.
"""

import json
import os
import re
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import pandas as pd
import pytest
from typer.testing import CliRunner

from experiments.cli import app
from experiments.run import schedule
from experiments.run.cache import Cache
from experiments.run.grid import load_config
from experiments.run.schedule import Workers, run_cells
from experiments.run.task import CRASHED, tasks_of
from experiments.studies.study import numbered
from ssac.console.exits import BUG, INTERRUPTED
from ssac.errors import SsacError

pytestmark = pytest.mark.render

ROOT = Path(__file__).resolve().parents[3]

TOML = """
flights = 3
first_flight = 1
methods = [{methods}]
search_around_truth_s = [-0.2, 0.2]

[fixed]
sim.spline.duration_s = 3.0
sim.frames.rate_hz = 0.0
sim.render.lattice.a = 4
sim.sampling.max_step_px = 0.5
ssac.trials = 200

[grid]
sim.angle_deg = [90]
sim.t_d_s = [0.005, 0.05]
"""

# A plugin whose methods fail in the four ways there are; docs/methods.md tells about plugins.
PLUGIN = """
import os
import signal
from dataclasses import replace
from pathlib import Path

from ssac import SsacError
from ssac.baselines.event_rate import event_rate

def raising(cam1, cam2, rig, config=None):
    raise RuntimeError("a bug")

def refusing(cam1, cam2, rig, config=None):
    raise SsacError("not with these data")

def dying(cam1, cam2, rig, config=None):
    os._exit(3)

def dying_once(cam1, cam2, rig, config=None):
    try:
        Path(__file__).with_name("died").touch(exist_ok=False)
    except FileExistsError:
        return replace(event_rate(cam1, cam2, rig, config), method="dying_once")
    os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("sweep")


@pytest.fixture(scope="module")
def config(folder):
    path = folder / "tiny.toml"
    path.write_text(TOML.format(methods='"ssac", "event_rate", "zncc_f"'))
    return path


@pytest.fixture(scope="module")
def whole(folder, config):
    """The sweep in one piece, by one process."""
    out = folder / "whole.csv"
    result = sweep(config, out, folder / "cache", "--workers", "1")
    assert result.exit_code == 0, result.output
    return out


def sweep(config, out, cache, *more):
    arguments = ["sweep", str(config), "--out", str(out), "--cache", str(cache), *more]
    return CliRunner().invoke(app, arguments, catch_exceptions=False)


def without_runs(folder: Path, name: str) -> Path:
    """Return a cache with the recordings of `folder` / cache, but no runs."""
    cache = folder / name
    cache.mkdir()
    (cache / "recordings").symlink_to(folder / "cache" / "recordings")
    return cache


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
    assert skipped["reason"].str.contains("has none").all()
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


@pytest.fixture(scope="module")
def plugin(folder):
    """A folder in which Python finds the plugin."""
    plugin = folder / "plugin"
    info = plugin / "failing-1.0.dist-info"
    info.mkdir(parents=True)
    (plugin / "failing.py").write_text(PLUGIN)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: failing\nVersion: 1.0\n")
    names = ("raising", "refusing", "dying", "dying_once")
    entries = "".join(f"{name} = failing:{name}\n" for name in names)
    (info / "entry_points.txt").write_text(f"[ssac.methods]\n{entries}")
    return plugin


def started(folder, plugin, config, out, cache, *more):
    """A sweep as a process of its own, which knows the plugin's methods."""
    command = [sys.executable, "-m", "experiments", "sweep", str(config)]
    command += ["--out", str(out), "--cache", str(cache), *more]
    environment = os.environ | {"PYTHONPATH": f"{plugin}{os.pathsep}{ROOT}"}
    return subprocess.Popen(
        command, env=environment, cwd=folder, text=True,
        stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, start_new_session=True,
    )  # fmt: skip


def swept(*arguments):
    """Run such a process; its exit code and what it said."""
    process = started(*arguments)
    said = process.communicate()[1]
    return process.returncode, said


@pytest.fixture(scope="module")
def mortal(folder, plugin, whole):
    """A grid whose methods kill a worker once, and its rows where none is killed."""
    config, out = folder / "mortal.toml", folder / "mortal.csv"
    config.write_text(TOML.format(methods='"event_rate", "dying_once"'))
    (plugin / "died").touch()
    cache = without_runs(folder, "cache_mortal")
    code, said = swept(folder, plugin, config, out, cache, "--workers", "1")
    assert code == 0, said
    return config, out


def test_a_worker_that_is_killed_is_replaced_and_the_bytes_are_the_same(folder, plugin, mortal):
    config, expected = mortal
    (plugin / "died").unlink()
    out, cache = folder / "replaced.csv", without_runs(folder, "cache_replaced")
    code, said = swept(folder, plugin, config, out, cache, "--workers", "2")
    assert code == 0, said
    assert "a worker ended by SIGKILL on the flight of 3 s at 90 deg with seed" in said
    assert "1 workers died and were replaced" in said
    assert (plugin / "died").exists()
    assert out.read_bytes() == expected.read_bytes()


def test_two_runs_that_share_a_cache_simulate_no_recording_twice(folder, plugin, config, whole):
    cache, outs = folder / "cache_shared", (folder / "one.csv", folder / "other.csv")
    runs = [started(folder, plugin, config, out, cache, "--workers", "1") for out in outs]
    told = [process.communicate()[1] for process in runs]
    assert [process.returncode for process in runs] == [0, 0], told
    simulated = [int(re.search(r"(\d+) of them simulated", said)[1]) for said in told]
    assert sum(simulated) == 3, told
    for out in outs:
        assert out.read_bytes() == whole.read_bytes()
    assert not list(cache.rglob(".*"))  # neither claims nor anything half-made


@pytest.fixture
def scheduler(folder, plugin):
    """Address of a Dask scheduler with two workers, each a process of its own."""
    pytest.importorskip("distributed")
    file = folder / "scheduler.json"
    dask, local = (sys.executable, "-m", "dask"), ("--scheduler-file", str(file))
    file.unlink(missing_ok=True)
    environment = os.environ | {"PYTHONPATH": f"{plugin}{os.pathsep}{ROOT}"}
    start = partial(
        subprocess.Popen, env=environment, cwd=folder, stderr=subprocess.DEVNULL, text=True
    )
    boss = start(
        [*dask, "scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard", *local]
    )
    try:
        while not file.exists():
            assert boss.poll() is None
            time.sleep(0.1)
        worker = [*dask, "worker", "--nthreads", "1", "--no-dashboard", "--no-nanny", *local]
        workers = [start(worker) for _ in range(2)]
        try:
            yield json.loads(file.read_text())["address"]
        finally:
            for process in workers:
                process.kill()
                process.wait()
    finally:
        boss.kill()
        boss.wait()


def test_the_workers_of_a_dask_scheduler_write_the_same_bytes(folder, config, whole, scheduler):
    out = folder / "dask.csv"
    cache = without_runs(folder, "cache_dask")
    assert sweep(config, out, cache, "--scheduler", scheduler).exit_code == 0
    assert out.read_bytes() == whole.read_bytes()
    assert len(list((cache / "runs").rglob("*.json"))) == 3 * 2 * 3


def test_a_dask_worker_that_is_killed_changes_no_byte(folder, plugin, mortal, scheduler):
    config, expected = mortal
    (plugin / "died").unlink()
    out, cache = folder / "dask_killed.csv", without_runs(folder, "cache_dask_killed")
    code, said = swept(folder, plugin, config, out, cache, "--scheduler", scheduler)
    assert code == 0, said
    assert (plugin / "died").exists()
    assert out.read_bytes() == expected.read_bytes()


def test_a_scheduler_that_loses_all_workers_is_one_line(folder, plugin, scheduler, monkeypatch):
    from experiments.workers import cluster

    with cluster.Cluster(scheduler) as crew:
        monkeypatch.setattr(cluster, "WAIT_FOR_WORKERS_S", 0.2)
        monkeypatch.setattr(cluster, "_LOOK_S", 0.1)
        crew.give(0, partial(os._exit, 3))  # first one dies of it, then the other
        with pytest.raises(SsacError, match="has no workers any more: what is done is in the"):
            crew.ended(None)


def test_a_scheduler_that_is_killed_is_one_line(folder, plugin, scheduler, capfd):
    from experiments.workers import cluster

    with cluster.Cluster(scheduler) as crew:
        crew.give(0, partial(time.sleep, 600))
        os.kill(crew._client.run_on_scheduler(os.getpid), signal.SIGKILL)
        with pytest.raises(SsacError, match="is gone: what is done is in the cache"):
            crew.ended(None)
    assert capfd.readouterr().err == ""


def test_an_interrupted_sweep_says_how_to_go_on_and_leaves_nothing_half_made(folder, plugin):
    out, cache = folder / "interrupted.csv", folder / "cache_interrupted"
    longer = folder / "longer.toml"  # so that both are at it when they are interrupted
    longer.write_text(TOML.format(methods='"ssac"').replace("duration_s = 3.0", "duration_s = 300"))
    run = started(folder, plugin, longer, out, cache, "--workers", "2")
    while len(list(cache.glob("recordings/.*.claim"))) < 2:  # both workers simulate
        assert run.poll() is None
        time.sleep(0.1)
    os.killpg(run.pid, signal.SIGINT)  # as a terminal does: to all processes in it
    assert run.communicate()[1] == (
        f"stopped: 0 of 3 recordings are done and kept in {cache}; the same command goes on from"
        " there\ninterrupted\n"
    )
    assert run.returncode == INTERRUPTED
    assert not [path for path in cache.rglob("*") if path.is_file()]


def test_no_scheduler_is_one_line(folder, config):
    pytest.importorskip("distributed")
    cells, cache = load_config(config).cells(), Cache(without_runs(folder, "cache_none"))
    with pytest.raises(SsacError, match=r"no Dask scheduler answers at 'tcp://127.0.0.1:9'"):
        run_cells(cells, cache, Workers(scheduler="tcp://127.0.0.1:9"), show_progress=False)


def test_a_scheduler_without_workers_is_one_line(folder, config, monkeypatch):
    distributed = pytest.importorskip("distributed")
    monkeypatch.setattr("experiments.workers.cluster.WAIT_FOR_WORKERS_S", 0.2)
    cells, cache = load_config(config).cells(), Cache(without_runs(folder, "cache_idle"))
    with distributed.LocalCluster(n_workers=0, processes=False, dashboard_address=None) as cluster:
        workers = Workers(scheduler=cluster.scheduler_address)
        with pytest.raises(SsacError, match="has no workers: start some with dask worker"):
            run_cells(cells, cache, workers, show_progress=False)


def test_what_is_done_is_not_done_again(config, folder, whole, monkeypatch):
    def never(*_):
        raise AssertionError("all runs are in the cache")

    monkeypatch.setattr("experiments.run.schedule.run_task", never)
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


def test_crashes_are_rows_and_the_others_go_on(folder, plugin, whole):
    cache = without_runs(folder, "cache_crash")

    def run(n_flights, *methods):
        config = folder / "crash.toml"
        text = TOML.format(methods=", ".join(f'"{name}"' for name in methods))
        config.write_text(text.replace("flights = 3", f"flights = {n_flights}"))
        out = folder / "crash.csv"
        code, said = swept(folder, plugin, config, out, cache, "--workers", "2")
        runs = pd.read_csv(out)
        assert len(runs) == len(methods) * n_flights * 2, said
        return code, said, runs.groupby("method")

    code, said, runs = run(1, "event_rate", "raising", "refusing")
    assert code == BUG
    assert "2 runs crashed" in said
    assert (runs.get_group("event_rate")["status"] == "ok").all()
    raising, refusing = runs.get_group("raising"), runs.get_group("refusing")
    assert (raising["status"] == CRASHED).all()
    assert (raising["reason"] == "raising: RuntimeError: a bug").all()
    assert (refusing["status"] == "unusable").all()
    assert (refusing["reason"] == "not with these data").all()

    # A worker that dies loses what it had not done of its recording, and no other recording.
    code, said, runs = run(2, "event_rate", "dying")
    assert code == BUG
    assert (runs.get_group("event_rate").groupby("flight")["status"].first() == "ok").all()
    dying = runs.get_group("dying")
    assert (dying["status"] == CRASHED).all()
    expected = "worker: DiedError: 2 workers died of it, the last one ended with code 3"
    assert (dying["reason"] == expected).all()
    assert "4 workers died and were replaced" in said
