"""Real sweeps over a tiny grid: rows, shards, skipped runs, and processes that die or are stopped.

The flights are short and coarsely rendered: what is tested is the bookkeeping, not the accuracy.
"""

import json
import os
import re
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from functools import partial
from pathlib import Path

import pandas as pd
import pytest

from experiments.lab import pool as pools
from experiments.lab.code import ROOT
from ssac.cli.exits import INTERRUPTED
from ssac.errors import SsacError
from tests.experiments.command import run

pytestmark = pytest.mark.render

TOML = """
flights = 3
first_flight = 1
methods = [{methods}]
search_around_truth_s = [-0.2, 0.2]

[fixed]
sim.spline.duration_s = 3.0
sim.frames.rate_hz = 0.0
sim.render.lattice.a = 4
sim.render.check = false
sim.sampling.max_step_px = 0.5
ssac.n_min = 20

[grid]
sim.angle_deg = [90]
sim.t_d_s = [0.005, 0.05]
"""


def sweep(config, out, cache, *more):
    return run("sweep", config, "--out", out, "--cache", cache, *more)


def python(folder, *words, stderr=subprocess.DEVNULL):
    """Run a module in a process of its own."""
    return subprocess.Popen(
        [sys.executable, "-m", *map(str, words)], env=os.environ | {"PYTHONPATH": str(ROOT)},
        cwd=folder, text=True, stdout=subprocess.DEVNULL, stderr=stderr, start_new_session=True,
    )  # fmt: skip


def started(folder, config, out, cache, *more):
    words = ("experiments", "sweep", config, "--out", out, "--cache", cache, *more)
    return python(folder, *words, stderr=subprocess.PIPE)


def at_work(cache, is_running):
    """Wait until a process works on a recording of a run; return the id of the process."""
    while True:
        with suppress(FileNotFoundError):  # the lock was just released
            for pid in holders(cache):
                return pid
        assert is_running()
        time.sleep(0.01)


def holders(cache):
    """Return the ids of the processes that hold locks of recordings, alive or not."""
    texts = [path.read_text() for path in cache.glob("runs/.*.claim")]
    found = [re.search(r"^pid=(\d+)$", text, re.MULTILINE) for text in texts]
    return [int(one[1]) for one in found if one]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sweep")
    (folder / "tiny.toml").write_text(TOML.format(methods='"event_rate", "zncc_f"'))
    return folder


@pytest.fixture(scope="module")
def whole(folder):
    """The sweep in one piece, by one process."""
    out = folder / "whole.csv"
    sweep(folder / "tiny.toml", out, folder / "cache", "--workers", "1")
    return out


def test_a_sweep_says_what_drew_and_its_merged_shards_are_the_same_bytes(folder, whole):
    ended = set(pd.read_csv(whole)[["method", "status"]].itertuples(index=False, name=None))
    assert ended == {("event_rate", "ok"), ("zncc_f", "skipped")}
    content = json.loads(whole.with_suffix(".provenance.json").read_text())
    assert content["gl"]["backend"] in ("osmesa", "egl")
    parts, out = [folder / "part1.csv", folder / "part2.csv"], folder / "merged.csv"
    for index, part in enumerate(parts, start=1):
        sweep(folder / "tiny.toml", part, folder / "cache", "--shard", f"{index}/2", "--workers", 1)
    run("merge", out, *reversed(parts))
    assert out.read_bytes() == whole.read_bytes()
    assert (folder / "merged_cells.csv").read_bytes() == (folder / "whole_cells.csv").read_bytes()


def test_two_runs_that_share_a_cache_simulate_no_recording_twice(folder, whole):
    cache, outs = folder / "cache_shared", (folder / "one.csv", folder / "other.csv")
    other = started(folder, folder / "tiny.toml", outs[0], cache, "--workers", "1")
    at_work(cache, lambda: other.poll() is None)
    told = [sweep(folder / "tiny.toml", outs[1], cache, "--workers", "1"), other.communicate()[1]]
    assert other.returncode == 0, told
    simulated = [int(re.search(r"(\d+) of them simulated", said)[1]) for said in told]
    assert sum(simulated) == 3, told
    for out in outs:
        assert out.read_bytes() == whole.read_bytes()
    assert not list(cache.rglob(".*"))  # neither locks nor anything half-made


