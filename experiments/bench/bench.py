"""Speed and memory, as ratios side by side in one run: `ssac bench`.

Each part runs in a process of its own on one core (the tables: on two), so that none sees another's
memory and both GL backends can be compared.
"""

import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pandas as pd
import typer
from numpy.typing import NDArray

from experiments.bench.measurement import Measurement
from experiments.bench.sync import bench_sync
from experiments.bench.tables import bench_tables
from experiments.paper.checksums import record_checksums
from experiments.run.provenance import save_provenance
from sim.recording import SimConfig
from sim.render.config import RenderConfig
from sim.render.gl_context import BACKENDS, open_context
from sim.render.gl_reference import PyrenderFullFrame
from sim.render.lattice import Lattice
from sim.render.renderer import Renderer
from sim.scene.background import uniform_background
from sim.scene.drone import quadrotor
from sim.scene.rig import two_view_rig
from sim.scene.trajectory import SplineConfig, random_spline
from sim.sensor.events import Sensor, SensorConfig
from sim.storage import record
from ssac.files.whole_file import whole_file

_NATIVE = "native"
LATTICES = (SimConfig().render.lattice, Lattice(8, 1), Lattice(4, 0), Lattice(16, 1))
REPEATS = 3  # the best of as many is taken
N_POSES = 4000  # of our renderer
N_FULL_FRAMES = 24  # of pyrender's, on poses spread over the same flight
N_SENSOR_FRAMES = 1000
OBJECT_SPEED_PX_S = 200.0
SENSOR_STEP_PX = 0.2  # between the frames that the sensor model is timed on

# ESIM's C++ core (esim_py) on 346 x 260 frames, one core of a machine like ours.
ESIM_FRAMES_PER_S = 6600.0


def bench_command(
    out: Annotated[Path, typer.Option(help="CSV to write.", metavar="FILE")] = Path(
        "results/bench.csv"
    ),
) -> None:
    """Measure speed and memory, each on one core, and write them with their marks."""
    start = time.perf_counter()
    rows: list[Measurement] = []
    for part in PARTS:
        typer.echo(f"measuring {part} ...", err=True)
        rows += _in_own_process(part)
    table = pd.DataFrame([asdict(row) | {"verdict": row.verdict} for row in rows])
    out.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(out) as temporary:
        table.to_csv(temporary, index=False, float_format="%.6g")
    save_provenance(out, "ssac bench", {}, time.perf_counter() - start, open_context())
    record_checksums(out.parent, [out])
    columns = ["name", "value", "unit", "mark", "verdict"]
    typer.echo(table[columns].to_string(index=False, float_format=lambda value: f"{value:.4g}"))


