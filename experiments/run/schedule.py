"""Cells in, one row each out: spread over processes or a cluster, resumed where they stopped."""

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import joblib
import pandas as pd
from tqdm import tqdm

from experiments.run.cache import Cache
from experiments.run.scored import SCORED
from experiments.run.task import (
    CRASHED,
    AnyCell,
    Done,
    Measure,
    Rows,
    Task,
    keys_of,
    refusal,
    run_task,
    tasks_of,
)
from ssac.errors import SsacError

WAIT_FOR_WORKERS_S = 60.0  # of a Dask scheduler: they may be on their way


@dataclass(frozen=True)
class Workers:
    """Who does the work."""

    processes: int = -1  # on this machine; -1: one for each core
    scheduler: str = ""  # address of a Dask scheduler, whose workers do it instead

    @property
    def n_jobs(self) -> int | None:
        """For joblib; None leaves it to the scheduler."""
        return None if self.scheduler else self.processes


@dataclass(frozen=True)
class Outcome:
    """All rows of some cells, and how they came about."""

    runs: pd.DataFrame  # one row for each cell, in their order: its columns, then what was measured
    n_recordings: int  # that work was left for
    n_simulated: int  # of these: the others were in the cache
    peak_mb: float  # of the largest worker; 0 when there was nothing left to do

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

    Rows depend neither on the number of workers nor on what was in the cache. A run that crashed
    is a row with its reason and is not kept, so the next call tries it again.

    Parameters
    ----------
    cells
    cache
    workers
        One process for each core when None.
    label
        Of the progress bar on stderr.
    show_progress
    measure
        What is measured of the cells: by default, how a method errs.

    Returns
    -------
    Outcome

    Raises
    ------
    SsacError
        If there is no scheduler at the address given.
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
    disable = None if show_progress and left else True  # None: unless stderr is no terminal
    with tqdm(total=len(left), desc=label, disable=disable) as bar:
        for index, done in _spread(work, left, workers):
            found[index] = done.rows
            for key, row in zip(keys[index], done.rows, strict=True):
                if row["status"] != CRASHED:
                    cache.save_run(key, row)  # a worker elsewhere has a folder of its own
            n_simulated += done.n_simulated
            peak_mb = max(peak_mb, done.peak_mb)
            bar.update()
    return Outcome(_frame(cells, tasks, found, measure), len(left), n_simulated, peak_mb)


@dataclass(frozen=True)
class _Work:
    """What is to be done, and how."""

    tasks: Sequence[Task]
    cache: Cache
    measure: Measure


def _spread(work: _Work, left: Sequence[int], workers: Workers) -> Iterator[tuple[int, Done]]:
    """Yield each task's index and what it gave, in the order in which they are done."""
    with _backend(workers):
        done = set()
        try:
            for result in _parallel(work, left, workers.n_jobs):
                done.add(result[0])
                yield result
        except Exception:  # a worker died, and others with it: find out on which task
            for index in left:
                if index not in done:
                    yield _alone(work, index)


def _alone(work: _Work, index: int) -> tuple[int, Done]:
    """Run a task in a worker that no other task can take down."""
    try:
        # Two jobs, since one would run in this process and take it down.
        return next(_parallel(work, [index], 2))
    except Exception as error:
        crashed = refusal(work.measure, error, "worker") | {"status": CRASHED}
        done = [work.cache.load_run(key) for key in keys_of(work.tasks[index], work.measure)]
        return index, Done([crashed if row is None else row for row in done], 0, 0.0)


def _parallel(
    work: _Work, indices: Sequence[int], n_jobs: int | None
) -> Iterator[tuple[int, Done]]:
    parallel = joblib.Parallel(n_jobs=n_jobs, return_as="generator_unordered", batch_size=1)
    results: Iterator[tuple[int, Done]] = parallel(
        joblib.delayed(_indexed)(index, work.tasks[index], work.cache, work.measure)
        for index in indices
    )
    return results


def _indexed(index: int, task: Task, cache: Cache, measure: Measure) -> tuple[int, Done]:
    return index, run_task(task, cache, measure)


@contextmanager
def _backend(workers: Workers) -> Iterator[None]:
    """Choose where joblib runs: processes of this machine, or the workers of a Dask scheduler."""
    if not workers.scheduler:
        yield
        return
    try:
        from distributed import Client
    except ImportError as error:
        raise SsacError(
            '--scheduler needs Dask: .venv/bin/pip install "dask[distributed]"'
        ) from error
    try:
        client = Client(workers.scheduler, timeout=10)  # type: ignore[no-untyped-call]
    except (OSError, ValueError) as error:
        raise SsacError(
            f"no Dask scheduler answers at {workers.scheduler!r}: expected an address such as "
            f"tcp://host:8786 ({error})"
        ) from error
    try:
        client.wait_for_workers(1, timeout=WAIT_FOR_WORKERS_S)
    except OSError as error:  # TimeoutError is one
        client.close()  # type: ignore[no-untyped-call]
        raise SsacError(
            f"the Dask scheduler at {workers.scheduler} has no workers: start some with "
            f"dask worker {workers.scheduler} --nthreads 1"
        ) from error
    with client, joblib.parallel_config(backend="dask", n_jobs=-1):
        yield


def _frame(
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
