"""What `sync` of two event files does not wait for: imports and threads that it does not need."""

import subprocess
import sys

import pytest

CODE = """
import sys
from ssac.tool.__main__ import main
code = main(sys.argv[1:])
print("imported:", *sys.modules)
from threadpoolctl import threadpool_info
print("threads:", *{one["num_threads"] for one in threadpool_info() if one["user_api"] == "blas"})
sys.exit(code)
"""

HEAVY = {
    *("faery", "matplotlib", "pandas", "scipy.signal", "scipy.stats", "scipy.interpolate"),
    *("ssac.network.solve", "ssac.compare.frame", "ssac.plot.plots", "ssac.baselines.albl"),
}


@pytest.mark.parametrize("method", ["tangency", "event_rate"])
def test_sync_imports_no_more_than_it_needs(method, recorded):
    args = ("sync", *recorded.pair, "--rig", recorded / "rig.yaml", "--method", method)
    result = subprocess.run(
        [sys.executable, "-c", CODE, *map(str, args)],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert result.returncode == 0, result.stderr
    *_, modules, threads = result.stdout.splitlines()
    imported = modules.split()
    assert "scipy.ndimage" in imported  # what is needed is listed
    assert not HEAVY & set(imported)
    assert threads == "threads: 1"
