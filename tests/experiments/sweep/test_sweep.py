"""Real sweeps over a tiny grid, in one process or two: rows, shards, what cannot be done."""

import json
import subprocess

import pandas as pd
import pytest
from typer.testing import CliRunner

from experiments.cli import app
from ssac.errors import SsacError, WriteError
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
    content = json.loads(whole.with_suffix(".provenance.json").read_text())
    assert content["config"]["grid"]["flights"] == 3
    assert content["gl"]["backend"] in ("osmesa", "egl")
    assert {"commit", "versions", "wall_time_s", "command"} <= set(content)


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
    assert (folder / "merged_cells.csv").read_bytes() == (folder / "whole_cells.csv").read_bytes()


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


def test_a_sweep_on_a_full_disk_is_one_error_and_goes_on_where_there_is_room(
    folder, config, whole, disk
):
    out, cache = disk / "full.csv", without_runs(disk, "cache", folder / "cache")
    (disk / "filled").write_bytes(bytes(60 * 1024))
    with pytest.raises(WriteError, match=str(disk)):
        sweep(config, out, cache, "--workers", "1")
    (disk / "filled").unlink()
    subprocess.run(["mount", "-o", "remount,size=64m", str(disk)], check=True)
    assert sweep(config, out, cache, "--workers", "1").exit_code == 0
    assert out.read_bytes() == whole.read_bytes()
    assert not list(disk.rglob(".*"))


def test_a_damaged_mesh_in_a_grid_is_an_error_before_any_work(config, tmp_path):
    mesh, grid = tmp_path / "drone.obj", tmp_path / "grid.toml"
    mesh.write_text("v 0 0\nf 1 2 3\n", encoding="utf-8")
    fixed = f"[fixed]\nsim.drone_file = {str(mesh)!r}\n"
    grid.write_text(config.read_text().replace("[fixed]\n", fixed), encoding="utf-8")
    with pytest.raises(SsacError, match=mesh.name):
        sweep(grid, tmp_path / "out.csv", tmp_path / "cache", "--workers", "1")
    assert {path.name for path in tmp_path.iterdir()} == {mesh.name, grid.name}
