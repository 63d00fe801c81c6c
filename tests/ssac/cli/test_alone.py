"""What a command needs not: simulator, experiments, and all that is not asked for."""

import json
import subprocess
import sys
from itertools import product

import pytest

from tests.recorded import T_D_S

RUN = """
import runpy
import sys

class Absent:
    def find_spec(self, name, path=None, target=None):
        if {is_alone} and name.partition(".")[0] in ("sim", "experiments"):
            raise ModuleNotFoundError(f"{{name}} is not here")

sys.meta_path.insert(0, Absent())
sys.argv[0] = "ssac"
try:
    runpy.run_module("{module}", run_name="__main__", alter_sys=True)
finally:
    print("imported:", *sys.modules)
    from threadpoolctl import threadpool_info
    blas = [one for one in threadpool_info() if one["user_api"] == "blas"]
    print("threads:", *{{one["num_threads"] for one in blas}})
"""


def ran(module: str, *args: object, is_alone: bool = False):
    """The process of a command line, all that it imported, and how many threads BLAS had."""
    command = [sys.executable, "-c", RUN.format(module=module, is_alone=is_alone), *map(str, args)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    *_, modules, threads = done.stdout.splitlines()
    return done, set(modules.split()), threads


def test_only_its_own_commands_are_listed():
    done, *_ = ran("ssac.cli", "--help", is_alone=True)
    assert done.returncode == 0
    assert "sync" in done.stdout
    assert "simulate" not in done.stdout
    # Or else neither test would say anything: what is barred is barred.
    assert "sim is not here" in ran("sim.errors", is_alone=True)[0].stderr


HEAVY = {
    *("faery", "matplotlib", "pandas", "scipy.signal", "scipy.stats", "scipy.interpolate"),
    *("ssac.network.solve", "ssac.network.ground", "ssac.pipeline.plots", "ssac.methods.albl"),
}
FOR_WORK = {"numba", "scipy", "cv2", "h5py", "pyrender", "trimesh"}


@pytest.mark.parametrize("method", ["tangency", "event_rate"])
def test_sync_needs_no_simulator_and_imports_no_more_than_it_needs(method, recorded, tmp_path):
    out = tmp_path / "out.json"
    args = (*recorded.pair, "--rig", recorded / "rig.yaml", "--method", method, "--json", out)
    done, imported, threads = ran("ssac.cli", "sync", *args, is_alone=True)
    assert done.returncode == 0, done.stderr
    assert abs(json.loads(out.read_text())["t_d_s"] - T_D_S) < 0.05
    assert "scipy.ndimage" in imported  # what is needed is listed
    assert not HEAVY & imported
    assert threads == "threads: 1"


def test_figures_need_no_simulator(recorded, tmp_path):
    args = (*recorded.pair, "--rig", recorded / "rig.yaml", "--method", "zncc_f")
    done, *_ = ran("ssac.cli", "sync", *args, "--plot", tmp_path, is_alone=True)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "d_avg.png").exists()


USES = [*product(("ssac.cli", "experiments"), ("--version", "sync --help", "sync"))]


@pytest.mark.parametrize(("module", "args"), [*USES, ("ssac", "")])
def test_nothing_heavy_is_imported_for_help_or_for_bad_usage_nor_by_the_package(module, args):
    _, imported, _ = ran(module, *args.split())
    assert ("typer" in imported) == (module != "ssac")
    assert not (HEAVY | FOR_WORK) & imported
