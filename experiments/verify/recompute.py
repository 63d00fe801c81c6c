"""Recordings that were drawn in, whether their runs are as committed out: made again from nothing.

Statuses, counts and the words of reasons must be the same on any machine. The other numbers may
differ by a unit of their last digit and by `ROUNDING`: OpenBLAS, NumPy and numba choose kernels by
the processor, and each kernel adds its terms in an order of its own.
"""

import re
from collections.abc import Collection, Sequence
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd

from experiments.lab.cache import Cache
from experiments.lab.finding import Finding, found
from experiments.lab.schedule import Workers, run_cells
from experiments.lab.task import CRASHED
from experiments.studies.fidelity import RENDERERS_STUDY
from experiments.verify.files import same_driver
from experiments.verify.sample import Drawn, Source

DIGITS = 6
"""Significant ones of a committed number."""

ROUNDING = 1e-6
"""How far a number may be off beside its last digit, in its unit (ms, deg, px, ppm, or none).

The largest difference on sixteen recordings with other kernels, thread counts and packages
(docs/testing.md) was 6e-8 ms, of albl's t_d, which is where a parabola finds the least of an
eigenvalue that rounding has roughened. All other numbers differed by 1.2e-10 at most. It counts
where numbers are small, as t_d_error_ms is, the difference of two that are nearly equal.
"""

TIMES = ("cpu_s",)
"""Columns of what a run took: another time, even here."""

_MEASURED = re.compile(r"-?\d+\.\d+|-?\d+(?= (?:%|deg\b|px\b|ms\b|s\b))")
"""A number of a reason that is not a count: it has decimals, or a unit."""


def recomputed(
    drawn: Sequence[Drawn], results: Path, folder: Path, workers: Workers
) -> list[Finding]:
    """Make the runs on the drawn recordings again, and compare them: one finding for each.

    Parameters
    ----------
    drawn
    results
        The committed ones.
    folder
        An empty one, for the recordings and runs.
    workers
    """
    findings = []
    for source in {one.source.name: one.source for one in drawn}.values():
        tasks = [one.task for one in drawn if one.source.name == source.name]
        cells = [cell for task in tasks for cell in task.cells]
        outcome = run_cells(cells, Cache(folder), workers, source.name, measure=source.measure)
        first = 0
        for task in tasks:
            last = first + len(task.cells)
            runs = outcome.runs.iloc[first:last].reset_index(drop=True)
            first = last
            rows = source.rows_again(runs, task.cells, folder)
            flight = dict(task.cells[0].columns)
            where = ", ".join(f"{key} {value}" for key, value in flight.items())
            what = f"{source.file}: {len(rows)} runs on the recording of {where}"
            findings.append(found(what, partial(_compared, rows, source, results)))
    return findings


def _compared(rows: pd.DataFrame, source: Source, results: Path) -> tuple[str, ...]:
    committed = source.rows(results)
    provenance = (results / source.file).with_suffix(".provenance.json")
    if source.name == RENDERERS_STUDY.name and not same_driver(provenance):
        compared = [*source.keys, "status", "reason"]  # what another driver draws is not the same
        rows, committed = rows[compared], committed[compared]
    return row_faults(rows, committed, source.keys, source.measured)


def row_faults(
    again: pd.DataFrame, committed: pd.DataFrame, keys: Sequence[str], measured: Collection[str]
) -> tuple[str, ...]:
    """Compare rows with the committed ones of the same keys; tables of texts.

    Parameters
    ----------
    again, committed
        Of `committed` only the rows of `again` count.
    keys
    measured
        Columns that rounding reaches. All others, but `reason`, must be the same.
    """
    theirs_by_key = {tuple(row[name] for name in keys): row for row in committed.to_dict("records")}
    faults = []
    for row in again.to_dict("records"):
        key = tuple(row[name] for name in keys)
        where = ", ".join(f"{name} {value}" for name, value in zip(keys, key, strict=True))
        if key not in theirs_by_key:
            faults.append(f"{where}: no such run is committed")
            continue
        if row["status"] == CRASHED:
            faults.append(f"{where}: crashed: {row['reason']}")
            continue
        theirs = {str(name): value for name, value in theirs_by_key[key].items()}
        names = dict.fromkeys(["status", *theirs, *map(str, row)])
        for name in (name for name in names if name not in TIMES):
            mine, other = str(row.get(name, "no column")), str(theirs.get(name, "no column"))
            if name == "reason":
                is_alike = _alike_in_words(mine, other)
            else:
                is_alike = _alike(mine, other, name in measured)
            if not is_alike:
                faults.append(f"{where}: {name} is {mine}, committed: {other}. {row['reason']}")
                break
    return tuple(faults)


def _alike(mine: str, other: str, is_measured: bool) -> bool:
    """Compare two texts, as numbers where they are; a table may round a whole number to digits."""
    if mine == other:
        return True
    if mine.isdecimal() and other.isdecimal():
        return is_measured and _near(float(mine), float(other))
    try:
        a, b = float(mine), float(other)
    except ValueError:
        return False
    return f"{a:.{DIGITS}g}" == f"{b:.{DIGITS}g}" or (is_measured and _near(a, b))


def _near(mine: float, other: float) -> bool:
    """Whether rounding may make the one of the other."""
    unit = 10.0 ** (np.floor(np.log10(abs(other))) + 1 - DIGITS) if other else 0.0
    return bool(abs(mine - other) <= 1.001 * unit + ROUNDING)  # 1.001: units are no binary numbers


def _alike_in_words(mine: str, other: str) -> bool:
    """Compare two reasons: a number that was measured may differ by a unit of its last digit."""
    if _MEASURED.sub("#", mine) != _MEASURED.sub("#", other):
        return False
    for a, b in zip(_MEASURED.findall(mine), _MEASURED.findall(other), strict=True):
        decimals = len(b.partition(".")[2])
        if len(a.partition(".")[2]) != decimals or abs(float(a) - float(b)) > 1.001 / 10**decimals:
            return False
    return True
