"""Speed and memory, as ratios side by side in one run: `ssac bench`.

Each part runs in a process of its own on one core (the tables: on two), so that none sees another's
memory and both GL backends can be compared.
"""

import json
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Annotated

import numpy as np
import pandas as pd
import typer
from numpy.typing import NDArray

from experiments.bench.growth import (
    DEFAULT,
    Extent,
    bench_command_line,
    bench_config,
    growth_rows,
    measure_growth,
    points_of,
)
from experiments.bench.measurement import Measurement, best_rate, peak_memory_mb
from experiments.bench.process import in_own_process
from experiments.bench.reading import bench_reading
from experiments.bench.recording import bench_recording
from experiments.bench.sensor import bench_sensor
from experiments.bench.sync import bench_sync
from experiments.bench.tables import bench_tables
from experiments.drawing.growth import growth_figure
from experiments.lab.files import read_table, record_checksums, save_csv, save_png
from experiments.lab.provenance import save_provenance
from sim.recording import SimConfig
from sim.render.config import RenderConfig
from sim.render.gl_context import BACKENDS, open_context
from sim.render.gl_reference import PyrenderFullFrame
from sim.render.lattice import Lattice
from sim.render.renderer import Renderer
from sim.scene.background import uniform_background
from sim.scene.flyers import quadrotor
from sim.scene.rig import two_view_rig
from sim.scene.trajectory import SplineConfig, random_spline
from ssac.errors import SsacError
from ssac.files.whole_file import check_target

_NATIVE = "native"
LATTICES = (SimConfig().render.lattice, Lattice(8, 0), Lattice(8, 1), Lattice(4, 0))
REPEATS = 3  # the best of as many is taken
N_POSES = 4000  # of our renderer
N_FULL_FRAMES = 24  # of pyrender's, on poses spread over the same flight


def bench_command(
    out: Annotated[Path, typer.Option(help="CSV to write.", metavar="FILE")] = Path(
        "results/bench.csv"
    ),
    growth: Annotated[
        Extent,
        typer.Option(help="Largest pair: 50 million events per camera (full), or 10 (short)."),
    ] = DEFAULT,
) -> None:
    """Measure speed and memory, each on one core, and write them with their marks."""
    check_target(out, ())  # half an hour of measuring would be lost
    start = time.perf_counter()
    rows: list[Measurement] = []
    for part in PARTS:
        typer.echo(f"measuring {part} ...", err=True)
        rows += _in_own_process(part)
    grown = measure_growth(points_of(growth), lambda line: typer.echo(line, err=True))
    rows += growth_rows(grown)
    table = pd.DataFrame([asdict(row) | {"verdict": row.verdict} for row in rows])
    made = _save(table, grown, out)
    for path in made:
        if path.suffix == ".csv":
            wall_time_s = time.perf_counter() - start
            command, config = bench_command_line(growth), bench_config(growth)
            save_provenance(path, command, config, wall_time_s, open_context())
    record_checksums(out.parent, made)
    columns = ["name", "value", "unit", "mark", "verdict"]
    typer.echo(table[columns].to_string(index=False, float_format=lambda value: f"{value:.4g}"))


def _save(table: pd.DataFrame, grown: pd.DataFrame, out: Path) -> list[Path]:
    """Write the benchmark, and beside it how it grows, as numbers and drawn from these."""
    growth_csv = out.with_name(f"{out.stem}_growth.csv")
    growth_png = growth_csv.with_suffix(".png")
    save_csv(out, table)
    save_csv(growth_csv, grown)
    save_png(growth_figure(read_table(growth_csv.read_text(encoding="utf-8"))), growth_png)
    return [out, growth_csv, growth_png]


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

            return best_rate(crops, REPEATS)

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

        theirs_per_s = best_rate(theirs, REPEATS)
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
            untouched_per_s = best_rate(untouched, REPEATS)
            rows += [
                Measurement(f"{label}: pyrender untouched", untouched_per_s, "poses/s"),
                Measurement(f"{label}: ratio to it", ours_per_s / untouched_per_s, "x", 50.0, True),
            ]
        if is_default:
            rows.append(Measurement(f"{label}: peak memory", peak_memory_mb(), "MB"))
    return rows


PARTS: dict[str, Callable[[], list[Measurement]]] = {
    **{f"render-{by}": partial(bench_render, by) for by in (_NATIVE, *BACKENDS)},
    "sensor": bench_sensor,
    "recording": bench_recording,
    "sync": bench_sync,
    "reading": bench_reading,
    "tables": bench_tables,  # which has two workers
}

MODULES = {"recording": "experiments.bench.recording"}
"""Parts that are run without loading what the others need."""


def _in_own_process(part: str) -> list[Measurement]:
    """Measure one part; where it fails, a row says so."""
    try:
        rows = in_own_process(MODULES.get(part, "experiments.bench.bench"), part)
    except SsacError as error:
        typer.echo(f"{part} could not be measured: {error}", err=True)
        return [Measurement(f"{part}: not measured ({error})", float("nan"), "")]
    return [Measurement(**row) for row in rows]


if __name__ == "__main__":
    print(json.dumps([asdict(row) for row in PARTS[sys.argv[1]]()]))
