"""Cells spread over processes or a cluster, and taken up again where they stopped.

Runs that share a cache, on one host or several, share the work: each task is claimed before it is
begun, and one that is claimed elsewhere comes last, when its rows are in the cache.
"""

import math
import time
from collections import Counter, deque
from collections.abc import Iterator, Sequence, Sized
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import pandas as pd

from experiments.lab.cache import Cache
from experiments.lab.cell import CRASHED, AnyCell, Measure, Rows
from experiments.lab.cluster import Cluster
from experiments.lab.lock import ASK_AGAIN_S, claimed
from experiments.lab.pool import Alone, DiedError, Job, Pool, Processes, n_cores
from experiments.lab.scored import SCORED
from experiments.lab.task import Done, Task, keys_of, recordings_key, refusal, run_task, tasks_of
from ssac.cli.progress import progress, say
from ssac.errors import WriteError
from ssac.files.whole_file import check_folder

MAX_DEATHS = 2
"""So many workers may die on one task; then its runs have crashed. One may have been killed for
what others took, as when memory is short."""


@dataclass(frozen=True)
class Workers:
    """Who does the work."""

    processes: int = -1  # on this machine; -1: one for each core; 1: this process does it itself
    scheduler: str = ""  # address of a Dask scheduler, whose workers do it instead


@dataclass(frozen=True)
class Outcome:
    """All rows of some cells, and how they came about."""

    runs: pd.DataFrame  # one row for each cell, in their order: its columns, then what was measured
    n_recordings: int  # that work was left for
    n_simulated: int  # of these: the others were in the cache
    peak_mb: float  # of the largest worker; 0 when there was nothing left to do
    n_deaths: int = 0  # of workers of this machine, which were replaced

    @property
    def n_crashed(self) -> int:
        """Number of runs that crashed."""
        return int((self.runs["status"] == CRASHED).sum())


def run_cells(
    cells: Sequence[AnyCell],
    cache: Cache,
    workers: Workers | None = None,
    label: str = "recordings",
    show_progress: bool = True,
    measure: Measure = SCORED,
) -> Outcome:
    """Run all cells that the cache does not hold, and collect the rows of all.

    Rows depend neither on the number of workers nor on what was in the cache, nor on who else is
    filling it. A run that crashed is a row with its reason and is not kept, so the next call tries
    it again. When a worker dies, what it was on is run again by a new one, `MAX_DEATHS` times.

    Without `workers` there is one process for each core. SsacError if there is no scheduler at the
    address given, or it loses all its workers, or the cache cannot be written to.
    """
    workers = workers or Workers()
    tasks = tasks_of(cells)
    cache = Cache(cache.folder.resolve())  # the same for workers with another working directory
    keys = [keys_of(task, measure) for task in tasks]  # the machine's GL driver is part of them
    found: dict[int, Rows] = {}
    left: list[int] = []
    for index, task in enumerate(tasks):
        known = [cache.load_run(key) for key in keys[index]]
        rows = [row for row in known if row is not None]
        if len(rows) == len(task.cells):
            found[index] = rows
        else:
            left.append(index)
    # The longest first, so that no worker is left alone with one at the end.
    left.sort(key=lambda index: (-tasks[index].cost_s, index))
    n_simulated, peak_mb = 0, 0.0
    work = _Work(tasks, cache, measure)
    bar = progress(len(left), label, is_shown=show_progress)
    if left:
        check_folder(cache.folder)
    with (
        _resumable(found, tasks, cache),
        bar as advance,
        cache.tidied(),
        _pool(workers, len(left)) as pool,
    ):
        for n_done, (index, done) in enumerate(_spread(work, left, pool), 1):
            found[index] = done.rows
            for key, row in zip(keys[index], done.rows, strict=True):
                if row["status"] != CRASHED:
                    cache.save_run(key, row)  # a worker elsewhere has a folder of its own
            n_simulated += done.n_simulated
            peak_mb = max(peak_mb, done.peak_mb)
            advance(n_done)
    runs = frame_of(cells, tasks, found, measure)
    return Outcome(runs, len(left), n_simulated, peak_mb, work.deaths.total())


