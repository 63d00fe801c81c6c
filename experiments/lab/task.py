"""Cells that share a recording are one task: it is loaded once, and each row is kept at once."""

import hashlib
import resource
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from threadpoolctl import threadpool_limits

from experiments.lab.cache import Cache, recording_key, run_key
from experiments.lab.cell import CRASHED, UNUSABLE, Flight, Measure, PlainCell, Rows
from experiments.lab.code import code_of
from ssac.errors import SsacError, WriteError


@dataclass(frozen=True)
class Task:
    """All cells that are measured on the same recordings."""

    cells: tuple[PlainCell, ...]

    @property
    def recordings(self) -> tuple[Flight, ...]:
        """That the cells are measured on."""
        return self.cells[0].recordings


def tasks_of(cells: Sequence[PlainCell]) -> list[Task]:
    """Group cells by recordings, in the order in which these first appear."""
    groups: dict[tuple[Flight, ...], list[PlainCell]] = {}
    for cell in cells:
        groups.setdefault(cell.recordings, []).append(cell)
    return [Task(tuple(group)) for group in groups.values()]


def keys_of(task: Task, measure: Measure) -> list[str]:
    """Keys of a task's cells in the cache."""
    recordings = tuple(recording_key(*recording) for recording in task.recordings)
    of_measure = (measure.load, measure.row, measure.row_type)
    return [
        run_key(recordings, cell.inputs, code_of(*of_measure, type(cell))) for cell in task.cells
    ]


def recordings_key(task: Task) -> str:
    """Name a task by what it is measured on, whatever is measured."""
    keys = " ".join(recording_key(*recording) for recording in task.recordings)
    keys = keys or repr([cell.inputs for cell in task.cells])
    return hashlib.sha256(keys.encode()).hexdigest()[:24]


class Done(NamedTuple):
    """A task's rows, and how they came about."""

    rows: Rows  # one for each cell: the fields of the measure's `row_type`
    n_simulated: int  # recordings that were not in the cache before
    peak_mb: float  # peak memory of this process so far


def run_task(task: Task, cache: Cache, measure: Measure) -> Done:
    """Measure those cells of a task that the cache does not hold yet, and keep each row at once.

    Nothing that a cell does raises; WriteError if the cache cannot be written to.
    """
    with threadpool_limits(1):  # one worker a core, and sums in the same order everywhere
        n_before = len(cache.simulated)
        rows = _rows(task, cache, measure)
    unit = 1 if sys.platform == "darwin" else 1024
    peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 1e6
    return Done(rows, len(cache.simulated) - n_before, peak_mb)


def _rows(task: Task, cache: Cache, measure: Measure) -> Rows:
    rows: list[dict[str, Any] | None] = [None] * len(task.cells)
    try:
        keys = keys_of(task, measure)
        rows = [cache.load_run(key) for key in keys]
        missing = [cell for cell, row in zip(task.cells, rows, strict=True) if row is None]
        loaded = measure.load(missing, cache) if missing else None
    except WriteError:  # the others cannot be written either
        raise
    except Exception as error:  # whatever it is: the row says so, and the other recordings go on
        failed = refusal(measure, error, "recording")
        return [failed if row is None else row for row in rows]
    for index, (key, cell) in enumerate(zip(keys, task.cells, strict=True)):
        row = rows[index]
        if row is not None:
            continue
        row = rows[index] = measured(cell, measure, lambda: loaded)
        if row["status"] != CRASHED:
            cache.save_run(key, row)
    return [row for row in rows if row is not None]


def measured(cell: PlainCell, measure: Measure, load: Callable[[], Any]) -> dict[str, Any]:
    """Make a cell's row of what is loaded."""
    try:
        return plain(measure.row(cell, load()))
    except Exception as error:  # whatever it is: the row says so
        return refusal(measure, error, name_of(cell))


def refusal(measure: Measure, error: BaseException, where: str) -> dict[str, Any]:
    """Make the row of a cell that could not be measured."""
    text = " ".join(str(error).split())
    if isinstance(error, SsacError):
        return plain(measure.row_type(UNUSABLE, text))
    return plain(measure.row_type(CRASHED, f"{where}: {type(error).__name__}: {text}"))


def plain(row: Any) -> dict[str, Any]:
    """Turn a row into what JSON holds exactly: None for NaN."""
    return {
        name: None if isinstance(value, float) and np.isnan(value) else value
        for name, value in vars(row).items()
    }


def name_of(cell: PlainCell) -> str:
    """Tell a cell from the others of its task, in a reason: by its last column."""
    return str(list(cell.columns.values())[-1])
