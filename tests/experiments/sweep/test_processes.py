"""Workers, hosts, schedulers and whole sweeps that die or are stopped."""

import json
import os
import re
import signal
import subprocess
import sys
import threading
import time
from functools import partial

import pandas as pd
import pytest

from experiments.lab import pool as pools
from experiments.lab.cell import CRASHED
from ssac.cli.exits import BUG, INTERRUPTED
from ssac.errors import SsacError
from tests.experiments.sweep.tiny import ROOT, TOML, started, sweep, swept, without_runs

pytestmark = pytest.mark.render


@pytest.fixture(scope="module")
def mortal(folder, whole):
    """A grid with a method that kills its worker once, and the rows that it must give."""
    config = folder / "mortal.toml"
    config.write_text(TOML.format(methods='"event_rate", "dying_once"'))
    header, *lines = whole.read_text().splitlines()
    rates = [line.partition(",")[2] for line in lines if ",event_rate," in line]
    rows = [line for rate in rates for line in (rate, rate.replace("event_rate", "dying_once"))]
    numbered = [f"{number},{row}" for number, row in enumerate(rows)]
    return config, "\n".join([header, *numbered, ""])


def test_a_worker_that_is_killed_is_replaced_and_the_bytes_are_the_same(folder, plugin, mortal):
    config, expected = mortal
    out, cache = folder / "replaced.csv", without_runs(folder, "cache_replaced")
    code, said = swept(folder, plugin, config, out, cache, "--workers", "2")
    assert code == 0, said
    assert "a worker ended by SIGKILL on the flight of 3 s at 90 deg with seed" in said
    assert "1 workers died and were replaced" in said
    assert (plugin / "died").exists()
    assert out.read_text() == expected


def test_a_crash_is_a_row_with_its_reason(folder, plugin, whole):
    config, out = folder / "crash.toml", folder / "crash.csv"
    text = TOML.format(methods='"event_rate", "raising", "refusing"')
    config.write_text(text.replace("flights = 3", "flights = 1"))
    cache = without_runs(folder, "cache_crash")
    code, said = swept(folder, plugin, config, out, cache, "--workers", "2")
    assert code == BUG
    assert "2 runs crashed" in said
    runs = pd.read_csv(out).set_index("method")
    assert set(runs.loc["event_rate", "status"]) == {"ok"}
    assert set(runs.loc["raising", "status"]) == {CRASHED}
    theirs = (
        r"raising: PluginError: failing 1\.0 \(entry .*\): RuntimeError: a bug \(.*failing.py, line"
    )
    assert runs.loc["raising", "reason"].str.match(theirs).all()
    assert set(runs.loc["refusing", "status"]) == {"unusable"}
    assert set(runs.loc["refusing", "reason"]) == {"not with these data"}


def test_two_runs_that_share_a_cache_simulate_no_recording_twice(folder, plugin, config, whole):
    cache, outs = folder / "cache_shared", (folder / "one.csv", folder / "other.csv")
    runs = [started(folder, plugin, config, out, cache, "--workers", "1") for out in outs]
    told = [process.communicate()[1] for process in runs]
    assert [process.returncode for process in runs] == [0, 0], told
    simulated = [int(re.search(r"(\d+) of them simulated", said)[1]) for said in told]
    assert sum(simulated) == 3, told
    for out in outs:
        assert out.read_bytes() == whole.read_bytes()
    assert not list(cache.rglob(".*"))  # neither locks nor anything half-made


def test_an_interrupted_sweep_says_how_to_go_on_and_leaves_nothing_half_made(folder, plugin):
    out, cache = folder / "interrupted.csv", folder / "cache_interrupted"
    longer = folder / "longer.toml"  # so that both are at it when they are interrupted
    longer.write_text(TOML.format(methods='"ssac"').replace("duration_s = 3.0", "duration_s = 100"))
    run = started(folder, plugin, longer, out, cache, "--workers", "2")
    while len(list(cache.glob("recordings/.*.claim"))) < 2:  # both workers simulate
        assert run.poll() is None
        time.sleep(0.1)
    os.killpg(run.pid, signal.SIGINT)  # as a terminal does: to all processes in it
    shown = run.communicate()[1].splitlines()
    # On a slow machine it has said by then how far it was.
    assert [line for line in shown if not line.startswith("longer: ")] == [
        f"stopped: 0 of 3 recordings are done and kept in {cache}; the same command goes on from"
        " there",
        "interrupted",
    ]
    assert run.returncode == INTERRUPTED
    assert not [path for path in cache.rglob("*") if path.is_file()]


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
    assert sweep(config, out, cache, "--workers", "1").exit_code == 0
    assert out.read_bytes() == whole.read_bytes()
    assert not list(cache.rglob(".*"))


# --- Dask ---


def test_a_dask_scheduler_whose_worker_is_killed_changes_no_byte_and_its_own_end_is_one_line(
    folder, plugin, mortal, capfd
):
    pytest.importorskip("distributed")
    config, expected = mortal
    (plugin / "died").unlink(missing_ok=True)
    file = folder / "scheduler.json"
    dask, local = (sys.executable, "-m", "dask"), ("--scheduler-file", str(file))
    environment = os.environ | {"PYTHONPATH": f"{plugin}{os.pathsep}{ROOT}"}
    start = partial(subprocess.Popen, env=environment, cwd=folder, stderr=subprocess.DEVNULL)
    host = ("--host", "127.0.0.1", "--port", "0", "--no-dashboard")
    processes = [start([*dask, "scheduler", *host, *local])]
    try:
        worker = [*dask, "worker", "--nthreads", "1", "--no-dashboard", "--no-nanny", *local]
        processes += [start(worker) for _ in range(2)]
        for process in processes:  # one that ended and is not waited for seems to hold its lock
            threading.Thread(target=process.wait, daemon=True).start()
        while not file.exists():
            assert processes[0].poll() is None
            time.sleep(0.1)
        address = json.loads(file.read_text())["address"]
        out, cache = folder / "dask.csv", without_runs(folder, "cache_dask")
        code, said = swept(folder, plugin, config, out, cache, "--scheduler", address)
        assert code == 0, said
        assert (plugin / "died").exists()
        assert out.read_text() == expected
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
