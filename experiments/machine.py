"""The benchmark's measurements, each made in a process of its own so that peak memory is its own.

The parts compare times and memory side by side. The growth is measured with ever longer flights and
two sensor sizes. Each of its points is a real flight of the default drone: `sim` records the pair
with its frames to disk, then `ssac sync` reads it and finds offset and pose by its default method.
The larger sensor has a longer lens, so that 20 s make 9 million events a camera, and 120 s 55
million. Each step runs on one core, after a smaller one that loads the kernels.
"""

import shutil
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from experiments.lab.cache import Cache
from experiments.lab.cell import Measure, PlainCell, RunRow, load_nothing
from experiments.lab.grid import Cell, GridConfig, named_config
from experiments.lab.schedule import Outcome, Workers, run_cells, timed
from experiments.paper.esim import TABLES, table_cells
from experiments.scenes.simulate import record_with_progress
from sim.recording import SimConfig
from sim.render.config import RenderConfig
from sim.render.renderer import Renderer
from sim.scene.background import uniform_background
from sim.scene.flyers import quadrotor
from sim.scene.rig import two_view_rig
from sim.scene.trajectory import SplineConfig, random_spline
from sim.storage import record
from ssac.arrays import Array
from ssac.camera import Cameras
from ssac.estimate import Estimate
from ssac.pipeline.api import sync
from ssac.pipeline.chain import Chain
from ssac.pipeline.opened import MEANS, Source, opened, opened_rig
from ssac.pipeline.registry import OURS, Input, Method

REPEATS = 5  # the fastest of so many runs counts
N_POSES = 4000

ANGLES_DEG = (30.0, 60.0, 120.0, 150.0)  # an even number, so that two workers end together

Made = TypeVar("Made")


@dataclass(frozen=True)
class Measurement:
    """A measured value, NaN where none was, its unit, and the mark that it is to reach."""

    name: str
    value: float = np.nan
    unit: str = ""
    mark: float = np.nan  # NaN: none, the value is for information
    higher_is_better: bool = False

    @property
    def verdict(self) -> str:
        """Return "meets", "misses", or nothing where there is no mark."""
        if np.isnan(self.mark):
            return ""
        met = self.value >= self.mark if self.higher_is_better else self.value <= self.mark
        return "meets" if met else "misses"


@dataclass(frozen=True)
class PartCell(PlainCell):
    """The cell of one part of the benchmark."""

    part: str


@dataclass(frozen=True)
class PartRow(RunRow):
    """The measurements of one part."""

    measurements: list[dict[str, Any]] = field(default_factory=list)  # fields of each `Measurement`


def part_row(cell: PartCell, _: object) -> PartRow:
    """Run one part of the benchmark."""
    return PartRow("ok", "", [asdict(one) for one in PARTS[cell.part]()])


PART = Measure(load_nothing, part_row, PartRow)


def best_seconds(work: Callable[[], Made]) -> tuple[float, Made]:
    """Return the least processor time [s] of REPEATS runs after a warm-up, and the result."""
    result = work()
    seconds = []
    for _ in range(REPEATS):
        result, _, cpu_s, _ = timed(work)
        seconds.append(cpu_s)
    return min(seconds), result


def bench_rendering() -> list[Measurement]:
    """Measure the crops rendered per second, by the native renderer and by pyrender's OpenGL."""
    camera, drone = two_view_rig(90.0).cameras[0], quadrotor()
    # As dense as adaptive sampling, so that neighbours share their tile size as they do there.
    times_s: Array = np.linspace(0.0, 5.0, N_POSES, dtype=np.float64)
    T_W_B = random_spline(SplineConfig(), np.random.default_rng(0)).poses(times_s)
    background = uniform_background(camera, 0.4)

    def poses_per_s(config: RenderConfig) -> float:
        with Renderer(drone, config) as renderer:
            crops = partial(renderer.crops, camera, times_s, T_W_B, background)
            seconds, n_poses = best_seconds(lambda: sum(len(batch.times_s) for batch in crops()))
        return n_poses / seconds

    native = RenderConfig(check=False)
    ours, theirs = poses_per_s(native), poses_per_s(RenderConfig(renderer="pyrender"))
    label = f"render, native, {native.lattice.samples_per_pixel} samples per pixel"
    return [
        Measurement(f"{label}: crops", ours, "poses/s"),
        Measurement(f"{label}: ratio to OpenGL's crops", ours / theirs, "x", 5.0, True),
    ]


