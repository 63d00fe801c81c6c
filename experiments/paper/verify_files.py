"""The committed results in; out: whether their files agree with each other and with the grids."""

import hashlib
import json
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from io import StringIO
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from experiments.paper.comparison import PUBLISHED
from experiments.paper.esim import KEY, describe, runs_from_csv
from experiments.paper.grids import TABLES, offset_ms, table_cells
from experiments.paper.quantities import POSE_ERRORS
from experiments.paper.results import COMPARISON_FILE, PAGE_FILE, RUNS_FILE, derived
from experiments.run.grid import Cell, config_names, named_config
from experiments.run.task import CRASHED
from ssac.errors import SsacError
from ssac.tool.registry import METHODS, OURS

PUBLISHED_SHA256 = {
    "esim_10.csv": "e4fc65f27fe6e67e162c81d89ccf66debf49f560e766675ead3288fc09b21cd7",
    "esim_20.csv": "e1f7cc80787b7a1d7baaae7ac3e6586780f6fdcef967e381a0861c41c390cdb7",
}
"""Of the paper's tables as they were copied."""

_SHOWN = 5  # faults of one kind
_CLEAN_COMMIT = re.compile(r"[0-9a-f]{7,40}")
_SEARCH_MS = 1000.0 + 20.0  # on each side of the truth, and a unit of the coarsest method
_ROUNDING_MS = 1e-2  # six digits of an estimate beyond 1000 ms: 5e-3; of its error, less
_RELATIVE_ROUNDING = 1e-5  # six digits of each run and of their mean: 1e-6


@dataclass(frozen=True)
class Finding:
    """One thing that was checked."""

    what: str
    faults: tuple[str, ...] = ()  # none: all right

    def lines(self) -> Iterator[str]:
        """Show it: one line, and one more for each of the first faults."""
        yield f"{'differs' if self.faults else 'ok':8}{self.what}"
        yield from (f"        - {fault}" for fault in self.faults[:_SHOWN])
        if len(self.faults) > _SHOWN:
            yield f"        - and {len(self.faults) - _SHOWN} more"


def file_findings(results: Path) -> list[Finding]:
    """Check all files of a folder of results against each other and the grids.

    Raises
    ------
    SsacError
        If a file is missing or cannot be read.
    """
    runs_text = read_text(results / RUNS_FILE)
    runs = runs_from_csv(runs_text)
    findings = [
        Finding(f"published/{name} is the paper's table", _published(PUBLISHED / name, digest))
        for name, digest in PUBLISHED_SHA256.items()
    ]
    cells = table_cells()
    missing = Finding(f"{RUNS_FILE} has every run of {' and '.join(TABLES)}", _missing(runs, cells))
    findings += [missing, *sanity_findings(runs), *ablation_findings(results, runs, cells)]
    for name in (RUNS_FILE, COMPARISON_FILE, *(f"{table}.csv" for table in TABLES)):
        path = (results / name).with_suffix(".provenance.json")
        findings.append(Finding(f"{name} was made at a clean commit", _commit(path)))
    provenance = read_provenance((results / RUNS_FILE).with_suffix(".provenance.json"))
    names = (*(f"{table}.csv" for table in TABLES), COMPARISON_FILE, PAGE_FILE)
    committed = {name: read_text(results / name) for name in names}
    try:
        made = derived(runs_text, provenance)
    except SsacError as error:
        return [*findings, Finding(f"the tables follow from {RUNS_FILE}", (str(error),))]
    return findings + [
        Finding(f"{name} follows from {RUNS_FILE}", text_difference(text, made.get(name, "")))
        for name, text in committed.items()
    ]


def sanity_findings(runs: pd.DataFrame) -> list[Finding]:
    """Check what must hold of any runs, whatever the methods find."""
    ok = runs[runs["status"] == "ok"]
    error_ms = ok["t_d_error_ms"]
    off = (ok["t_d_estimate_ms"] - ok["t_d_ms"]).abs() - error_ms
    impossible = (error_ms < 0.0) | (error_ms > _SEARCH_MS)
    for name in POSE_ERRORS:
        impossible |= (ok[name] < 0.0) | (ok[name] > 180.0)
    failed = runs[runs["status"] != "ok"]
    poses = ok[list(POSE_ERRORS)].notna().groupby(ok["method"]).mean()
    sometimes = ((poses > 0.0) & (poses < 1.0)).any(axis=1)
    counts = runs[runs["status"] != CRASHED].groupby(["duration_s", "angle_deg", "flight"])
    several = (counts[["n_events_cam1", "n_events_cam2"]].nunique() > 1).any(axis=1)
    return [
        Finding("no run crashed", _described(runs[runs["status"] == CRASHED])),
        Finding("every failed run has a reason", _described(failed[failed["reason"] == ""])),
        Finding("errors are those of the estimates", _described(ok[~(off.abs() <= _ROUNDING_MS)])),
        Finding("errors are possible ones", _described(ok[impossible])),
        Finding("a method gives a pose always or never", tuple(poses.index[sometimes])),
        Finding(
            "all methods and offsets saw the same recording",
            tuple(
                f"{duration_s:g} s, {angle_deg:g} deg, flight {flight:g}: other numbers of events"
                for duration_s, angle_deg, flight in several.index[several]
            ),
        ),
    ]


