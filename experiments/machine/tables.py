"""How the making of the tables' recordings scales with the workers, measured on a few of them."""

import tempfile
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from experiments.lab.cache import RECORDED, Cache
from experiments.lab.grid import Cell, GridConfig, named_config
from experiments.lab.schedule import Outcome, Workers, run_cells
from experiments.machine.parts import Measurement
from experiments.paper.esim import TABLES, n_recordings

ANGLES_DEG = (30.0, 60.0, 120.0, 150.0)  # an even number, so that two workers end together
N_FLIGHTS = 1  # of each of these angles and each duration: the first ones
MARK_SCALING = 1.8
MARKS_S = {"from nothing": 2.0, "recordings cached": 0.2}
"""Of a recording, by two workers: 300 of them in 10 minutes, and in one."""
MARK_PEAK_MB = 1000.0


def bench_tables() -> list[Measurement]:
    """Wall time of 8 recordings with all methods and offsets, by one worker and by two.

    That of all recordings is theirs in proportion; it is not measured here. Start-up, some seconds
    once per run, is not in it: each worker has done a small flight before.
    """
    cells = measured_cells()
    n_measured = len({(cell.sim, cell.seed) for cell in cells})
    # Small flights, one for each worker, that load the code and its kernels.
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
            without_runs = Cache(Path(folder) / f"cached_{count}")
            without_runs.folder.mkdir()
            for name in RECORDED:
                (cache.folder / name).rename(without_runs.folder / name)
            seconds["recordings cached", count], _ = _run(cells, without_runs, count)
    n_all = n_recordings()
    rows = [Measurement("tables: recordings", n_all, "recordings")]
    for what, mark_s in MARKS_S.items():
        one, two = seconds[what, 1] / n_measured, seconds[what, 2] / n_measured
        mark_x = MARK_SCALING if what == "from nothing" else None
        rows += [
            Measurement(f"tables, {what}: 1 worker", one, "s per recording"),
            Measurement(f"tables, {what}: 2 workers", two, "s per recording"),
            Measurement(f"tables, {what}: all, 2 workers", two * n_all, "s", mark_s * n_all),
            Measurement(f"tables, {what}: 1 -> 2 workers", one / two, "x", mark_x, True),
        ]
    rows.append(Measurement("tables: peak memory of a worker", peak_mb, "MB", MARK_PEAK_MB))
    return rows


def measured_cells() -> list[Cell]:
    """List the cells of a few recordings of both tables: as many of 10 s as of 20 s."""
    grids = [replace(named_config(name), flights=N_FLIGHTS) for name in TABLES]
    return [cell for grid in grids for cell in _cells(grid)]


def _cells(grid: GridConfig) -> list[Cell]:
    return [cell for cell in grid.cells() if cell.sim.angle_deg in ANGLES_DEG]


def _run(cells: Sequence[Cell], cache: Cache, count: int) -> tuple[float, Outcome]:
    start = time.perf_counter()
    outcome = run_cells(cells, cache, Workers(count), show_progress=False)
    return time.perf_counter() - start, outcome
