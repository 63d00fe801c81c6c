"""The committed results in, whether they can be trusted out: `ssac verify`.

First the files against each other and the grids; then a small, fixed part of the runs again, from
nothing: simulated into a folder of its own, estimated, and put beside the committed rows.
Exit code 0: all right; 1: something differs; 2: a file is missing or cannot be read.
"""

import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import pandas as pd
import typer

from experiments.paper.esim import (
    KEY,
    csv_text,
    describe,
    ordered_runs,
    runs_from_csv,
    runs_of_grid,
)
from experiments.paper.results import RUNS_FILE
from experiments.paper.verify_files import Finding, file_findings, read_text
from experiments.run.cache import Cache
from experiments.run.grid import Cell, named_config
from experiments.run.schedule import Workers, run_cells
from experiments.run.task import CRASHED
from ssac.tool.registry import METHODS, OURS, Input

PART_GRID, PART_ANGLES_DEG, PART_FLIGHT = "esim_10", (30.0, 150.0), 0
"""What is run again: the shortest flights, the easiest and the hardest angle, all offsets."""

# How far a run may be from the committed one. On one machine nothing differs, not even between
# OSMesa and EGL of one Mesa. Elsewhere the OpenGL driver, the processor or a library may change the
# events a little. Each tolerance is twice the largest difference that was found when 1 % of the
# events were taken away and the others moved by 60 us (standard deviation), eight times an angle.
TRACK_TOLERANCES = {"t_d_estimate_ms": 0.06, "r_error_deg": 0.1, "t_error_deg": 0.05}
TANGENCY_TOLERANCES = {**TRACK_TOLERANCES, "t_d_estimate_ms": 0.1}  # it rests on single events
EVENT_RATE_TOLERANCE_MS = 6.0
UNIT_MS = {"zncc_e": 10.0, "zncc_f": 20.0}
"""One unit of their offsets: zncc_e did not change then, and zncc_f sees frames alone."""


def verify_command(
    results: Annotated[Path, typer.Option(help="Folder of `ssac tables`.")] = Path("results"),
    recompute: Annotated[
        bool, typer.Option(help="Also run a small part again from nothing (a minute).")
    ] = True,
    workers: Annotated[int, typer.Option(help="Processes; -1: one for each core.")] = -1,
) -> None:
    """Check the results against each other, and a small part of them against a run from nothing."""
    runs = runs_from_csv(read_text(results / RUNS_FILE))
    failed = _report(file_findings(results))
    if recompute:
        with tempfile.TemporaryDirectory(prefix="ssac-verify-") as folder:
            again = run_cells(part_cells(), Cache(Path(folder)), Workers(workers), "verifying").runs
        failed += _report(run_findings(runs_of_grid(again), runs))
    typer.echo(f"{failed} of the checks above differ" if failed else "all of it as committed")
    if failed:
        raise typer.Exit(1)


def part_cells() -> list[Cell]:
    """List the cells that are run again."""
    ours = {method.name for method in OURS}
    part = replace(named_config(PART_GRID), first_flight=PART_FLIGHT, flights=1)
    return [
        cell
        for cell in part.cells()
        if cell.sim.angle_deg in PART_ANGLES_DEG and cell.method in ours
    ]


def run_findings(again: pd.DataFrame, committed: pd.DataFrame) -> list[Finding]:
    """Compare runs with the committed ones: one finding for each method and number.

    Parameters
    ----------
    again, committed : pd.DataFrame
        tables.RUN_COLUMNS; of `committed` only the runs of `again` count.
    """
    again = runs_from_csv(csv_text(ordered_runs(again)))  # rounded as the committed ones are
    both = again.merge(committed, on=KEY, how="left", suffixes=("", "_committed"))
    findings = []
    for method, part in both.groupby("method", sort=False):
        other = (part["status"] != part["status_committed"]) | (part["status"] == CRASHED)
        faults = _beside(part[other], "status")
        findings.append(Finding(f"{method}: status of {len(part)} runs", faults))
        for column, tolerance in tolerances(str(method)).items():
            mine, theirs = part[column], part[f"{column}_committed"]
            if mine.isna().all() and theirs.isna().all():
                continue
            differences = (mine - theirs).abs().mask(mine.isna() & theirs.isna(), 0.0)
            what = f"largest difference {differences.max():.3g}, tolerated {tolerance:g}"
            faults = _beside(part[~(differences <= tolerance)], column)
            findings.append(Finding(f"{method}: {column}: {what}", faults))
    return findings


def tolerances(method: str) -> dict[str, float]:
    """How far each number of a method's run may be from the committed one."""
    if METHODS[method].input is Input.TRACKS:
        return TANGENCY_TOLERANCES if method.startswith("tangency") else TRACK_TOLERANCES
    return {"t_d_estimate_ms": UNIT_MS.get(method, EVENT_RATE_TOLERANCE_MS)}


def _beside(runs: pd.DataFrame, column: str) -> tuple[str, ...]:
    """Show what is in a column of runs, and what is committed there."""
    return tuple(
        f"{describe(row)}: {row[column]}, committed: {row[f'{column}_committed']}. {row['reason']}"
        for row in runs.to_dict("records")
    )


def _report(findings: Sequence[Finding]) -> int:
    """Print findings; return how many differ."""
    for finding in findings:
        for line in finding.lines():
            typer.echo(line)
    return sum(bool(finding.faults) for finding in findings)
