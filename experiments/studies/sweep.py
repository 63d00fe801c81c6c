"""A grid in TOML in, a tidy CSV of all its runs out, in shards or whole: `ssac sweep`, `merge`.

Every parameter is a column under its dotted name, every run a row; `cell` numbers them over the
whole grid, so that the rows of all shards, sorted by it, are the bytes of the sweep in one piece.
"""

import json
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import pandas as pd
import typer

from experiments.paper.esim import csv_text
from experiments.run.cache import DEFAULT_FOLDER, Cache
from experiments.run.command import CacheOption, SchedulerOption, WorkersOption, finish
from experiments.run.grid import Cell, GridConfig, grid_from_content, load_config
from experiments.run.provenance import save_provenance, write_provenance
from experiments.run.schedule import Workers, run_cells
from experiments.run.task import tasks_of
from sim.render.gl_context import open_context
from ssac.errors import SsacError
from ssac.files.whole_file import whole_file


def sweep_command(
    config: Annotated[Path, typer.Argument(help="TOML of the grid.", show_default=False)],
    out: Annotated[
        Path | None, typer.Option(help="CSV to write.  [default: results/<config>.csv]")
    ] = None,
    shard: Annotated[str, typer.Option(help="Run only part i of n: i/n.")] = "1/1",
    workers: WorkersOption = -1,
    scheduler: SchedulerOption = "",
    cache: CacheOption = DEFAULT_FOLDER,
) -> None:
    """Run any grid over any parameters of simulator and estimator; one CSV row per run."""
    start = time.perf_counter()
    grid = load_config(config)
    part = _parse_shard(shard)
    out = out or Path("results") / f"{grid.name}.csv"
    numbered = shard_cells(grid, *part)
    outcome = run_cells(
        [cell for _, cell in numbered], Cache(cache), Workers(workers, scheduler), grid.name
    )
    runs = outcome.runs.copy()
    runs.insert(0, "cell", [number for number, _ in numbered])
    save_csv(out, runs)
    command = f"ssac sweep {config}" + (f" --shard {shard}" if part != (1, 1) else "")
    save_provenance(
        out, command, {"grid": dict(grid.content), "name": grid.name, "shard": shard},
        time.perf_counter() - start, open_context(),
    )  # fmt: skip
    finish(outcome, Cache(cache), out)


def merge_command(
    out: Annotated[Path, typer.Argument(help="CSV to write.", show_default=False)],
    shards: Annotated[
        list[Path], typer.Argument(help="CSVs of all shards of one grid.", show_default=False)
    ],
) -> None:
    """Join the shards of a sweep: the same bytes as the sweep in one piece."""
    text, provenance = merged(shards)
    out.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(out) as temporary:
        temporary.write_text(text, encoding="utf-8")
    write_provenance(out, provenance)
    typer.echo(f"written to {out}")


def shard_cells(grid: GridConfig, index: int, n_shards: int) -> list[tuple[int, Cell]]:
    """Return the numbered cells of shard `index` (from 1): every n-th recording with all its runs.

    A recording is never split, so no two shards simulate the same one.
    """
    cells = grid.cells()
    number = {id(cell): at for at, cell in enumerate(cells)}
    mine = [cell for task in tasks_of(cells)[index - 1 :: n_shards] for cell in task.cells]
    return sorted(((number[id(cell)], cell) for cell in mine), key=lambda pair: pair[0])


def merged(shards: Sequence[Path]) -> tuple[str, dict[str, Any]]:
    """Join shards.

    Returns
    -------
    text : str
        Of the CSV.
    provenance : dict[str, Any]
        The common grid, and the provenance of each shard.

    Raises
    ------
    SsacError
        If the shards are of different grids, overlap, or do not cover the grid.
    """
    provenances = [_read_provenance(path) for path in shards]
    grids = [{key: one["config"][key] for key in ("grid", "name")} for one in provenances]
    rows: dict[int, tuple[str, Path]] = {}
    header = ""
    for path, grid in zip(shards, grids, strict=True):
        if grid != grids[0]:
            raise SsacError(f"{path} is of another grid than {shards[0]}: merge the shards of one")
        first, *lines = path.read_text(encoding="utf-8").splitlines()
        if header and first != header:
            raise SsacError(f"{path} has other columns than {shards[0]}: was the code the same?")
        header = first
        for line in lines:
            number = int(line.partition(",")[0])
            if number in rows:
                raise SsacError(f"cell {number} is in {rows[number][1]} and in {path}")
            rows[number] = line, path
    n_cells = len(grid_from_content(grids[0]["name"], grids[0]["grid"]).cells())
    missing = sorted(set(range(n_cells)) - set(rows))
    if missing:
        raise SsacError(
            f"{len(missing)} of {n_cells} cells are in none of the shards, the first of them "
            f"{missing[0]}: give the CSVs of all shards"
        )
    text = "\n".join([header, *(rows[number][0] for number in range(n_cells))]) + "\n"
    return text, {"command": "ssac merge", "config": grids[0], "shards": provenances}


def save_csv(path: Path, table: pd.DataFrame) -> None:
    """Write a table whole; lists become JSON."""
    table = table.copy()
    for name in table.columns:
        if table[name].map(lambda value: isinstance(value, (list, tuple))).any():
            table[name] = table[name].map(json.dumps)
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as temporary:
        temporary.write_text(csv_text(table), encoding="utf-8", newline="\n")


def _parse_shard(text: str) -> tuple[int, int]:
    first, _, second = text.partition("/")
    if not (first.isdecimal() and second.isdecimal() and 1 <= int(first) <= int(second)):
        raise SsacError(f"--shard: expected i/n with 1 <= i <= n, such as 2/8, got {text!r}")
    return int(first), int(second)


def _read_provenance(path: Path) -> dict[str, Any]:
    beside = path.with_suffix(".provenance.json")
    try:
        content: dict[str, Any] = json.loads(beside.read_text(encoding="utf-8"))
        content["config"]["grid"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise SsacError(
            f"{path}: expected {beside.name} beside it, as ssac sweep writes it, to know the grid "
            f"that it is part of ({error})"
        ) from error
    return content
