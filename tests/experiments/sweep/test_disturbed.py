"""Sweeps that are killed as a whole, run out of disk, or are given a damaged mesh."""

import os
import signal
import subprocess
import time

import pytest

from ssac.cli.exits import BAD_INPUT
from tests.experiments.sweep.tiny import started, swept, without_runs

pytestmark = pytest.mark.render


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