def ablation_findings(results: Path, runs: pd.DataFrame, cells: Sequence[Cell]) -> list[Finding]:
    """Compare the ablations with the tables at those points whose parameters are the tables'.

    Parameters
    ----------
    results : Path
        Folder; ablations that are not in it are left out.
    runs : pd.DataFrame
        Of the tables.
    cells : Sequence[Cell]
        Of the tables.
    """
    ok = runs[runs["status"] == "ok"]
    means = ok.groupby([name for name in KEY if name != "flight"])["t_d_error_ms"].mean()
    places = {
        (cell.sim, cell.t_d_s, cell.estimator, cell.method): (*_flight(cell)[:3], cell.method)
        for cell in cells
    }
    findings = []
    for name in config_names("ablation_"):
        path = results / f"{name}.csv"
        if not path.exists():
            continue
        grid = named_config(name)
        if {cell.flight for cell in grid.cells()} != {cell.flight for cell in cells}:
            continue
        found = _ablation_means(path, grid.varied)
        faults, common = [], 0
        for cell in grid.cells():
            place = places.get((cell.sim, cell.t_d_s, cell.estimator, cell.method))
            if place is None or cell.flight != grid.first_flight:
                continue
            point = (*(_shown(cell.parameters[key]) for key in grid.varied), cell.method)
            ours, table = found.get(point, np.nan), means.get(place, np.nan)
            common += 1
            if not np.isclose(ours, table, rtol=_RELATIVE_ROUNDING, atol=0.0):
                faults.append(f"{', '.join(point)}: {ours:g} ms, in the table {table:g} ms")
        if common:
            what = f"{path.name} has the tables' mean t_d errors where it has their parameters"
            findings.append(Finding(f"{what}: {common} points", tuple(faults)))
    return findings


def text_difference(committed: str, made: str) -> tuple[str, ...]:
    """Say where two texts first differ."""
    pairs = zip_longest(committed.splitlines(), made.splitlines(), fillvalue="nothing")
    for number, (old, new) in enumerate(pairs, start=1):
        if old != new:
            return (f"line {number} is {_short(old)}", f"line {number} should be {_short(new)}")
    return () if committed == made else ("the ends of lines are not the same",)


def read_text(path: Path) -> str:
    """Read a file of the results; SsacError when it cannot be read."""
    try:
        return path.read_bytes().decode("utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise SsacError(f"{path} cannot be read, `make tables` writes it: {error}") from error


def read_provenance(path: Path) -> dict[str, Any]:
    """Read a provenance; SsacError when it is none."""
    try:
        content = json.loads(read_text(path))
    except ValueError as error:
        raise SsacError(f"{path} is no JSON: {error}") from error
    if not isinstance(content, dict):
        raise SsacError(f"{path} holds no provenance")
    return content


def _missing(runs: pd.DataFrame, cells: Sequence[Cell]) -> tuple[str, ...]:
    """List runs of the grids that are not there just once, and runs that no grid has."""
    ours = {method.name for method in OURS}
    expected = {(*_flight(cell), cell.method) for cell in cells if cell.method in ours}
    there = list(runs[KEY].itertuples(index=False, name=None))
    flights = {_flight(cell) for cell in cells}
    faults = [("is missing", key) for key in expected - set(there)]
    faults += [("is there twice", key) for key, count in Counter(there).items() if count > 1]
    faults += [
        ("is in no grid", key)
        for key in there
        if key[:-1] not in flights or key[-1] not in METHODS  # another package may add a method
    ]
    return tuple(
        f"{describe(dict(zip(KEY, key, strict=True)))} {what}" for what, key in sorted(faults)
    )


def _flight(cell: Cell) -> tuple[float, float, float, int]:
    """All of a cell's KEY but the method."""
    return (
        cell.sim.spline.duration_s,
        cell.sim.angle_deg,
        offset_ms(cell),
        cell.flight,
    )


def _ablation_means(path: Path, varied: Sequence[str]) -> dict[tuple[str, ...], float]:
    """Mean t_d error [ms] by the texts of the varied parameters and the method."""
    table = pd.read_csv(StringIO(read_text(path)), dtype=str, keep_default_na=False)
    columns = [*varied, "method"]
    absent = {*columns, "t_d_error_ms_mean"} - set(table)
    if absent:
        raise SsacError(f"{path} lacks the columns {', '.join(sorted(absent))}")
    means = pd.to_numeric(table["t_d_error_ms_mean"], errors="coerce")
    return dict(zip(table[columns].itertuples(index=False, name=None), means, strict=True))


def _shown(value: Any) -> str:
    """Show a parameter as the CSV does."""
    return f"{value:.6g}" if isinstance(value, (int, float)) else json.dumps(value)


def _published(path: Path, digest: str) -> tuple[str, ...]:
    same = hashlib.sha256(read_text(path).encode()).hexdigest() == digest
    return () if same else (f"{path} was changed",)


def _commit(path: Path) -> tuple[str, ...]:
    commit = str(read_provenance(path).get("commit"))
    if _CLEAN_COMMIT.fullmatch(commit):
        return ()
    return (f"its commit is {commit}: commit the code, then make it again",)


def _described(runs: pd.DataFrame) -> tuple[str, ...]:
    return tuple(describe(row) for row in runs.to_dict("records"))


def _short(line: str) -> str:
    return line if len(line) <= 160 else f"{line[:157]}..."
