"""A few of the tables' recordings in; how their making scales with the workers, out."""

import tempfile
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from experiments.bench.measurement import Measurement
from experiments.paper.grids import TABLES
from experiments.run.cache import Cache
from experiments.run.grid import Cell, named_config
from experiments.run.schedule import Outcome, Workers, run_cells

ANGLE_DEG = 90.0
N_FLIGHTS = 4  # of each duration
N_RECORDINGS = 100  # of the tables
MARK_SCALING = 1.8
MARK_FROM_NOTHING_S = 900.0
MARK_CACHED_S = 60.0
MARK_PEAK_MB = 1000.0


def bench_tables() -> list[Measurement]:
    """Wall time of 8 recordings with all methods and offsets, by one worker and by two.

    Start-up, some seconds once per run, is not in them: each worker has done a small flight before.
    """
    cells = table_cells()
    n_recordings = 2 * N_FLIGHTS
    seconds: dict[tuple[str, int], float] = {}
    peak_mb = 0.0
    with tempfile.TemporaryDirectory() as folder:
        for count in (1, 2):
            cache = Cache(Path(folder) / f"by_{count}")
            _run(_warm_up(count), Cache(Path(folder) / f"warm_{count}"), count)
            seconds["from nothing", count], outcome = _run(cells, cache, count)
            peak_mb = max(peak_mb, outcome.peak_mb)
            without_runs = Cache(Path(folder) / f"cached_{count}")
            without_runs.folder.mkdir()
            for name in ("recordings", "brightness"):
                (cache.folder / name).rename(without_runs.folder / name)
            seconds["recordings cached", count], _ = _run(cells, without_runs, count)
    rows = []
    marks = {"from nothing": MARK_FROM_NOTHING_S, "recordings cached": MARK_CACHED_S}
    for what, mark_s in marks.items():
        one, two = seconds[what, 1], seconds[what, 2]
        whole_s = two * N_RECORDINGS / n_recordings
        rows += [
            Measurement(f"tables, {what}: 1 worker", one / n_recordings, "s per recording"),
            Measurement(f"tables, {what}: 2 workers", two / n_recordings, "s per recording"),
            Measurement(f"tables, {what}: 100 recordings, 2 workers", whole_s, "s", mark_s),
            Measurement(f"tables, {what}: 1 -> 2 workers", one / two, "x",
                        MARK_SCALING if what == "from nothing" else None, True),
        ]  # fmt: skip
    rows.append(Measurement("tables: peak memory of a worker", peak_mb, "MB", MARK_PEAK_MB))
    return rows


def table_cells() -> list[Cell]:
    """List the cells of a few recordings of both tables: as many of 10 s as of 20 s."""
    return [
        cell
        for name in TABLES
        for cell in replace(named_config(name), flights=N_FLIGHTS).cells()
        if cell.sim.angle_deg == ANGLE_DEG
    ]


def _warm_up(count: int) -> list[Cell]:
    """List the cells of small flights, one for each worker, that load the code and its kernels."""
    grid = replace(named_config(TABLES[0]), flights=2 * count)
    short = replace(grid, fixed={"sim.spline.duration_s": 2.0})
    return [cell for cell in short.cells() if cell.sim.angle_deg == ANGLE_DEG]


def _run(cells: Sequence[Cell], cache: Cache, count: int) -> tuple[float, Outcome]:
    start = time.perf_counter()
    outcome = run_cells(cells, cache, Workers(count), show_progress=False)
    return time.perf_counter() - start, outcome