@contextmanager
def _resumable(found: Sized, tasks: Sized, cache: Cache) -> Iterator[None]:
    """Say how to go on when the block is interrupted or terminated."""
    try:
        yield
    except (KeyboardInterrupt, SystemExit, WriteError):
        say(
            f"stopped: {len(found)} of {len(tasks)} recordings are done and kept in {cache.folder};"
            " the same command goes on from there"
        )
        raise


@dataclass(frozen=True)
class _Work:
    """What is to be done, and how."""

    tasks: Sequence[Task]
    cache: Cache
    measure: Measure
    deaths: Counter[int] = field(default_factory=Counter)  # of workers, by task

    def job(self, index: int) -> Job:
        """Give what is to be done for a task."""
        task = self.tasks[index]
        claim = self.cache.claim_of_runs(recordings_key(task))
        return partial(_claimed, claim, task, self.cache, self.measure)


def _pool(workers: Workers, n_tasks: int) -> Pool:
    """Gather who does the work."""
    if n_tasks == 0 or (workers.processes == 1 and not workers.scheduler):
        return Alone()
    if workers.scheduler:
        return Cluster(workers.scheduler)
    return Processes(n_cores() if workers.processes == -1 else workers.processes)


def _spread(work: _Work, left: Sequence[int], pool: Pool) -> Iterator[tuple[int, Done]]:
    """Yield each task's index and what it gave, in the order in which they are done."""
    ready = deque(left)
    later: deque[tuple[float, int]] = deque()  # when, on our clock [s], and what
    n_given, has_said = 0, False
    while ready or later or n_given:
        now_s = time.monotonic()
        while later and later[0][0] <= now_s:
            ready.append(later.popleft()[1])
        while ready and pool.has_room():
            index = ready.popleft()
            pool.give(index, work.job(index))
            n_given += 1
        wait_s = later[0][0] - now_s if later and pool.has_room() else None
        if not n_given:
            if not has_said:
                say(f"waiting for what another run is on: {len(later)} recordings")
                has_said = True
            time.sleep(wait_s or 0.0)
            continue
        for index, value, error in pool.ended(wait_s):
            n_given -= 1
            if isinstance(error, WriteError):
                raise error
            if isinstance(error, DiedError):
                work.deaths[index] += 1
                is_last = work.deaths[index] == MAX_DEATHS
                say(f"a worker {error} on {_name(work.tasks[index])}, which is "
                     f"{'given up' if is_last else 'run again by a new one'}")  # fmt: skip
                if not is_last:
                    ready.append(index)  # behind the others: what was too much may fit then
                    continue
                error = DiedError(f"{MAX_DEATHS} workers died of it, the last one {error}")
            if error is not None:
                yield index, _crashed(work, index, error)
            elif value is None:
                later.append((time.monotonic() + ASK_AGAIN_S, index))
            else:
                yield index, value


def _claimed(claim: Path, task: Task, cache: Cache, measure: Measure) -> Done | None:
    """Run a task, unless another run that shares the cache is on these recordings: then None."""
    with claimed(claim) as is_ours:
        return run_task(task, cache, measure) if is_ours else None


def _crashed(work: _Work, index: int, error: Exception) -> Done:
    """Make the rows of a task that ended without: those that it kept before are good."""
    crashed = refusal(work.measure, error, "worker") | {"status": CRASHED}
    known = [work.cache.load_run(key) for key in keys_of(work.tasks[index], work.measure)]
    return Done([crashed if row is None else row for row in known], 0, 0.0)


def _name(task: Task) -> str:
    """Tell a task's flights from others, for a reader."""
    flights = (f"{sim.spline.duration_s:g} s at {sim.angle_deg:g} deg with seed {seed}"
               for sim, seed in task.recordings)  # fmt: skip
    return "the flight of " + " and ".join(flights)


def frame_of(
    cells: Sequence[AnyCell], tasks: Sequence[Task], found: dict[int, Rows], measure: Measure
) -> pd.DataFrame:
    """Put the rows in the order of the cells, and each cell's columns before its row."""
    rows = {
        id(cell): row
        for index, task in enumerate(tasks)
        for cell, row in zip(task.cells, found[index], strict=True)
    }
    frame: pd.DataFrame = pd.DataFrame([{**cell.columns, **rows[id(cell)]} for cell in cells])
    for name, value in vars(measure.row_type("")).items():
        if isinstance(value, float) and math.isnan(value):
            frame[name] = frame[name].astype(float)
    return frame
