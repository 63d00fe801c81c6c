"""A number in; recordings drawn from those of all tables and studies, with their runs, out."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from io import StringIO
from pathlib import Path

import numpy as np
import pandas as pd

from experiments.lab.files import csv_text, save_csv
from experiments.lab.grid import Cell
from experiments.lab.scored import SCORED
from experiments.lab.study import CELL, Study, numbered
from experiments.lab.task import AnyCell, Measure, Task, tasks_of
from experiments.paper.esim import KEY, runs_of_grid
from experiments.paper.grids import table_cells
from experiments.paper.results import RUNS_FILE
from experiments.verify.files import read_text
from ssac.errors import SsacError
from ssac.pipeline.registry import OURS

SLOW = ("fidelity",)
"""Studies that take minutes for each recording: they are drawn from only if asked for."""

TABLES = "tables"
"""Name of the source that the paper's tables are; as many recordings as of all studies."""


@dataclass(frozen=True)
class Source:
    """A file of runs, and what it takes to make some of them again."""

    name: str
    file: str  # of the results
    cells: Sequence[AnyCell]
    measure: Measure
    keys: tuple[str, ...]  # columns by which a row is found

    @property
    def measured(self) -> frozenset[str]:
        """Columns that rounding reaches: the others hold counts, texts, and which run it is."""
        measured = (field.name for field in fields(self.measure.row_type) if field.type is float)
        return frozenset(measured)

    def rows_again(
        self, runs: pd.DataFrame, cells: Sequence[AnyCell], folder: Path
    ) -> pd.DataFrame:
        """Turn new runs of some of the cells into rows of the file, as texts."""
        if self.name == TABLES:
            return _texts(csv_text(runs_of_grid(runs)))
        number = {id(cell): at for at, cell in numbered(self.cells)}
        runs = runs.copy()
        runs.insert(0, CELL, [number[id(cell)] for cell in cells])
        save_csv(folder / self.file, runs)  # which turns lists into texts
        return self.rows(folder)

    def rows(self, results: Path) -> pd.DataFrame:
        """Read the file, as texts."""
        return _texts(read_text(results / self.file))


@dataclass(frozen=True)
class Drawn:
    """One recording that was drawn, and the runs on it."""

    source: Source
    task: Task


def sources_of(
    studies: Mapping[str, Study], slow: bool = False, only: str | None = None
) -> list[Source]:
    """List the tables, and the studies; those that are SLOW only if asked for.

    Parameters
    ----------
    studies
    slow
    only
        Name of the one to list: TABLES, or a study's.

    Raises
    ------
    SsacError
        If there is none of that name.
    """
    if only not in (None, TABLES, *studies):
        raise SsacError(f"--only: expected {TABLES} or a study of {', '.join(studies)}, got {only}")
    ours = {method.name for method in OURS}  # another package may have added a method
    cells: list[Cell] = [cell for cell in table_cells() if cell.method in ours]
    sources = [Source(TABLES, RUNS_FILE, cells, SCORED, tuple(KEY))]
    for study in studies.values():
        if study.name == only or (only is None and (slow or study.name not in SLOW)):
            source = Source(study.name, study.runs_file, study.cells(), study.measure, (CELL,))
            sources.append(source)
    return sources if only in (None, TABLES) else sources[1:]


def draw(sources: Sequence[Source], n_recordings: int, seed: int) -> list[Drawn]:
    """Draw recordings: every other one of the tables, the others of any study, each once.

    Parameters
    ----------
    sources
    n_recordings
        As many, or all if there are fewer.
    seed
        The same draws the same.
    """
    generator = np.random.default_rng(seed)
    left = {source.name: _shuffled(source, generator) for source in sources}
    tables = [source for source in sources if source.name == TABLES]
    others = [source for source in sources if source.name != TABLES]
    drawn: list[Drawn] = []
    while len(drawn) < n_recordings and any(left.values()):
        turn = tables if len(drawn) % 2 == 0 else others
        there = [source for source in turn if left[source.name]]
        there = there or [source for source in sources if left[source.name]]
        source = there[int(generator.integers(len(there)))]
        drawn.append(Drawn(source, left[source.name].pop()))
    return drawn


def _shuffled(source: Source, generator: np.random.Generator) -> list[Task]:
    tasks = tasks_of(source.cells)
    return [tasks[index] for index in generator.permutation(len(tasks))]


def _texts(text: str) -> pd.DataFrame:
    table: pd.DataFrame = pd.read_csv(StringIO(text), dtype=str, keep_default_na=False)
    return table
