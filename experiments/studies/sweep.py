"""Any grid in TOML in, a tidy CSV of all its runs out, in shards or whole: `ssac sweep`, `merge`.

Every parameter is a column under its dotted name, every run a row; `cell` numbers them over the
whole grid or study, so that the rows of all shards, sorted by it, are the bytes of one piece.
"""

import json
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from experiments.lab.bridge import check_mesh
from experiments.lab.cache import DEFAULT_FOLDER, Cache
from experiments.lab.command import CacheOption, SchedulerOption, WorkersOption, finish
from experiments.lab.files import record_checksums, save_csv, save_text
from experiments.lab.grid import grid_from_content, load_config
from experiments.lab.provenance import save_provenance, write_provenance
from experiments.lab.schedule import Workers
from experiments.lab.scored import SCORED
from experiments.lab.study import WHOLE, Study, numbered, parse_shard, run_numbered, save_derived
from experiments.studies.catalogue import STUDIES
from experiments.studies.command import ShardOption
from sim.render.gl_context import context_or_none
from ssac.errors import SsacError
from ssac.files.whole_file import check_writable


def sweep_command(
    config: Annotated[
        Path,
        typer.Argument(
            help="TOML file of the grid (docs/sweeps.md).", metavar="CONFIG", show_default=False
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option(help="CSV to write.  [default: results/<config>.csv]", metavar="FILE"),
    ] = None,
    shard: ShardOption = "1/1",
    workers: WorkersOption = -1,
    scheduler: SchedulerOption = "",
    cache: CacheOption = DEFAULT_FOLDER,
) -> None:
    """Run any grid over any parameters of simulator and estimator; one CSV row per run."""
    start = time.perf_counter()
    grid = load_config(config)
    part = parse_shard(shard)
    out = out or Path("results") / f"{grid.name}.csv"
    check_writable(out)
    cells = grid.cells()
    for mesh in {cell.sim.drone_file for cell in cells if cell.sim.drone_file is not None}:
        check_mesh(mesh)
    outcome = run_numbered(
        numbered(cells, part), SCORED, Cache(cache), Workers(workers, scheduler), grid.name
    )
    save_csv(out, outcome.runs)
    command = f"ssac sweep {config}" + (f" --shard {shard}" if part != WHOLE else "")
    save_provenance(
        out, command, {"grid": dict(grid.content), "name": grid.name, "shard": shard},
        time.perf_counter() - start, context_or_none(),
    )  # fmt: skip
    finish(outcome, Cache(cache), out)


def merge_command(
    out: Annotated[Path, typer.Argument(help="CSV to write.", metavar="OUT", show_default=False)],
    shards: Annotated[
        list[Path],
        typer.Argument(
            help="CSVs of all shards of one sweep or study.", metavar="SHARD", show_default=False
        ),
    ],
) -> None:
    """Join the shards of a sweep or study: the same bytes as in one piece.

    Of a study, its summary and figure are made too, beside the runs.
    """
    check_writable(out)
    text, provenance = merged(shards)
    study = _study_of(provenance)
    if study is not None and out.name != study.runs_file:
        raise SsacError(f"{out}: the runs of this study are named {study.runs_file}")
    save_text(out, text)
    written = [out] if study is None else [out, *save_derived(study, out.parent)]
    for path in written:
        if path.suffix == ".csv":
            write_provenance(path, provenance)
        typer.echo(f"written to {path}")
    if study is not None:
        record_checksums(out.parent, written)


def merged(shards: Sequence[Path]) -> tuple[str, dict[str, Any]]:
    """Join shards.

    Returns
    -------
    text : str
        Of the CSV.
    provenance : dict[str, Any]
        What the shards have in common, and the provenance of each.

    Raises
    ------
    SsacError
        If the shards are of different grids, overlap, or do not cover the grid.
    """
    provenances = [_read_provenance(path) for path in shards]
    wholes = [
        {key: value for key, value in one["config"].items() if key != "shard"}
        for one in provenances
    ]
    rows: dict[int, tuple[str, Path]] = {}
    header = ""
    for path, whole in zip(shards, wholes, strict=True):
        if whole != wholes[0]:
            raise SsacError(f"{path} is of another grid than {shards[0]}: merge the shards of one")
        first, *lines = _lines(path)
        if header and first != header:
            raise SsacError(f"{path} has other columns than {shards[0]}: was the code the same?")
        header = first
        for line in lines:
            number = _number(line, path)
            if number in rows:
                raise SsacError(f"cell {number} is in {rows[number][1]} and in {path}")
            rows[number] = line, path
    provenance = {"command": "ssac merge", "config": wholes[0], "shards": provenances}
    n_cells = _n_cells(provenance)
    missing = sorted(set(range(n_cells)) - set(rows))
    if missing:
        raise SsacError(
            f"{len(missing)} of {n_cells} cells are in none of the shards, the first of them "
            f"{missing[0]}: give the CSVs of all shards"
        )
    text = "\n".join([header, *(rows[number][0] for number in range(n_cells))]) + "\n"
    return text, provenance


def _lines(path: Path) -> list[str]:
    try:
        lines = path.read_bytes().decode("utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise SsacError(f"{path}: cannot be read ({error}): run this shard again") from error
    if not lines:
        raise SsacError(f"{path}: is empty: run this shard again")
    return lines


def _number(line: str, path: Path) -> int:
    first = line.partition(",")[0]
    if not (first.isascii() and first.isdecimal()):
        raise SsacError(
            f"{path}: a row begins with {first[:40]!r}, no cell's number: run this shard again"
        )
    return int(first)


def _study_of(provenance: dict[str, Any]) -> Study | None:
    """Look up the study that shards are of; None of a sweep."""
    name = provenance["config"].get("study")
    if name is None:
        return None
    if name not in STUDIES:
        raise SsacError(f"the shards are of the study {name!r}, which is none of this version")
    return STUDIES[name]


def _n_cells(provenance: dict[str, Any]) -> int:
    study = _study_of(provenance)
    if study is not None:
        return len(study.cells())
    config = provenance["config"]
    return len(grid_from_content(config["name"], config["grid"]).cells())


def _read_provenance(path: Path) -> dict[str, Any]:
    beside = path.with_suffix(".provenance.json")
    try:
        content: dict[str, Any] = json.loads(beside.read_text(encoding="utf-8"))
        content["config"]["shard"]
        if not isinstance(content["config"], dict):
            raise TypeError("config is no table")
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise SsacError(
            f"{path}: expected {beside.name} beside it, as ssac sweep and ssac study write it, to "
            f"know what it is part of ({error})"
        ) from error
    return content
