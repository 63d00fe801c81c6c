"""A study in; all its runs, their summary and its figure in `results/` out, in shards or whole.

A study is a list of cells, a measure that makes a row of each, a summary of the rows and a drawing
of it. All of them run on one scheduler and cache (`experiments.lab`), so each can be stopped and
taken up again, and spread over machines. What follows from the runs is made from the text of their
file, rounded as it is there, so that anyone who has the file makes the same bytes.

    results/<name>_runs.csv   one row for each cell, failed ones included; `cell` numbers them
    results/<name>.csv        the summary
    results/<name>.png        the figure, where it has one
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import pandas as pd
from matplotlib.figure import Figure

from experiments.lab.cache import Cache
from experiments.lab.files import csv_text, read_table, save_png, save_text
from experiments.lab.schedule import Outcome, Workers, run_cells
from experiments.lab.task import AnyCell, Measure, tasks_of
from ssac.errors import SsacError

CELL = "cell"
"""Column of the cells' numbers over the whole study."""

WHOLE = (1, 1)
"""The shard that is everything."""


@dataclass(frozen=True)
class Study:
    """What is measured, and what is made of it."""

    name: str  # of the files
    title: str
    cells: Callable[[], Sequence[AnyCell]]  # in the order of the runs' file
    measure: Measure
    summarise: Callable[..., pd.DataFrame]  # the runs as read back, then what `reads` names
    keys: tuple[str, ...]  # columns of which each combination is there once
    draw: Callable[[pd.DataFrame, pd.DataFrame], Figure] | None = None  # summary, runs
    reads: tuple[str, ...] = ()  # further files of the results that the summary is made of
    config: Mapping[str, Any] = field(default_factory=dict)  # for provenance
    command: str = ""  # that runs it; by default `ssac study <name>`

    @property
    def runs_file(self) -> str:
        """Name of the file of all runs."""
        return f"{self.name}_runs.csv"

    @property
    def summary_file(self) -> str:
        """Name of the summary."""
        return f"{self.name}.csv"

    @property
    def figure_file(self) -> str:
        """Name of the figure."""
        return f"{self.name}.png"

    @property
    def command_line(self) -> str:
        """What a user types to run it."""
        return self.command or f"ssac study {self.name}"


def run_study(
    study: Study, cache: Cache, workers: Workers | None = None, shard: tuple[int, int] = WHOLE
) -> Outcome:
    """Measure the cells of a study, or those of a shard, that the cache does not hold.

    Returns
    -------
    Outcome
        Its runs have the column `cell` first.
    """
    return run_numbered(numbered(study.cells(), shard), study.measure, cache, workers, study.name)


def run_numbered(
    cells: Sequence[tuple[int, AnyCell]],
    measure: Measure,
    cache: Cache,
    workers: Workers | None,
    label: str,
) -> Outcome:
    """Measure numbered cells."""
    outcome = run_cells([cell for _, cell in cells], cache, workers, label, measure=measure)
    runs = outcome.runs.copy()
    runs.insert(0, CELL, [number for number, _ in cells])
    return replace(outcome, runs=runs)


def numbered(cells: Sequence[AnyCell], shard: tuple[int, int] = WHOLE) -> list[tuple[int, AnyCell]]:
    """Return the numbered cells of shard (i, n), i from 1: every n-th recording with all its cells.

    A recording is never split, so no two shards simulate the same one.
    """
    index, n_shards = shard
    number = {id(cell): at for at, cell in enumerate(cells)}
    mine = [cell for task in tasks_of(cells)[index - 1 :: n_shards] for cell in task.cells]
    return sorted(((number[id(cell)], cell) for cell in mine), key=lambda pair: pair[0])


def parse_shard(text: str) -> tuple[int, int]:
    """Read i/n; SsacError when it is none."""
    first, _, second = text.partition("/")
    if not (first.isdecimal() and second.isdecimal() and 1 <= int(first) <= int(second)):
        raise SsacError(f"--shard: expected i/n with 1 <= i <= n, such as 2/8, got {text!r}")
    return int(first), int(second)


def save_derived(study: Study, folder: Path) -> list[Path]:
    """Make summary and figure from the runs' file in a folder; return their paths."""
    runs_text = (folder / study.runs_file).read_text(encoding="utf-8")
    summary = summary_text(study, runs_text, folder)
    paths = [folder / study.summary_file]
    save_text(paths[0], summary)
    if study.draw is not None:
        paths.append(folder / study.figure_file)
        save_png(study.draw(read_table(summary), read_table(runs_text)), paths[-1])
    return paths


def summary_text(study: Study, runs_text: str, folder: Path) -> str:
    """Make the text of the summary from that of the runs.

    Parameters
    ----------
    study
    runs_text
        Of the runs' file.
    folder
        Where the other files are that the summary is made of.

    Raises
    ------
    SsacError
        If a run of the study is not there just once, or another file cannot be read.
    """
    runs = read_table(runs_text)
    check_runs(study, runs)
    return csv_text(study.summarise(runs, *read_others(study, folder)))


def read_others(study: Study, folder: Path) -> list[pd.DataFrame]:
    """Read the further files that a study's summary is made of; SsacError if one is absent."""
    absent = [name for name in study.reads if not (folder / name).is_file()]
    if absent:
        raise SsacError(
            f"`{study.command_line}` needs {', '.join(absent)} in {folder}: make them first"
        )
    return [read_table((folder / name).read_text(encoding="utf-8")) for name in study.reads]


def check_runs(study: Study, runs: pd.DataFrame) -> None:
    """Raise SsacError unless every cell of the study has its row, once and in its place."""
    expected = read_table(csv_text(pd.DataFrame([c.columns for c in study.cells()])))
    again = f": run `{study.command_line}`"
    absent = [name for name in (CELL, *expected, "status") if name not in runs]
    if absent:
        raise SsacError(f"{study.runs_file}: has no columns {', '.join(absent)}{again}")
    if list(runs[CELL]) != list(range(len(expected))):
        raise SsacError(
            f"{study.runs_file}: expected the cells 0 to {len(expected) - 1} in order, got "
            f"{len(runs)} rows{again}"
        )
    names = list(expected)
    same = (runs[names].astype(str) == expected.astype(str)).all(axis=1)
    if not same.all():
        first = int((~same).to_numpy().argmax())
        found, wanted = runs[names].to_dict("records")[first], expected.to_dict("records")[first]
        raise SsacError(f"{study.runs_file}: row {first} is of {found}, expected {wanted}{again}")
    if runs.duplicated(list(study.keys)).any():
        raise SsacError(f"{study.runs_file}: {', '.join(study.keys)} do not tell all runs apart")