def bench_recording() -> list[Measurement]:
    """Measure wall time and peak memory of the default 20 s pair, with frames and writing."""
    short = SimConfig(spline=SplineConfig(duration_s=1.0))
    with tempfile.TemporaryDirectory() as folder:
        record_with_progress(short, 0, Path(folder) / "short")  # loads the kernels
        pair = partial(record_with_progress, SimConfig(), 0, Path(folder) / "pair")
        _, seconds, _, peak_mb = timed(pair)
    return [
        Measurement("simulate a 20 s pair, frames included", seconds, "s"),
        Measurement("simulate a 20 s pair: peak memory", peak_mb, "MB", 450.0),
    ]


def bench_sync(config: SimConfig | None = None) -> list[Measurement]:
    """Measure each method's processor time on one pair, by default of 20 s, already read."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "pair"
        record(config or SimConfig(t_d_s=0.05), 0, folder, {})
        rig = opened_rig(folder / "rig_extrinsics.yaml", 2)
        files = opened((folder / "cam1.h5", folder / "cam2.h5"), rig)
        return [_timed(method, files, rig) for method in OURS]


def _timed(method: Method, files: Sequence[Source], rig: Cameras) -> Measurement:
    seen = [file.read(MEANS if method.input is Input.FRAMES else "") for file in files]
    seconds, _ = best_seconds(lambda: Chain(seen, rig).estimate(method))
    return Measurement(f"sync, {method.name}: all but reading", seconds, "s")


def bench_tables() -> list[Measurement]:
    """Measure the wall time of 8 recordings, all methods and offsets, by one worker and by two.

    The time of all recordings is extrapolated in proportion. The start-up of some seconds per run
    is not included: each worker has done a small flight before.
    """
    cells = measured_cells()
    n_measured, n_all = (  # an offset has no recording of its own
        len({(cell.sim, cell.seed) for cell in some}) for some in (cells, table_cells())
    )
    # Small flights, one per worker, load the code and its kernels.
    small = replace(named_config(TABLES[0]), fixed={"sim.spline.duration_s": 2.0})
    seconds: dict[tuple[str, int], float] = {}
    peak_mb = 0.0
    with tempfile.TemporaryDirectory() as folder:
        for count in (1, 2):
            cache = Cache(Path(folder) / f"by_{count}")
            warm_up = _cells(replace(small, flights=count))
            _run(warm_up, Cache(Path(folder) / f"warm_{count}"), count)
            seconds["from nothing", count], outcome = _run(cells, cache, count)
            peak_mb = max(peak_mb, outcome.peak_mb)
            shutil.rmtree(cache.folder / "runs")
            seconds["recordings cached", count], _ = _run(cells, Cache(cache.folder), count)
    rows = []
    for what in ("from nothing", "recordings cached"):
        one, two = seconds[what, 1] / n_measured, seconds[what, 2] / n_measured
        rows += [
            Measurement(f"tables, {what}: 1 worker", one, "s per recording"),
            Measurement(f"tables, {what}: 2 workers", two, "s per recording"),
            Measurement(f"tables, {what}: all, 2 workers", two * n_all, "s"),
            Measurement(f"tables, {what}: 1 -> 2 workers", one / two, "x", 1.9, True),
        ]
    return [*rows, Measurement("tables: peak memory of a worker", peak_mb, "MB", 1000.0)]


def measured_cells() -> list[Cell]:
    """List the cells of a few recordings of both tables: as many of 10 s as of 20 s."""
    grids = [replace(named_config(name), flights=1) for name in TABLES]
    return [cell for grid in grids for cell in _cells(grid)]


def _cells(grid: GridConfig) -> list[Cell]:
    return [cell for cell in grid.cells() if cell.sim.angle_deg in ANGLES_DEG]


def _run(cells: Sequence[Cell], cache: Cache, count: int) -> tuple[float, Outcome]:
    run = partial(run_cells, cells, cache, Workers(count), show_progress=False)
    outcome, seconds, *_ = timed(run)
    return seconds, outcome


PARTS: Mapping[str, Callable[[], list[Measurement]]] = {
    "rendering": bench_rendering,
    "recording": bench_recording,
    "sync": bench_sync,
    "tables": bench_tables,  # which starts two workers
}


# --- Growth with the recording ---

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
        recorded, *took = timed(partial(record, cell.point.config, 0, pair, {}))
        return StepRow("ok", "", float(np.mean(recorded.n_events)), *took)
    _sync(smallest)
    estimate, wall_s, cpu_s, peak_mb = timed(partial(_sync, pair))
    if pair != smallest:
        shutil.rmtree(pair)
    error_ms = 1e3 * abs(estimate.t_d_s - T_D_S) if estimate.status == "ok" else np.nan
    return StepRow(str(estimate.status), "", np.nan, wall_s, cpu_s, peak_mb, error_ms)


STEP = Measure(load_nothing, step_row, StepRow)


def _sync(folder: Path) -> Estimate:
    return sync(folder / "cam1.h5", folder / "cam2.h5", folder / "rig.yaml").estimate
