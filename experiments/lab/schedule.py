"""The scheduler that spreads cells over processes or a cluster; a stopped run can be resumed.

Cells that share a recording are one task: the recording is loaded once, and each row is cached at
once. Runs that share a cache, on one host or several, share the work: each task is claimed before
it begins, and a task that is claimed elsewhere is tried again until its claim is released.
"""

import hashlib
import re
import resource
import sys
import tempfile
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, field, fields
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np
import pandas as pd
from threadpoolctl import threadpool_limits

from experiments.lab.cache import ASK_AGAIN_S, Cache, claimed, recording_key, run_key
from experiments.lab.cell import CRASHED, UNUSABLE, Flight, Measure, PlainCell, Rows
from experiments.lab.code import code_of
from experiments.lab.pool import Cluster, DiedError, Pool, Processes, in_new_process, n_cores
from experiments.lab.scored import SCORED
from ssac.cli.progress import progress, say
from ssac.errors import SsacError, WriteError
from ssac.files.whole_file import check_folder

MAX_DEATHS = 2
"""Number of workers that die on one task before its runs count as crashed. One death may be due to
other processes, as when memory is short."""

Result = TypeVar("Result")

Task = tuple[PlainCell, ...]  # all cells that are measured on the same recordings


def tasks_of(cells: Sequence[PlainCell]) -> list[Task]:
    """Group cells by recordings, in the order in which these first appear."""
    groups: dict[tuple[Flight, ...], list[PlainCell]] = {}
    for cell in cells:
        groups.setdefault(cell.recordings, []).append(cell)
    return [tuple(group) for group in groups.values()]


def keys_of(task: Task, measure: Measure) -> list[str]:
    """Return the cache keys of a task's cells."""
    recordings = tuple(recording_key(*recording) for recording in task[0].recordings)
    of_measure = (measure.load, measure.row, measure.row_type)
    return [run_key(recordings, cell.inputs, code_of(*of_measure, type(cell))) for cell in task]


def recordings_key(task: Task) -> str:
    """Return a key of a task's recordings, else of its cells' inputs; no measure enters it."""
    keys = " ".join(recording_key(*recording) for recording in task[0].recordings)
    keys = keys or repr([cell.inputs for cell in task])
    return hashlib.sha256(keys.encode()).hexdigest()[:24]


class Done(NamedTuple):
    """A task's rows, with the work and memory that they took."""

    rows: Rows  # one for each cell: the fields of the measure's `row_type`
    n_simulated: int  # recordings that were not in the cache before
    peak_mb: float  # peak memory of this process so far


@dataclass(frozen=True)
class Workers:
    """The processes that do the work."""

    processes: int = -1  # on this machine; -1: one for each core; 1: this process does it itself
    scheduler: str = ""  # address of a Dask scheduler, whose workers do it instead


@dataclass(frozen=True)
class Outcome:
    """The rows of all cells, with the work and memory that they took."""

    runs: pd.DataFrame  # a row for each cell, in order: its columns, then measured values
    n_recordings: int  # tasks with work left to do
    n_simulated: int  # recordings simulated for them; the others were in the cache
    peak_mb: float  # of the largest worker; 0 when there was nothing left to do
    n_deaths: int = 0  # of workers of this machine, which were replaced


def run_cells(
    cells: Sequence[PlainCell],
    cache: Cache,
    workers: Workers,
    label: str = "recordings",
    show_progress: bool = True,
    measure: Measure = SCORED,
) -> Outcome:
    """Run all cells that the cache does not hold, and return the rows of all cells.

    Rows depend neither on the number of workers, nor on what was in the cache, nor on other runs
    that fill it. A run that crashed is a row with its reason and is not kept: the next call tries
    it again. When a worker dies, a new one runs its task again, until `MAX_DEATHS` have died on it.
    """
    cache = Cache(cache.folder.resolve())  # absolute, for workers elsewhere
    work = _Work(tasks_of(cells), cache, measure)
    keys = [keys_of(task, measure) for task in work.tasks]  # the GL driver is part of them
    found: dict[int, Rows] = {}
    for index, some in enumerate(keys):
        rows = [row for row in map(cache.load_run, some) if row is not None]
        if len(rows) == len(some):
            found[index] = rows
    # The longest flights first, so that no worker is left alone with a long flight at the end.
    left = sorted(
        (index for index in range(len(keys)) if index not in found),
        key=lambda index: -sum(sim.spline.duration_s for sim, _ in work.tasks[index][0].recordings),
    )
    n_simulated, peak_mb = 0, 0.0
    if left:
        check_folder(cache.folder)
    cache.tidy()
    try:
        with (
            progress(len(left), label, is_shown=show_progress) as advance,
            _pool(workers, len(left)) as pool,
        ):
            for n_done, (index, done) in enumerate(work.spread(left, pool), 1):
                found[index] = done.rows
                for key, row in zip(keys[index], done.rows, strict=True):
                    if row["status"] not in (CRASHED, UNUSABLE):  # it may have failed to read
                        cache.save_run(key, row)  # a worker elsewhere has a folder of its own
                n_simulated += done.n_simulated
                peak_mb = max(peak_mb, done.peak_mb)
                advance(n_done)
    except (KeyboardInterrupt, SystemExit, WriteError):
        say(
            f"stopped: {len(found)} of {len(keys)} recordings are done and kept in {cache.folder};"
            " the same command goes on from there"
        )
        raise
    finally:
        cache.tidy()
    by_cell = {
        id(cell): row
        for index, task in enumerate(work.tasks)
        for cell, row in zip(task, found[index], strict=True)
    }
    runs = _frame(cells, [by_cell[id(cell)] for cell in cells], measure)
    return Outcome(runs, len(left), n_simulated, peak_mb, work.deaths.total())


