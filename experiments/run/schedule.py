"""Cells in, one row each out: spread over processes or a cluster, resumed where they stopped."""

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import joblib
import pandas as pd
from tqdm import tqdm

from experiments.run.cache import Cache
from experiments.run.grid import Cell
from experiments.run.task import CRASHED, Row, Task, keys_of, plain, run_task, tasks_of
from ssac.errors import SsacError

Rows = list[dict[str, Any]]

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
    """All rows of a grid, and how they came about."""

    runs: pd.DataFrame  # one row a cell, in their order: parameters, flight, seed, method, `Row`
    n_recordings: int  # that work was left for
    n_simulated: int  # of these: the others were in the cache
    peak_mb: float  # of the largest worker; 0 when there was nothing left to do

    @property
    def n_crashed(self) -> int:
        """Number of runs that crashed."""
        return int((self.runs["status"] == CRASHED).sum())


def run_cells(
    cells: Sequence[Cell],
    cache: Cache,
    workers: Workers | None = None,
    label: str = "recordings",
    show_progress: bool = True,
) -> Outcome:
    """Run all cells that the cache does not hold, and collect the rows of all.

    Rows depend neither on the number of workers nor on what was in the cache. A run that crashed
    is a row with its reason and is not kept, so the next call tries it again.

    Parameters
    ----------
    cells : Sequence[Cell]
    cache : Cache
    workers : Workers | None
        One process for each core when None.
    label : str
        Of the progress bar on stderr.
    show_progress : bool

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
    keys = [keys_of(task) for task in tasks]  # the machine's GL driver is part of them
    found: dict[int, Rows] = {}
    left: list[int] = []
    for index, task in enumerate(tasks):
        known = [cache.load_run(key) for key in keys[index]]
        rows = [row for row in known if row is not None]
        if len(rows) == len(task.cells):
            found[index] = rows
        else:
            left.append(index)
    n_simulated = sum(not cache.has_recording(tasks[at].sim, tasks[at].seed) for at in left)
    # The longest first, so that no worker is left alone with one at the end.
    left.sort(key=lambda index: (-_cost(tasks[index]), index))
    peak_mb = 0.0
    # None: no bar where stderr is no terminal.
    with tqdm(total=len(left), desc=label, disable=None if show_progress and left else True) as bar:
        for index, rows, task_mb in _spread(tasks, left, cache, workers):
            found[index] = rows
            for key, row in zip(keys[index], rows, strict=True):
                if row["status"] != CRASHED:
                    cache.save_run(key, row)  # a worker elsewhere has a folder of its own
            peak_mb = max(peak_mb, task_mb)
            bar.update()
    return Outcome(_frame(cells, tasks, found), len(left), n_simulated, peak_mb)


def _spread(
    tasks: Sequence[Task], left: Sequence[int], cache: Cache, workers: Workers
) -> Iterator[tuple[int, Rows, float]]:
    """Yield each task's index, rows and peak memory, in the order in which they are done."""
    with _backend(workers):
        done = set()
        try:
            for result in _parallel(tasks, left, cache, workers.n_jobs):
                done.add(result[0])
                yield result
        except Exception:  # a worker died, and others with it: find out on which task
            for index in left:
                if index not in done:
                    yield _alone(tasks, index, cache)


def _alone(tasks: Sequence[Task], index: int, cache: Cache) -> tuple[int, Rows, float]:
    """Run a task in a worker that no other task can take down."""
    try:
        # Two jobs, since one would run in this process and take it down.
        return next(_parallel(tasks, [index], cache, 2))
    except Exception as error:
        text = " ".join(str(error).split())
        crashed = plain(Row(CRASHED, f"worker: {type(error).__name__}: {text}"))
        done = [cache.load_run(key) for key in keys_of(tasks[index])]
        return index, [crashed if row is None else row for row in done], 0.0


def _parallel(
    tasks: Sequence[Task], indices: Sequence[int], cache: Cache, n_jobs: int | None
) -> Iterator[tuple[int, Rows, float]]:
    parallel = joblib.Parallel(n_jobs=n_jobs, return_as="generator_unordered", batch_size=1)
    results: Iterator[tuple[int, Rows, float]] = parallel(
        joblib.delayed(_indexed)(index, tasks[index], cache) for index in indices
    )
    return results


def _indexed(index: int, task: Task, cache: Cache) -> tuple[int, Rows, float]:
    return (index, *run_task(task, cache))


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


def _cost(task: Task) -> float:
    """How long a recording takes, roughly: its duration, all else being equal."""
    return task.sim.spline.duration_s


def _frame(cells: Sequence[Cell], tasks: Sequence[Task], found: dict[int, Rows]) -> pd.DataFrame:
    """Put the rows in the order of the cells, and each cell's parameters before its row."""
    rows = {
        id(cell): row
        for index, task in enumerate(tasks)
        for cell, row in zip(task.cells, found[index], strict=True)
    }
    table = [
        {
            **cell.parameters,
            "flight": cell.flight,
            "seed": cell.seed,
            "method": cell.method,
            **rows[id(cell)],
        }
        for cell in cells
    ]
    frame: pd.DataFrame = pd.DataFrame(table)
    for name, value in vars(Row("")).items():
        if isinstance(value, float) and math.isnan(value):
            frame[name] = frame[name].astype(float)
    return frame
