"""Nothing in, numba's kernels compiled into its cache: the last step of `make setup`.

LLVM keeps some 200 MB in each process that compiles. Workers that find the kernels in the cache
stay below 1 GB, and every command starts at once.
"""

import tempfile
from dataclasses import replace
from pathlib import Path

from experiments.lab.cache import Cache
from experiments.lab.grid import Cell
from experiments.lab.recorded import recorded_pair
from experiments.lab.scored import SCORED
from experiments.lab.task import Task, run_task
from sim.recording import SimConfig
from sim.sensor.events import PRESETS
from ssac.cli.progress import progress
from ssac.config import Config
from ssac.pipeline.chain import Chain
from ssac.pipeline.many import solve_pairs
from ssac.pipeline.registry import OURS


def warm_up_tasks() -> list[Task]:
    """Short flights, with every kind of noise and without, each through one method of ours."""
    spline = replace(SimConfig().spline, duration_s=2.0)
    estimator = Config(interval_s=(-0.1, 0.1))
    tasks: list[Task] = []
    for sensor in PRESETS.values():
        sim = SimConfig(spline=spline, sensor=sensor)
        cells = (Cell(sim, 0, 0, 0.0, estimator, method.name, {}) for method in OURS)
        tasks.extend(Task((cell,)) for cell in cells)
    return tasks


def find_path(task: Task, cache: Cache) -> None:
    """Search all offsets of a task's recording, and place its cameras and the path as of many."""
    cam1, cam2, rig = recorded_pair(cache, *task.recordings[0])
    chain = Chain((cam1, cam2), rig, Config(search="all"))
    solve_pairs(chain, {(0, 1): chain.answer()})


def main() -> None:
    """Run them in a folder of their own."""
    tasks = warm_up_tasks()
    with tempfile.TemporaryDirectory() as folder, progress(len(tasks) + 1, "kernels") as advance:
        cache = Cache(Path(folder))
        for n_done, task in enumerate(tasks, 1):
            run_task(task, cache, SCORED)
            advance(n_done)
        find_path(tasks[-1], cache)
        advance(len(tasks) + 1)


if __name__ == "__main__":
    main()