def _pool(workers: Workers, n_tasks: int) -> Pool:
    if n_tasks == 0 or (workers.processes == 1 and not workers.scheduler):
        return Pool()
    if workers.scheduler:
        return Cluster(workers.scheduler)
    return Processes(n_cores() if workers.processes == -1 else workers.processes)


@dataclass(frozen=True)
class _Work:
    """The tasks of a run, with their cache and measure."""

    tasks: Sequence[Task]
    cache: Cache
    measure: Measure
    deaths: Counter[int] = field(default_factory=Counter)  # of workers, by task

    def spread(self, left: Sequence[int], pool: Pool) -> Iterator[tuple[int, Done]]:
        """Yield the index and the result of each task, in the order in which tasks end."""
        ready, later = deque(left), deque[tuple[float, int]]()  # (time [s], index)
        running: dict[Future[Any], int] = {}
        has_said = False
        while ready or later or running:
            now_s = time.monotonic()
            while later and later[0][0] <= now_s:
                ready.append(later.popleft()[1])
            while ready and len(running) < pool.room:
                index = ready.popleft()
                job = partial(_claimed, self.tasks[index], self.cache, self.measure)
                running[pool.submit(job)] = index
            wait_s = later[0][0] - now_s if later and len(running) < pool.room else None
            if not running:
                if not has_said:
                    say(f"waiting for what another run is on: {len(later)} recordings")
                    has_said = True
                time.sleep(wait_s or 0.0)
                continue
            for future in pool.ended(running, wait_s):
                index, error = running.pop(future), future.exception()
                if isinstance(error, DiedError):
                    error = self._after_death(index, error)
                    if error is None:
                        ready.append(index)  # at the end, when memory may suffice
                        continue
                if isinstance(error, WriteError):
                    raise error
                if error is not None:
                    yield index, self._crashed(index, error)
                elif future.result() is None:
                    later.append((time.monotonic() + ASK_AGAIN_S, index))
                else:
                    yield index, future.result()

    def _after_death(self, index: int, error: DiedError) -> DiedError | None:
        """Say that a worker died; None if its task is to be tried again."""
        self.deaths[index] += 1
        is_last = self.deaths[index] == MAX_DEATHS
        first = self.tasks[index][0]
        flights = " and ".join(
            f"{sim.spline.duration_s:g} s at {sim.angle_deg:g} deg with seed {seed}"
            for sim, seed in first.recordings
        )
        where = f"the flight of {flights}" if flights else name_of(first)
        what = "given up" if is_last else "run again by a new one"
        say(f"a worker {error} on {where}, which is {what}")
        if not is_last:
            return None
        return DiedError(f"{MAX_DEATHS} workers died of it, the last one {error}")

    def _crashed(self, index: int, error: BaseException) -> Done:
        """Return the rows of a failed task: the cached ones, and crashed ones for other cells."""
        crashed = refusal(self.measure, error, "worker") | {"status": CRASHED}
        known = [self.cache.load_run(key) for key in keys_of(self.tasks[index], self.measure)]
        return Done([crashed if row is None else row for row in known], 0, 0.0)


def _claimed(task: Task, cache: Cache, measure: Measure) -> Done | None:
    """Run a task; None if another run that shares the cache works on its recordings."""
    with claimed(cache.claim_of_runs(recordings_key(task))) as is_ours:
        return run_task(task, cache, measure) if is_ours else None


