"""Runs on recordings drawn at random, repeated from nothing and compared with the committed ones.

Statuses, counts and the words of reasons must be the same on any machine. Other numbers may differ
by one unit of their last digit or by `ROUNDING`: OpenBLAS, NumPy and numba choose kernels by the
processor, and each kernel adds its terms in an order of its own.
"""

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import fields
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from experiments.lab.cache import Cache
from experiments.lab.cell import CRASHED
from experiments.lab.results import Results
from experiments.lab.schedule import Task, Workers, run_cells, tasks_of
from experiments.lab.study import CELL, How, Runs, Study, runs_text
from experiments.lab.verify import Finding, cells_of, found, near, table_of_texts
from ssac.errors import SsacError
from ssac.pipeline.registry import DEFAULT, METHODS, OURS

ROUNDING = 1e-6
"""Least tolerance of a measured number, in its own unit (ms, deg, px, ppm or none).

The largest difference on sixteen recordings with other kernels, thread counts and packages
(docs/testing.md) was 6e-8 ms, of albl's t_d; all others were 1.2e-10 at most. The tolerance matters
for small numbers such as t_d_error_ms, the difference of two nearly equal ones.
"""

BY_BODY = 0.05
"""Additional tolerance for a method with `needs_events`: BY_BODY (1 + |x|) for a number x.

Such a method finds the body by many comparisons. Their values are rounded (`ssac.track.body`), so
that 60 recordings agree with two processors' kernels. Rows from before may differ by this much.
"""

_MEASURED = re.compile(r"-?\d+\.\d+|-?\d+(?= (?:%|deg\b|px\b|ms\b|s\b))")
"""Matches a measured number in a reason, one with decimals or a unit; counts have neither."""

Drawn = tuple[Study, Task]  # a study, and the task of its runs on one recording that was drawn


def sources_of(studies: Mapping[str, Study], only: str | None = None) -> list[Study]:
    """List the studies to draw from: of those with minutes per recording only the one asked for."""
    able = {
        name: study
        for name, study in studies.items()
        if study.how is How.SHARED and study.runs.file
    }
    if only is not None:
        if only not in able:
            raise SsacError(f"--only: expected a study of {', '.join(able)}, got {only}")
        return [able[only]]
    return [study for study in able.values() if study.again]


def draw(sources: Sequence[Study], n_recordings: int, seed: int) -> list[Drawn]:
    """Draw up to `n_recordings` without repetition, every other one from the first study."""
    generator = np.random.default_rng(seed)
    left = {study.name: _shuffled(study, generator) for study in sources}
    drawn: list[Drawn] = []
    while len(drawn) < n_recordings and any(left.values()):
        turn = sources[:1] if len(drawn) % 2 == 0 else sources[1:]
        there = [study for study in turn if left[study.name]]
        there = there or [study for study in sources if left[study.name]]
        study = there[int(generator.integers(len(there)))]
        drawn.append((study, left[study.name].pop()))
    return drawn


def recomputed(
    drawn: Sequence[Drawn], results: Results, folder: Path, workers: Workers
) -> list[Finding]:
    """Repeat the runs on the drawn recordings in an empty cache; return a finding per recording."""
    findings = []
    for study in dict.fromkeys(study for study, _ in drawn):
        tasks = [task for whose, task in drawn if whose is study]
        cells = [cell for task in tasks for cell in task]
        runs = run_cells(cells, Cache(folder), workers, study.name, measure=study.measure).runs
        number = {id(cell): at for at, cell in enumerate(cells_of(study))}
        runs.insert(0, CELL, [number[id(cell)] for cell in cells])
        rows = table_of_texts(runs_text(study.runs, runs))
        for task in tasks:
            mine, rows = rows[: len(task)], rows[len(task) :]
            where = ", ".join(f"{key} {value}" for key, value in task[0].columns.items())
            what = f"{study.runs.file}: {len(mine)} runs on the recording of {where}"
            findings.append(found(what, partial(row_faults, mine, study, results)))
    return findings


def row_faults(again: pd.DataFrame, study: Study, results: Results) -> list[str]:
    """List how rows differ from the committed rows with the same keys; all cells are texts."""
    kept, faults = study.runs, []
    keys = (CELL,) if kept.numbered else kept.keys
    committed = table_of_texts(results.text(kept.file)).to_dict("records")
    theirs_by_key = {tuple(row[name] for name in keys): row for row in committed}
    measured = measured_by(study)
    for row in again.to_dict("records"):
        key = tuple(row[name] for name in keys)
        where = ", ".join(f"{name} {value}" for name, value in zip(keys, key, strict=True))
        theirs = theirs_by_key.get(key)
        if theirs is None:
            faults.append(f"{where}: no such run is committed")
        elif row["status"] == CRASHED:
            faults.append(f"{where}: crashed: {row['reason']}")
        elif unlike := _unlike(row, theirs, measured, kept):
            faults.append(f"{where}: {unlike}. {row['reason']}")
    return faults


def measured_by(study: Study) -> frozenset[str]:
    """Names of the columns of floats; the others hold counts, texts and the identity of the run."""
    return frozenset(one.name for one in fields(study.measure.row_type) if one.type is float)


def _unlike(
    row: Mapping[Any, str], theirs: Mapping[Any, str], measured: Collection[str], kept: Runs
) -> str:
    """Describe the first difference of two rows; empty if they agree."""
    method = METHODS.get(row.get("method", DEFAULT))
    slack = BY_BODY if method is not None and method.needs_events else 0.0
    for name in dict.fromkeys(["status", *theirs, *row]):
        mine, other = (str(one.get(name, "no column")) for one in (row, theirs))
        is_measured = name in measured or (slack > 0.0 and name == "n_samples")
        is_alike = name in kept.took or (
            _alike_in_words(mine, other)
            if name == "reason"
            else _alike(mine, other, is_measured, slack, kept.digits)
        )
        if not is_alike:
            return f"{name} is {mine}, committed: {other}"
    return ""


def _alike(mine: str, other: str, is_measured: bool, slack: float, digits: int) -> bool:
    """Compare two cells, numbers within tolerance; a table may round a whole number to `digits`."""
    if mine == other:
        return True
    try:
        a, b = float(mine), float(other)
    except ValueError:
        return False
    if is_measured and (near(a, b, digits) or abs(a - b) <= ROUNDING + slack * (1.0 + abs(b))):
        return True
    is_rounded = not (mine.isdecimal() and other.isdecimal())
    return is_rounded and f"{a:.{digits}g}" == f"{b:.{digits}g}"


def _alike_in_words(mine: str, other: str) -> bool:
    """Compare two reasons; measured numbers in them may differ by one unit of the last digit."""
    if _MEASURED.sub("#", mine) != _MEASURED.sub("#", other):
        return False
    for a, b in zip(_MEASURED.findall(mine), _MEASURED.findall(other), strict=True):
        decimals = len(b.partition(".")[2])
        if len(a.partition(".")[2]) != decimals or abs(float(a) - float(b)) > 1.001 / 10**decimals:
            return False
    return True


def _shuffled(study: Study, generator: np.random.Generator) -> list[Task]:
    """Shuffle a study's tasks without those that OpenGL renders: no two drivers render alike."""
    ours = {method.name for method in OURS}  # another package may have added a method
    cells = [cell for cell in cells_of(study) if getattr(cell, "method", None) in {None, *ours}]
    tasks = [
        task
        for task in tasks_of(cells)
        if all(sim.render.renderer == "native" for sim, _ in task[0].recordings)
    ]
    return [tasks[index] for index in generator.permutation(len(tasks))]