def test_an_interrupted_sweep_says_how_to_go_on_and_leaves_nothing_half_made(folder):
    out, cache = folder / "interrupted.csv", folder / "cache_interrupted"
    longer = folder / "longer.toml"  # both workers must be busy when they are interrupted
    longer.write_text(TOML.format(methods='"ssac"').replace("duration_s = 3.0", "duration_s = 100"))
    run = started(folder, longer, out, cache, "--workers", "2")
    while len(list(cache.glob("recordings/.*.claim"))) < 2:  # both workers simulate
        assert run.poll() is None
        time.sleep(0.1)
    os.killpg(run.pid, signal.SIGINT)  # as a terminal does: to all processes in it
    shown = run.communicate()[1].splitlines()
    stopped = f"0 of 3 recordings are done and kept in {cache}; the same command goes on from there"
    # On a slow machine lines about the progress may come first.
    shown = [line for line in shown if not line.startswith("longer: ")]
    assert shown == [f"stopped: {stopped}", "interrupted"]
    assert run.returncode == INTERRUPTED
    assert not [path for path in cache.rglob("*") if path.is_file()]


def test_a_killed_worker_is_replaced_and_a_killed_sweep_goes_on_to_the_same_bytes(folder, whole):
    out, cache = folder / "killed.csv", folder / "cache_killed"
    run = started(folder, folder / "tiny.toml", out, cache, "--workers", "2")
    os.kill(at_work(cache, lambda: run.poll() is None), signal.SIGKILL)
    while "a worker ended by SIGKILL on the flight of 3 s at 90 deg with seed" not in (
        said := run.stderr.readline()
    ):
        assert said
    n_kept = len(list(cache.glob("runs/*/*.json")))
    while len(list(cache.glob("runs/*/*.json"))) == n_kept:  # further rows are kept: it is at work
        assert run.poll() is None
        time.sleep(0.01)
    run.kill()
    run.communicate(timeout=60)  # its workers hold its stderr: they must end with it
    while any(Path("/proc", str(pid)).exists() for pid in holders(cache)):
        time.sleep(0.01)  # until the system takes note of its end, a process seems to hold a lock
    sweep(folder / "tiny.toml", out, cache, "--workers", "1")
    assert out.read_bytes() == whole.read_bytes()
    assert not list(cache.rglob(".*"))


def test_a_dask_scheduler_whose_worker_is_killed_changes_no_byte_and_its_own_end_is_one_line(
    folder, whole, capfd
):
    pytest.importorskip("distributed")
    file = folder / "scheduler.json"
    local = ("--no-dashboard", "--scheduler-file", file)
    host, worker = ("--host", "127.0.0.1", "--port", "0"), ("--nthreads", "1", "--no-nanny")
    processes = [python(folder, "dask", "scheduler", *host, *local)]
    try:
        processes += [python(folder, "dask", "worker", *worker, *local) for _ in "12"]
        for process in processes:  # a zombie process would seem to hold its lock
            threading.Thread(target=process.wait, daemon=True).start()
        while not file.exists():
            assert processes[0].poll() is None
            time.sleep(0.1)
        address = json.loads(file.read_text())["address"]
        out, cache = folder / "dask.csv", folder / "cache_dask"
        with ThreadPoolExecutor(1) as beside:
            killed = beside.submit(
                lambda: os.kill(at_work(cache, lambda: not out.exists()), signal.SIGKILL)
            )
            sweep(folder / "tiny.toml", out, cache, "--scheduler", address)
        killed.result()
        assert out.read_bytes() == whole.read_bytes()
        assert len(list((cache / "runs").rglob("*.json"))) == 3 * 2 * 2
        capfd.readouterr()
        with pools.Cluster(address) as pool:
            job = pool.submit(partial(time.sleep, 600))
            processes[0].kill()
            with pytest.raises(SsacError, match="is gone: what is done is in the cache"):
                pool.ended([job], None)
        assert capfd.readouterr().err == ""
    finally:
        for process in processes:
            process.kill()
            process.wait()


def test_no_scheduler_and_one_without_workers_are_one_line(monkeypatch):
    distributed = pytest.importorskip("distributed")
    monkeypatch.setattr(pools, "ANSWERS_WITHIN_S", 0.2)
    with pytest.raises(SsacError, match=r"no Dask scheduler answers at 'tcp://127.0.0.1:9'"):
        pools.Cluster("tcp://127.0.0.1:9")
    monkeypatch.undo()
    monkeypatch.setattr(pools, "WAIT_FOR_WORKERS_S", 0.2)
    monkeypatch.setattr(pools, "_LOOK_S", 0.1)
    with distributed.LocalCluster(n_workers=1, processes=False, dashboard_address=None) as cluster:
        with pools.Cluster(cluster.scheduler_address) as pool:
            assert pool.ended([pool.submit(partial(int, "3"))], None).pop().result() == 3
            cluster.scale(0)
            cluster.sync(cluster.workers[0].close)
            with pytest.raises(SsacError, match="has no workers any more: what is done is in the"):
                pool.ended([pool.submit(partial(int, "3"))], None)
        with pytest.raises(SsacError, match="has no workers: start some with dask worker"):
            pools.Cluster(cluster.scheduler_address)