def run_task(task: Task, cache: Cache, measure: Measure) -> Done:
    """Measure the cells of a task that the cache does not hold yet, and cache each row at once.

    Errors of a cell become its row; WriteError if the cache cannot be written to.
    """
    with threadpool_limits(1):  # one core per worker; sums in one order everywhere
        n_before = len(cache.simulated)
        rows = _rows(task, cache, measure)
    return Done(rows, len(cache.simulated) - n_before, peak_memory_mb())


def timed(work: Callable[[], Result]) -> tuple[Result, float, float, float]:
    """Return a result, its wall and processor time [s], and the peak memory so far [MB]."""
    wall_s, cpu_s = time.perf_counter(), time.process_time()
    result = work()
    return result, time.perf_counter() - wall_s, time.process_time() - cpu_s, peak_memory_mb()


def peak_memory_mb() -> float:
    """Return the peak resident memory of this process [MB]."""
    status = Path("/proc/self/status")  # of Linux, whose rusage has the parent's peak as well
    if status.exists() and (own := re.search(r"VmHWM:\s+(\d+) kB", status.read_text())):
        return int(own[1]) * 1024 / 1e6
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 1e6


def _rows(task: Task, cache: Cache, measure: Measure) -> Rows:
    found: list[dict[str, Any] | None] = [None] * len(task)
    try:
        keys = keys_of(task, measure)
        found = [cache.load_run(key) for key in keys]
        missing = [cell for cell, row in zip(task, found, strict=True) if row is None]
        loaded = measure.load(missing, cache) if missing else None
    except WriteError:  # nor can other rows be written
        raise
    except Exception as error:  # any: the rows say so, and other recordings go on
        failed = refusal(measure, error, "recording")
        return [failed if row is None else row for row in found]
    rows = []
    for key, cell, row in zip(keys, task, found, strict=True):
        if row is None:
            row = measured(cell, measure, lambda: loaded)
            if row["status"] != CRASHED:
                cache.save_run(key, row)
        rows.append(row)
    return rows


def measured(cell: PlainCell, measure: Measure, load: Callable[[], Any]) -> dict[str, Any]:
    """Measure a cell on what `load` returns; an error becomes a row too."""
    try:
        return plain(measure.row(cell, load()))
    except WriteError:  # of a recording for which there is no room
        raise
    except Exception as error:  # any: the row says so
        return refusal(measure, error, name_of(cell))


def refusal(measure: Measure, error: BaseException, where: str) -> dict[str, Any]:
    """Return the row of a cell that could not be measured: UNUSABLE or CRASHED."""
    text = " ".join(str(error).split())
    if isinstance(error, SsacError):
        return plain(measure.row_type(UNUSABLE, text))
    return plain(measure.row_type(CRASHED, f"{where}: {type(error).__name__}: {text}"))


def plain(row: Any) -> dict[str, Any]:
    """Convert a row to a dictionary that JSON holds exactly, with None for NaN."""
    return {
        name: None if isinstance(value, float) and np.isnan(value) else value
        for name, value in vars(row).items()
    }


def name_of(cell: PlainCell) -> str:
    """Name a cell in a reason by its last column, which tells it from the others of its task."""
    return str(list(cell.columns.values())[-1])


def _frame(cells: Sequence[PlainCell], rows: Rows, measure: Measure) -> pd.DataFrame:
    pairs = zip(cells, rows, strict=True)
    if not cells:
        return pd.DataFrame(columns=[one.name for one in fields(measure.row_type)])
    frame = pd.DataFrame([{**cell.columns, **row} for cell, row in pairs])
    unknown = [one.name for one in fields(measure.row_type) if one.default != one.default]  # NaN
    return frame.astype(dict.fromkeys(unknown, float))


def run_alone(cells: Sequence[PlainCell], measure: Measure, label: str) -> Outcome:
    """Measure cells one after the other, each in a process of its own; no row is kept.

    All cells share one temporary cache, so that a cell may use what earlier cells have made. If a
    process dies, the row of its cell says so.
    """
    rows = []
    with tempfile.TemporaryDirectory(prefix="ssac-alone-") as folder:
        for number, cell in enumerate(cells, 1):
            say(f"{label}: {number} of {len(cells)}")
            try:
                rows.append(in_new_process(partial(_alone, cell, Cache(Path(folder)), measure)))
            except DiedError as error:
                rows.append(refusal(measure, SsacError(f"its process {error}"), name_of(cell)))
    return Outcome(_frame(cells, rows, measure), len(cells), 0, 0.0)


def _alone(cell: PlainCell, cache: Cache, measure: Measure) -> dict[str, Any]:
    with threadpool_limits(1):  # one core
        return measured(cell, measure, lambda: measure.load([cell], cache))
