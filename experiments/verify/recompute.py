"""Recordings that were drawn in, whether their runs are as committed out: made again from nothing.

Where the OpenGL driver and all versions are those that the results were made with, every number of
a row must be the same to its six digits, event counts, samples and deviations included. Elsewhere
they may differ a little, as `tolerances` says.
"""

from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd

from experiments.run.cache import Cache
from experiments.run.schedule import Workers, run_cells
from experiments.run.task import CRASHED
from experiments.verify.files import made_alike
from experiments.verify.finding import Finding, found
from experiments.verify.sample import Drawn, Source
from ssac.pipeline.registry import METHODS, Input

# How far a run may be from the committed one elsewhere. Not even OSMesa and EGL of one Mesa differ
# on one machine. With another OpenGL driver, processor or library the events may change a little.
# Each tolerance is twice the largest difference that was found when 1 % of the events were taken
# away and the others moved by 60 us (standard deviation), eight times an angle.
TRACK_TOLERANCES = {"t_d_estimate_ms": 0.06, "r_error_deg": 0.1, "t_error_deg": 0.05}
TANGENCY_TOLERANCES = {**TRACK_TOLERANCES, "t_d_estimate_ms": 0.1}  # it rests on single events
EVENT_RATE_TOLERANCE_MS = 6.0
UNIT_MS = {"zncc_e": 10.0, "zncc_f": 20.0}
"""One unit of their offsets: zncc_e did not change then, and zncc_f sees frames alone."""

EVENT_COUNTS = ("n_events_cam1", "n_events_cam2")
TIMES = ("cpu_s",)
"""Columns of what a run took: another time, even here."""

COUNT_TOLERANCE = 0.02
"""Relative: twice the share of the events that was taken away."""


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
    provenance = (results / source.file).with_suffix(".provenance.json")
    return row_faults(rows, source.rows(results), source.keys, made_alike(provenance))


def row_faults(
    again: pd.DataFrame, committed: pd.DataFrame, keys: Sequence[str], exactly: bool
) -> tuple[str, ...]:
    """Compare rows with the committed ones of the same keys; tables of texts.

    Parameters
    ----------
    again, committed
        Of `committed` only the rows of `again` count.
    keys
    exactly
        Every column, to its digits; else those that have a tolerance.
    """
    theirs_by_key = {tuple(row[name] for name in keys): row for row in committed.to_dict("records")}
    faults = []
    for row in again.to_dict("records"):
        key = tuple(row[name] for name in keys)
        where = ", ".join(f"{name} {value}" for name, value in zip(keys, key, strict=True))
        if key not in theirs_by_key:
            faults.append(f"{where}: no such run is committed")
            continue
        theirs = {str(name): value for name, value in theirs_by_key[key].items()}
        if row["status"] == CRASHED:
            faults.append(f"{where}: crashed: {row['reason']}")
            continue
        same = (name for name in theirs if name not in TIMES)
        allowed = dict.fromkeys(same, 0.0) if exactly else tolerances(str(row.get("method", "")))
        for name, tolerance in {"status": 0.0, **allowed}.items():
            if name not in row and name not in theirs:
                continue
            mine, other = str(row.get(name, "no column")), str(theirs.get(name, "no column"))
            if not _alike(mine, other, tolerance, name in EVENT_COUNTS):
                faults.append(f"{where}: {name} is {mine}, committed: {other}. {row['reason']}")
                break
    return tuple(faults)


def tolerances(method: str) -> dict[str, float]:
    """How far each number of a method's run may be from the committed one on another machine."""
    counts = dict.fromkeys(EVENT_COUNTS, COUNT_TOLERANCE)
    if method not in METHODS:
        return counts
    if METHODS[method].input is Input.TRACKS:
        near = TANGENCY_TOLERANCES if method.startswith("tangency") else TRACK_TOLERANCES
        return {**near, **counts}
    return {"t_d_estimate_ms": UNIT_MS.get(method, EVENT_RATE_TOLERANCE_MS), **counts}


def _alike(mine: str, other: str, tolerance: float, relative: bool) -> bool:
    """Compare two texts, as numbers where they are; a table may round a whole number to digits."""
    if mine == other:
        return True
    try:
        a, b = float(mine), float(other)
    except ValueError:
        return False
    reach = tolerance * abs(b) if relative else tolerance
    return f"{a:.6g}" == f"{b:.6g}" or bool(np.isfinite(a) and abs(a - b) <= reach)
