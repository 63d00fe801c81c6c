"""Commands import neither the simulator nor the experiments, nor anything else unneeded."""

import json
import subprocess
import sys
from itertools import product

import pytest

from tests.recorded import T_D_S
from tests.ssac.command import run

RUN = """
import runpy
import sys

sys.argv[0] = "ssac"
try:
    runpy.run_module(sys.argv.pop(1), run_name="__main__", alter_sys=True)
finally:
    print("imported:", *sys.modules)
    from threadpoolctl import threadpool_info
    blas = [one for one in threadpool_info() if one["user_api"] == "blas"]
    print("threads:", *{one["num_threads"] for one in blas})
"""


def ran(*args: object):
    """Run a module's command line; return the process, its imports, and BLAS's thread count."""
    command = [sys.executable, "-c", RUN, *map(str, args)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    *_, modules, threads = done.stdout.splitlines()
    return done, set(modules.split()), threads


def test_only_its_own_commands_are_listed():
    code, out, _ = run("--help")
    assert code == 0
    assert "sync" in out
    assert "simulate" not in out


HEAVY = {
    *("faery", "matplotlib", "pandas", "scipy.signal", "scipy.stats", "scipy.interpolate"),
    *("ssac.network.solve", "ssac.network.ground", "ssac.pipeline.plots", "ssac.methods.albl"),
}
FOR_WORK = {"numba", "scipy", "cv2", "h5py", "pyrender", "trimesh"}


@pytest.mark.parametrize("method", ["tangency", "event_rate"])
def test_sync_needs_no_simulator_and_imports_no_more_than_it_needs(method, recorded, tmp_path):
    out = tmp_path / "out.json"
    args = (*recorded.pair, "--rig", recorded / "rig.yaml", "--method", method, "--json", out)
    done, imported, threads = ran("ssac.cli", "sync", *args)
    assert done.returncode == 0, done.stderr
    assert abs(json.loads(out.read_text())["t_d_s"] - T_D_S) < 0.05
    assert "scipy.ndimage" in imported  # the list works
    assert not (HEAVY | {"sim", "experiments"}) & imported
    assert threads == "threads: 1"


USES = [*product(("ssac.cli", "experiments"), ("--version", "sync --help", "sync"))]


@pytest.mark.parametrize(("module", "args"), [*USES, ("ssac", "")])
def test_nothing_heavy_is_imported_for_help_or_for_bad_usage_nor_by_the_package(module, args):
    _, imported, _ = ran(module, *args.split())
    assert ("typer" in imported) == (module != "ssac")
    assert not (HEAVY | FOR_WORK) & imported
