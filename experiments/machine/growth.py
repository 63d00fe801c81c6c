"""Time and memory of simulation and synchronisation for ever longer flights and two sensor sizes.

Each point is a real flight of the default drone: `sim` records the pair with its frames to disk,
then `ssac sync` reads it and finds offset and pose by its default method. The larger sensor has a
longer lens, so that 20 s make 9 million events a camera, and 120 s 55 million. Each step runs in a
process of its own on one core, after a smaller one that loads the kernels.
"""

import shutil
import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from experiments.lab.cache import Cache
from experiments.lab.cell import Measure, PlainCell, RunRow, load_nothing
from experiments.lab.schedule import peak_memory_mb
from sim.recording import SimConfig
from sim.storage import record
from ssac.estimate import Status
from ssac.pipeline.api import Result, sync

STEPS = SIMULATE, SYNCHRONISE = "simulate", "synchronise"
T_D_S = 0.05


@dataclass(frozen=True)
class Point:
    """One recording to simulate and to synchronise."""

    width_px: int
    height_px: int
    focal_px: float
    duration_s: float
    events_per_s: float  # approximate, of one camera

    @property
    def sensor(self) -> str:
        """Return the sensor's name: its size in pixels."""
        return f"{self.width_px} x {self.height_px}"

    @property
    def config(self) -> SimConfig:
        """Return the configuration of the simulation."""
        default = SimConfig(t_d_s=T_D_S)
        return replace(
            default,
            resolution=(self.width_px, self.height_px),
            principal_point=(self.width_px / 2, self.height_px / 2),
            focal_px=self.focal_px,
            spline=replace(default.spline, duration_s=self.duration_s),
        )


POINTS = tuple(
    Point(width, height, focal_px, duration_s, rate)
    for width, height, focal_px, rate in ((346, 260, 200.0, 0.05e6), (1280, 720, 440.0, 0.46e6))
    for duration_s in (5.0, 20.0, 60.0, 120.0)
)


@dataclass(frozen=True)
class StepCell(PlainCell):
    """One step of a point; SYNCHRONISE reads the recording that SIMULATE made before."""

    point: Point
    step: str

    @property
    def columns(self) -> dict[str, Any]:
        """Sensor, duration and step."""
        return {"sensor": self.point.sensor, "duration_s": self.point.duration_s, "step": self.step}


@dataclass(frozen=True)
class StepRow(RunRow):
    """Time and memory of a step, and the error of its estimate."""

    events_per_camera: float = np.nan  # mean of both cameras
    wall_s: float = np.nan
    cpu_s: float = np.nan
    peak_mb: float = np.nan
    t_d_error_ms: float = np.nan


def step_row(cell: StepCell, cache: Cache) -> StepRow:
    """Run a step in this process, after a smaller one that loads the kernels."""
    smallest = cache.folder / "smallest"
    pair = smallest if cell.point == POINTS[0] else cache.folder / "pair"
    if cell.step == SIMULATE:
        with tempfile.TemporaryDirectory() as other:
            record(replace(POINTS[0], duration_s=1.0).config, 0, Path(other) / "short", {})
    else:
        _sync(smallest)
    status, n_events, error_ms = str(Status.OK.value), np.nan, np.nan
    wall_s, cpu_s = time.perf_counter(), time.process_time()
    if cell.step == SIMULATE:
        n_events = float(np.mean(record(cell.point.config, 0, pair, {}).n_events))
    else:
        estimate = _sync(pair).estimate
        status = str(estimate.status)
        error_ms = 1e3 * abs(estimate.t_d_s - T_D_S) if status == Status.OK.value else np.nan
    wall_s, cpu_s = time.perf_counter() - wall_s, time.process_time() - cpu_s
    if cell.step == SYNCHRONISE and pair != smallest:
        shutil.rmtree(pair)
    return StepRow(status, "", n_events, wall_s, cpu_s, peak_memory_mb(), error_ms)


STEP = Measure(load_nothing, step_row, StepRow)


def _sync(folder: Path) -> Result:
    return sync(folder / "cam1.h5", folder / "cam2.h5", folder / "rig.yaml")
