"""What `python -m ssac.cli` needs not: simulator, experiments, and all that is not asked for."""

import json
import subprocess
import sys

import pytest

from tests.recorded import T_D_S

WITHOUT = """
import runpy
import sys

class Absent:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in ("sim", "experiments"):
            raise ModuleNotFoundError(f"{name} is not here")

sys.meta_path.insert(0, Absent())
sys.argv[0] = "ssac.cli"
runpy.run_module("ssac.cli", run_name="__main__", alter_sys=True)
"""


def python(code: str, *args: object) -> "subprocess.CompletedProcess[str]":
    command = [sys.executable, "-c", code, *map(str, args)]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)


@pytest.mark.parametrize("method", ["tangency", "zncc_f"])
def test_sync_needs_neither(method, recorded, tmp_path):
    out, figures = tmp_path / "out.json", tmp_path / "figures"
    args = ("--rig", recorded / "rig.yaml", "--method", method, "--json", out, "--plot", figures)
    result = python(WITHOUT, "sync", *recorded.pair, *args)
    assert result.returncode == 0, result.stderr
    assert abs(json.loads(out.read_text())["t_d_s"] - T_D_S) < 0.05
    assert (figures / "d_avg.png").exists()


def test_only_its_own_commands_are_listed():
    result = python(WITHOUT, "--help")
    assert result.returncode == 0
    assert "sync" in result.stdout
    assert "simulate" not in result.stdout
    # Or else neither test would say anything: what is barred is barred.
    code = WITHOUT.replace('runpy.run_module("ssac.cli"', 'import sim.errors\nrunpy.run_module("x"')
    assert "sim is not here" in python(code).stderr


# --- What the start of a command does not wait for ---

CODE = """
import sys
from ssac.cli.__main__ import main
code = main(sys.argv[1:])
print("imported:", *sys.modules)
from threadpoolctl import threadpool_info
print("threads:", *{one["num_threads"] for one in threadpool_info() if one["user_api"] == "blas"})
sys.exit(code)
"""

HEAVY = {
    *("faery", "matplotlib", "pandas", "scipy.signal", "scipy.stats", "scipy.interpolate"),
    *("ssac.network.solve", "ssac.network.ground", "ssac.pipeline.plots", "ssac.methods.albl"),
}


@pytest.mark.parametrize("method", ["tangency", "event_rate"])
def test_sync_imports_no_more_than_it_needs(method, recorded):
    args = ("sync", *recorded.pair, "--rig", recorded / "rig.yaml", "--method", method)
    result = python(CODE, *args)
    assert result.returncode == 0, result.stderr
    *_, modules, threads = result.stdout.splitlines()
    imported = modules.split()
    assert "scipy.ndimage" in imported  # what is needed is listed
    assert not HEAVY & set(imported)
    assert threads == "threads: 1"
