"""Compilation of numba's kernels into its cache: the last step of `make setup`.

LLVM keeps some 200 MB in each process that compiles, and each worker would compile on its own.
Workers that find the kernels in the cache stay below 1 GB, and every command starts at once.
"""

import tempfile
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from experiments.lab.cache import Cache
from experiments.lab.cell import Measure
from experiments.lab.grid import Cell
from experiments.lab.recorded import recorded_pair
from experiments.lab.schedule import Task, run_task
from experiments.lab.scored import SCORED
from experiments.worlds.bench import ALL, PHYSICAL, bench_of, cells_of
from sim.recording import SimConfig
from sim.sensor.events import PRESETS
from ssac.cli.progress import progress
from ssac.config import Config
from ssac.errors import SsacError
from ssac.pipeline.many import solve_pairs
from ssac.pipeline.registry import OURS
from ssac.track.faint import faint_object_events

DURATION_S = 2.0


def warm_up_tasks() -> Iterator[tuple[Task, Measure]]:
    """Yield short flights: with each sensor preset, and on the bench with all its effects."""
    spline = replace(SimConfig().spline, duration_s=DURATION_S)
    estimator = Config(interval_s=(-0.1, 0.1))
    for sensor in PRESETS.values():
        sim = SimConfig(spline=spline, sensor=sensor)
        for method in OURS:
            yield (Cell(sim, 0, 0, 0.0, estimator, method.name, {}),), SCORED
    bench = bench_of(ALL, 90.0, DURATION_S, 0)
    # A search will do: so short a flight is refused, and other methods would try all they can.
    yield tuple(cells_of(bench, {}, 0, (0.0,), ("ssac",))), PHYSICAL


def main() -> None:
    """Run the tasks, and searches of all offsets, path and faint object, in a temporary folder."""
    tasks = list(warm_up_tasks())
    with tempfile.TemporaryDirectory() as folder, progress(len(tasks) + 1, "kernels") as advance:
        cache = Cache(Path(folder))
        for n_done, (task, measure) in enumerate(tasks, 1):
            run_task(task, cache, measure)
            advance(n_done)
        (sim, seed), *_ = tasks[0][0][0].recordings
        # Long enough to recognise a rigid body.
        longer = replace(sim, spline=replace(sim.spline, duration_s=2.0 * DURATION_S))
        cam1, _, rig = pair = recorded_pair(cache, longer, seed)
        chain = pair.chain(Config(search="all"))
        solve_pairs(chain, {(0, 1): chain.answer()})
        with suppress(SsacError):  # even if it finds nothing, its kernels are compiled
            faint_object_events(cam1.events, rig.cam1.width, rig.cam1.height)
        advance(len(tasks) + 1)


if __name__ == "__main__":
    main()
