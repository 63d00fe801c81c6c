"""Cells that share a recording in, one row each out: loaded once, measured one by one, kept.

A cell is one run of anything that is measured: a method on a flight, a variant, a comparison. One
cell gives one row; a cell that cannot be measured gives a row with a status and a reason.
"""

import hashlib
import resource
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np
from threadpoolctl import threadpool_limits

from experiments.lab.cache import Cache, recording_key, run_key
from experiments.lab.memory import keep_freed_memory
from sim.recording import SimConfig
from ssac.errors import SsacError, WriteError

CRASHED = "crashed"
"""Status of a run that could not be simulated, or whose measure raised what is not an SsacError."""

UNUSABLE = "unusable"
"""Status of a run on data that the method refuses with an SsacError."""

Flight = tuple[SimConfig, int]
"""What `simulate` takes: a configuration and a seed."""

Rows = list[dict[str, Any]]


class AnyCell(Protocol):
    """One run: a frozen dataclass with these properties."""

    @property
    def recordings(self) -> tuple[Flight, ...]:
        """Flights that it is measured on: cells of the same ones share a task."""

    @property
    def columns(self) -> Mapping[str, Any]:
        """Columns of its row in the runs' file that say which run it is."""

    @property
    def inputs(self) -> Any:
        """Everything beside recordings and code that its row depends on (`cache.content`)."""


@dataclass(frozen=True)
class FlightCell:
    """One run on one flight: what the cells of studies have in common."""

    sim: SimConfig
    flight: int  # its number among those of its duration and angle
    seed: int  # as of `grid.flight_seed`

    @property
    def recordings(self) -> tuple[Flight, ...]:
        """The one flight."""
        return ((self.sim, self.seed),)

    @property
    def flown(self) -> dict[str, Any]:
        """Columns that say which flight it is."""
        return {
            "duration_s": self.sim.spline.duration_s, "angle_deg": self.sim.angle_deg,
            "flight": self.flight, "seed": self.seed,
        }  # fmt: skip


@dataclass(frozen=True)
class Measure:
    """How the cells of one task become rows: functions of modules, which other processes find.

    The code that a row depends on is that of the modules in which the two functions stand, and all
    that these import: keep the drawing and summing up of rows elsewhere.
    """

    load: Callable[[Sequence[Any], Cache], Any]  # what the cells of a task share
    row: Callable[[Any, Any], Any]  # a cell and what was loaded -> a `row_type`
    row_type: type  # a dataclass: status, reason, then fields with defaults

    @property
    def code(self) -> tuple[str, ...]:
        """Modules that measure."""
        return tuple(sorted({self.load.__module__, self.row.__module__}))


@dataclass(frozen=True)
class Task:
    """All cells that are measured on the same recordings."""

    cells: tuple[Any, ...]  # AnyCell

    @property
    def recordings(self) -> tuple[Flight, ...]:
        """That the cells are measured on."""
        recordings: tuple[Flight, ...] = self.cells[0].recordings
        return recordings

    @property
    def cost_s(self) -> float:
        """How long it takes, roughly and relative to others: the duration of its recordings."""
        return sum(sim.spline.duration_s for sim, _ in self.recordings)


def tasks_of(cells: Sequence[Any]) -> list[Task]:
    """Group cells by recordings, in the order in which these first appear."""
    groups: dict[tuple[Flight, ...], list[Any]] = {}
    for cell in cells:
        groups.setdefault(cell.recordings, []).append(cell)
    return [Task(tuple(group)) for group in groups.values()]


def keys_of(task: Task, measure: Measure) -> list[str]:
    """Keys of a task's cells in the cache."""
    recordings = tuple(recording_key(*recording) for recording in task.recordings)
    return [run_key(recordings, cell.inputs, measure.code) for cell in task.cells]


def recordings_key(task: Task) -> str:
    """Name a task by what it is measured on, whatever is measured."""
    keys = " ".join(recording_key(*recording) for recording in task.recordings)
    return hashlib.sha256(keys.encode()).hexdigest()[:24]


class Done(NamedTuple):
    """A task's rows, and how they came about."""

    rows: Rows  # one for each cell: the fields of the measure's `row_type`
    n_simulated: int  # recordings that were not in the cache before
    peak_mb: float  # peak memory of this process so far


def run_task(task: Task, cache: Cache, measure: Measure) -> Done:
    """Measure those cells of a task that the cache does not hold yet.

    Parameters
    ----------
    task
    cache
        Is given every row as soon as it is there, but for crashed ones.
    measure

    Returns
    -------
    Done
        Nothing that a cell does raises.

    Raises
    ------
    WriteError
        If the cache cannot be written to.
    """
    keep_freed_memory()
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
        if rows[index] is not None:
            continue
        try:
            row = plain(measure.row(cell, loaded))
        except Exception as error:
            row = refusal(measure, error, _name(cell))
        rows[index] = row
        if row["status"] != CRASHED:
            cache.save_run(key, row)
    return [row for row in rows if row is not None]


def refusal(measure: Measure, error: Exception, where: str) -> dict[str, Any]:
    """Make the row of a cell that could not be measured."""
    text = " ".join(str(error).split())
    if isinstance(error, SsacError):
        return plain(measure.row_type(UNUSABLE, text))
    return plain(measure.row_type(CRASHED, f"{where}: {type(error).__name__}: {text}"))


def plain(row: Any) -> dict[str, Any]:
    """Turn a row into what JSON holds exactly: None for NaN."""
    values: Mapping[str, Any] = vars(row)
    return {
        name: None if isinstance(value, float) and np.isnan(value) else value
        for name, value in values.items()
    }


def _name(cell: Any) -> str:
    """Tell a cell from the others of its task, in a reason: by its last column."""
    *_, last = cell.columns.values()
    return str(last)
