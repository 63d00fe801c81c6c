"""Cells that are measured alone: each in a process of its own on one core, for time and memory."""

import os
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

from threadpoolctl import threadpool_limits

from experiments.lab.cache import Cache
from experiments.lab.cell import AnyCell, Measure
from experiments.lab.pool import DiedError, in_new_process
from experiments.lab.schedule import Outcome, frame_of
from experiments.lab.task import Task, name_of, plain, refusal
from ssac.cli.progress import say
from ssac.errors import SsacError

_ONE_CORE = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}


def run_alone(cells: Sequence[AnyCell], measure: Measure, label: str) -> Outcome:
    """Measure cells one after the other in their order; no row is kept.

    All of them get one cache, which is gone at the end, so that a cell may use what those before
    it have made. A process that dies is a row that says so.
    """
    rows: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory(prefix="ssac-alone-") as folder, _one_core():
        for number, cell in enumerate(cells, 1):
            say(f"{label}: {number} of {len(cells)}")
            try:
                rows.append(in_new_process(partial(measured, cell, Cache(Path(folder)), measure)))
            except DiedError as error:
                rows.append(refusal(measure, SsacError(f"its process {error}"), name_of(cell)))
    tasks = [Task((cell,)) for cell in cells]
    found = {index: [row] for index, row in enumerate(rows)}
    return Outcome(frame_of(cells, tasks, found, measure), len(cells), 0, 0.0)


def measured(cell: AnyCell, cache: Cache, measure: Measure) -> dict[str, Any]:
    """Measure a cell in this process; its row is not kept."""
    with threadpool_limits(1):
        try:
            return plain(measure.row(cell, measure.load([cell], cache)))
        except Exception as error:  # whatever it is: the row says so
            return refusal(measure, error, name_of(cell))


@contextmanager
def _one_core() -> Iterator[None]:
    """Give the processes that are started here one thread for each library."""
    before = dict(os.environ)
    os.environ.update(_ONE_CORE)
    os.environ.pop("PYOPENGL_PLATFORM", None)
    try:
        yield
    finally:
        os.environ.clear()
        os.environ.update(before)