def bench_render(by: str) -> list[Measurement]:
    """Poses per second of our crops and of pyrender's full frames, with the same samples.

    "Pyrender, our shaders" is pyrender's renderer drawing the same pixels into a framebuffer of one
    channel; "untouched" is pyrender as it comes, which draws 8-bit colour and reads its depth back
    as well. Of the native renderer also the ratio to our own crops by OpenGL.

    Parameters
    ----------
    by
        "native", or the OpenGL backend that draws our crops and pyrender's frames.
    """
    rig = two_view_rig(90.0)
    camera, drone = rig.cameras[0], quadrotor()
    flight = random_spline(SplineConfig(), np.random.default_rng(0))
    # As dense as adaptive sampling is, for neighbours to share their tile size as they do there.
    times_s: NDArray[np.float64] = np.linspace(0.0, 5.0, N_POSES, dtype=np.float64)
    T_W_B = flight.poses(times_s)
    background = uniform_background(camera, 0.4)
    some = range(0, N_POSES, N_POSES // N_FULL_FRAMES)

    def crops_per_s(config: RenderConfig) -> float:
        with Renderer(drone, config) as renderer:

            def crops() -> int:
                batches = renderer.crops(camera, times_s, T_W_B, background)
                return sum(len(batch.times_s) for batch in batches)

            return _best_rate(crops)

    rows = []
    for lattice in LATTICES:
        with_gl = RenderConfig(
            lattice, renderer="pyrender", backend="auto" if by == _NATIVE else by
        )
        native = replace(with_gl, renderer=_NATIVE, check=False)
        ours_per_s = crops_per_s(native if by == _NATIVE else with_gl)
        reference = PyrenderFullFrame(drone, camera, with_gl)

        def theirs(reference: PyrenderFullFrame = reference) -> int:
            for k in some:
                reference.render(float(times_s[k]), T_W_B[k], background)
            return len(some)

        def untouched(reference: PyrenderFullFrame = reference) -> int:
            for k in some:
                reference.stock(float(times_s[k]), T_W_B[k])
            return len(some)

        theirs_per_s = _best_rate(theirs)
        label = f"render, {by}, {lattice.samples_per_pixel} samples per pixel"
        is_default = lattice == SimConfig().render.lattice
        rows += [
            Measurement(f"{label}: crops", ours_per_s, "poses/s"),
            Measurement(f"{label}: pyrender, our shaders", theirs_per_s, "poses/s"),
            Measurement(f"{label}: ratio", ours_per_s / theirs_per_s, "x", 50.0, True),
        ]
        if by == _NATIVE:
            ratio = ours_per_s / crops_per_s(with_gl)
            rows.append(Measurement(f"{label}: ratio to OpenGL's crops", ratio, "x", 4.0, True))
        if lattice.b == 0:  # pyrender itself knows regular grids only
            untouched_per_s = _best_rate(untouched)
            rows += [
                Measurement(f"{label}: pyrender untouched", untouched_per_s, "poses/s"),
                Measurement(f"{label}: ratio to it", ours_per_s / untouched_per_s, "x", 50.0, True),
            ]
        if is_default:
            rows.append(Measurement(f"{label}: peak memory", _peak_memory_mb(), "MB"))
    return rows


def bench_sensor() -> list[Measurement]:
    """Frames and events per second of the sensor model, on full frames and on crops of them."""
    frames, times_s, x0, y0, crops = _moving_object()
    background = frames[0].copy()
    zero = np.zeros(len(times_s) - 1, np.int64)
    n_events = 0

    def run(x: Any, y: Any, luminance: Any) -> int:
        nonlocal n_events
        rng = np.random.default_rng(0)
        sensor = Sensor(SensorConfig(), frames[0], float(times_s[0]), rng, background)
        sensor.feed(times_s[1:], x, y, luminance)
        n_events = len(sensor.finish(float(times_s[-1])))
        return len(times_s) - 1

    full_per_s = _best_rate(lambda: run(zero, zero, frames[1:]))
    events_per_frame = n_events / (len(times_s) - 1)
    crops_per_s = _best_rate(lambda: run(x0[1:], y0[1:], crops[1:]))
    size = f"{frames.shape[2]} x {frames.shape[1]}"
    return [
        Measurement(
            f"sensor, {size} float frames", full_per_s, "frames/s", ESIM_FRAMES_PER_S, True
        ),
        Measurement(f"sensor, {size} float frames", full_per_s * events_per_frame, "events/s"),
        Measurement("sensor, crops that follow the object", crops_per_s, "frames/s"),
        Measurement("sensor, crops: events", crops_per_s * events_per_frame, "events/s"),
        Measurement("sensor, crops / full frames", crops_per_s / full_per_s, "x"),
    ]


def bench_recording() -> list[Measurement]:
    """Wall time and peak memory of the default 20 s pair, frames and writing it included."""
    short = SimConfig(spline=SplineConfig(duration_s=1.0))
    with tempfile.TemporaryDirectory() as folder:
        record(short, 0, Path(folder) / "short", {})  # loads the kernels
        start = time.perf_counter()
        recorded = record(SimConfig(), 0, Path(folder) / "pair", {})
        seconds = time.perf_counter() - start
    instants, events = recorded.flight.n_instants, sum(recorded.n_events)
    return [
        Measurement("simulate a 20 s pair, frames included", seconds, "s", 3.0),
        Measurement("simulate a 20 s pair: instants", instants, "instants"),
        Measurement("simulate a 20 s pair: events", events, "events"),
        Measurement("simulate a 20 s pair: peak memory", _peak_memory_mb(), "MB", 450.0),
    ]


PARTS: dict[str, Callable[[], list[Measurement]]] = {
    **{f"render-{by}": partial(bench_render, by) for by in (_NATIVE, *BACKENDS)},
    "sensor": bench_sensor,
    "recording": bench_recording,
    "sync": bench_sync,
    "tables": bench_tables,  # which has two workers
}


def _in_own_process(part: str) -> list[Measurement]:
    """Run one part on one core in a new process."""
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    environment.pop("PYOPENGL_PLATFORM", None)
    command = [sys.executable, "-m", "experiments.bench.bench", part]
    result = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    if result.returncode != 0:
        last = result.stderr.strip().splitlines()[-1:] or ["no message"]
        typer.echo(f"{part} could not be measured: {last[0]}", err=True)
        return [Measurement(f"{part}: not measured ({last[0]})", float("nan"), "")]
    return [Measurement(**row) for row in json.loads(result.stdout)]


def _best_rate(work: Callable[[], int]) -> float:
    """Return how much work is done per second of processor time, at best, after a warm-up."""
    work()
    rates = []
    for _ in range(REPEATS):
        start = time.process_time()
        done = work()
        rates.append(done / (time.process_time() - start))
    return max(rates)


def _peak_memory_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


def _moving_object() -> tuple[NDArray[np.float32], NDArray[np.float64], Any, Any, Any]:
    """Return frames of the default drone at 200 px/s, their times, and crops of them."""
    rig = two_view_rig(90.0)
    camera, drone = rig.cameras[0], quadrotor()
    n = N_SENSOR_FRAMES
    step_s = SENSOR_STEP_PX / OBJECT_SPEED_PX_S
    times_s: NDArray[np.float64] = np.linspace(0.0, (n - 1) * step_s, n, dtype=np.float64)
    depth_m, focal_px = 5.0, float(camera.K[0, 0])
    T_W_B = np.tile(np.eye(4), (n, 1, 1))
    T_W_B[:, 0, 3] = (np.arange(n) - n / 2) * SENSOR_STEP_PX * depth_m / focal_px
    background = uniform_background(camera, 0.4)
    frames = np.repeat(background[None], n, axis=0)
    x0, y0 = np.zeros(n, np.int64), np.zeros(n, np.int64)
    with Renderer(drone) as renderer:
        batches = list(renderer.crops(camera, times_s, T_W_B, background))
    width = max(batch.luminance.shape[2] for batch in batches)
    height = max(batch.luminance.shape[1] for batch in batches)
    k = 0
    for batch in batches:
        h, w = batch.luminance.shape[1:]
        for x, y, luminance in zip(batch.x0_px, batch.y0_px, batch.luminance, strict=True):
            frames[k, y : y + h, x : x + w] = luminance
            x0[k], y0[k] = min(x, camera.width - width), min(y, camera.height - height)
            k += 1
    crops = np.stack([frames[k, y0[k] : y0[k] + height, x0[k] : x0[k] + width] for k in range(n)])
    return frames, times_s, x0, y0, crops


if __name__ == "__main__":
    print(json.dumps([asdict(row) for row in PARTS[sys.argv[1]]()]))
