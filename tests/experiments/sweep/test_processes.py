"""Workers, hosts, schedulers and whole sweeps that die, are stopped, or run out of disk."""

import json
import os
import re
import signal
import subprocess
import sys
import time
from functools import partial

import pandas as pd
import pytest

from experiments.lab.cache import Cache
from experiments.lab.cell import CRASHED
from experiments.lab.grid import load_config
from experiments.lab.schedule import Workers, run_cells
from ssac.cli.exits import BAD_INPUT, BUG, INTERRUPTED
from ssac.errors import SsacError
from tests.experiments.sweep.tiny import ROOT, TOML, started, sweep, swept, without_runs

pytestmark = pytest.mark.render


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
    from experiments.lab import cluster

    with cluster.Cluster(scheduler) as pool:
        monkeypatch.setattr(cluster, "WAIT_FOR_WORKERS_S", 0.2)
        monkeypatch.setattr(cluster, "_LOOK_S", 0.1)
        pool.give(0, partial(os._exit, 3))  # first one dies of it, then the other
        with pytest.raises(SsacError, match="has no workers any more: what is done is in the"):
            pool.ended(None)


def test_a_scheduler_that_is_killed_is_one_line(folder, plugin, scheduler, capfd):
    from experiments.lab import cluster

    with cluster.Cluster(scheduler) as pool:
        pool.give(0, partial(time.sleep, 600))
        os.kill(pool._client.run_on_scheduler(os.getpid), signal.SIGKILL)
        with pytest.raises(SsacError, match="is gone: what is done is in the cache"):
            pool.ended(None)
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
    monkeypatch.setattr("experiments.lab.cluster.WAIT_FOR_WORKERS_S", 0.2)
    cells, cache = load_config(config).cells(), Cache(without_runs(folder, "cache_idle"))
    with distributed.LocalCluster(n_workers=0, processes=False, dashboard_address=None) as cluster:
        workers = Workers(scheduler=cluster.scheduler_address)
        with pytest.raises(SsacError, match="has no workers: start some with dask worker"):
            run_cells(cells, cache, workers, show_progress=False)


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
    theirs = (
        r"raising: PluginError: failing 1\.0 \(entry .*\): RuntimeError: a bug \(.*failing.py, line"
    )
    assert raising["reason"].str.match(theirs).all()
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


@pytest.mark.parametrize("is_whole_group", [False, True])
def test_a_sweep_that_is_killed_goes_on_to_the_same_bytes(
    folder, plugin, config, whole, is_whole_group
):
    cache = without_runs(folder, f"cache_killed_{is_whole_group}")
    out = folder / f"killed_{is_whole_group}.csv"
    run = started(folder, plugin, config, out, cache, "--workers", "2")
    while not list(cache.rglob("*.json")):  # the first rows are kept: it is at work
        assert run.poll() is None
        time.sleep(0.01)
    (os.killpg if is_whole_group else os.kill)(run.pid, signal.SIGKILL)  # with workers, and alone
    run.communicate(timeout=60)  # the workers hold its stderr: they must end with it
    code, said = swept(folder, plugin, config, out, cache, "--workers", "1")
    assert code == 0, said
    assert out.read_bytes() == whole.read_bytes()
    assert not list(cache.rglob(".*"))


@pytest.fixture
def disk(tmp_path):
    """A file system of 64 KiB in memory."""
    at = tmp_path / "disk"
    at.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", str(at)]
    try:
        subprocess.run(mount, check=True, capture_output=True)
    except (OSError, subprocess.CalledProcessError):
        pytest.skip("only root may mount a file system")
    yield at
    subprocess.run(["umount", str(at)], check=True)


def test_a_sweep_on_a_full_disk_is_one_line_and_goes_on_where_there_is_room(
    folder, plugin, config, whole, disk
):
    out, cache = disk / "full.csv", without_runs(disk, "cache", folder / "cache")
    (disk / "filled").write_bytes(bytes(60 * 1024))
    code, said = swept(folder, plugin, config, out, cache, "--workers", "1")
    errors = [line for line in said.splitlines() if line.startswith("error")]
    assert code == BAD_INPUT
    assert len(errors) == 1
    assert str(disk) in errors[0]
    (disk / "filled").unlink()
    subprocess.run(["mount", "-o", "remount,size=64m", str(disk)], check=True)
    code, said = swept(folder, plugin, config, out, cache, "--workers", "1")
    assert code == 0, said
    assert out.read_bytes() == whole.read_bytes()
    assert not list(disk.rglob(".*"))


def test_a_damaged_mesh_in_a_grid_is_one_line(folder, plugin, config, tmp_path):
    mesh, grid = tmp_path / "drone.obj", tmp_path / "grid.toml"
    mesh.write_text("v 0 0\nf 1 2 3\n", encoding="utf-8")
    fixed = f"[fixed]\nsim.drone_file = {str(mesh)!r}\n"
    grid.write_text(config.read_text().replace("[fixed]\n", fixed), encoding="utf-8")
    out = tmp_path / "out.csv"
    code, said = swept(folder, plugin, grid, out, tmp_path / "cache", "--workers", "1")
    errors = [line for line in said.splitlines() if line.startswith("error")]
    assert (code, len(errors)) == (BAD_INPUT, 1), said
    assert mesh.name in errors[0]
    assert not out.exists()
