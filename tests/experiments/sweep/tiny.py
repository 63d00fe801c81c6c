"""A tiny grid, and sweeps over it: in this process, or in one that knows a plugin's methods.

The flights are short and coarsely rendered: what is tested is the bookkeeping, not the accuracy.
"""

import os
import subprocess
import sys
from pathlib import Path

from typer.testing import CliRunner

from experiments.cli import app

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

# A plugin whose methods fail in the ways there are; docs/methods.md tells about plugins.
PLUGIN = """
import os
import signal
from dataclasses import replace
from pathlib import Path

from ssac import SsacError
from ssac import event_rate

def raising(cam1, cam2, rig, config=None):
    raise RuntimeError("a bug")

def refusing(cam1, cam2, rig, config=None):
    raise SsacError("not with these data")

def dying_once(cam1, cam2, rig, config=None):
    try:
        Path(__file__).with_name("died").touch(exist_ok=False)
    except FileExistsError:
        return replace(event_rate(cam1, cam2, rig, config), method="dying_once")
    os.kill(os.getpid(), signal.SIGKILL)
"""


def sweep(config, out, cache, *more):
    arguments = ["sweep", str(config), "--out", str(out), "--cache", str(cache), *more]
    return CliRunner().invoke(app, arguments, catch_exceptions=False)


def without_runs(folder: Path, name: str, of: Path | None = None) -> Path:
    """Return a cache with the recordings of another, by default `folder` / cache, but no runs."""
    cache = folder / name
    cache.mkdir()
    (cache / "recordings").symlink_to((of or folder / "cache") / "recordings")
    return cache


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
