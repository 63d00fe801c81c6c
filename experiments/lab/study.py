"""A study: its cells, a measure, and the files, quoted numbers and checks that its rows give.

Studies are declared in the files of `experiments/studies/`, each of which ends with a list of them.
Code that all studies share stands in this folder: they run on one scheduler and cache, can be
stopped and resumed, and spread over machines. Whatever is made from the rows is made from the text
of their file, with its rounded numbers, so that anyone who has the file makes the same bytes.
"""

import json
import time
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from inspect import Parameter, signature
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pandas as pd

from experiments.lab.cache import Cache
from experiments.lab.cell import Flight, Measure, PlainCell
from experiments.lab.provenance import provenance, provenance_file
from experiments.lab.results import (
    DIGITS,
    MERGED,
    PROVENANCE,
    SUMS_FILE,
    File,
    Results,
    csv_text,
    png_bytes,
    read_checksums,
    read_table,
    save_files,
)
from experiments.lab.schedule import Outcome, Workers, run_alone, run_cells, tasks_of
from sim.render.gl_context import context_or_none
from ssac.errors import SsacError
from ssac.files.whole_file import check_folder
from ssac.pipeline.registry import OURS

if TYPE_CHECKING:
    from matplotlib.figure import Figure

CELL = "cell"  # column of a cell's number within the whole study
WHOLE = (1, 1)  # the shard (i, n) that holds all cells
SHARD = "shard"  # key in a provenance's configuration of which part of the study was run

Options = Mapping[str, Any]  # arguments of a study's `cells`; those left out have their defaults


class How(Enum):
    """How the cells of a study are run."""

    SHARED = "on processes or a cluster, each row kept"
    ALONE = "one after the other in processes of their own, on one core, measured anew each time"
    GIVEN = "as SHARED, of data that the user gives: nobody else can list the cells"


@dataclass(frozen=True)
class Runs:
    """The file of all rows: the columns of each cell, then the measured ones."""

    file: str
    keys: tuple[str, ...]  # columns whose values together identify a row
    columns: tuple[str, ...] = ()  # columns to write, in order; empty: all
    numbered: bool = True  # whether a column CELL comes first; a shard's file always has it
    digits: int = DIGITS
    took: tuple[str, ...] = ()  # columns of run times and the like, which never repeat exactly
    table: Callable[[pd.DataFrame, Results], pd.DataFrame] | None = None
    """Makes the written table from all rows, if it has not one line per row: only How.ALONE."""


NO_RUNS = Runs("", ())


@dataclass(frozen=True)
class Made:
    """One file that is made from the files of results: a table, a figure or a page."""

    file: str
    # Takes Results, then the recordings' folders; returns None where there is to be no file. None:
    # the study's own command makes the file, from data that nobody else has.
    make: "Callable[..., pd.DataFrame | Figure | bytes | str | None] | None"
    # Options of `cells` -> recordings that the file needs too; verify checks only its checksum.
    recordings: Callable[..., tuple[Flight, ...]] | None = None
    config: Mapping[str, Any] | None = None  # for its provenance; None: the study's

    @property
    def follows(self) -> bool:
        """Whether the file is made from files of results alone."""
        return self.make is not None and self.recordings is None

    def filmed(self, options: Options | None = None) -> tuple[Flight, ...]:
        """Return the flights whose recordings the file needs."""
        return self.recordings(**(options or {})) if self.recordings else ()

    def bytes_of(self, results: Results, *folders: Path) -> bytes | None:
        """Make the file's content."""
        assert self.make is not None
        made = self.make(results, *folders)
        if isinstance(made, pd.DataFrame):
            made = csv_text(made)
        if made is None or isinstance(made, bytes):
            return made
        return made.encode() if isinstance(made, str) else png_bytes(made)


Check = tuple[str, Callable[[Results], Iterable[str]]]
"""A condition on the results in words, and a function that finds violations of it."""


@dataclass(frozen=True, eq=False)
class Study:
    """A question that many runs answer."""

    name: str
    title: str
    cells: Callable[..., Sequence[PlainCell]]  # its parameters are the options of the command
    measure: Measure
    runs: Runs  # NO_RUNS: no cells, and files made from others' results
    makes: tuple[Made, ...] = ()
    numbers: Mapping[str, Callable[[Results], str]] = field(default_factory=dict)  # for pages
    checks: tuple[Check, ...] = ()
    config: Mapping[str, Any] = field(default_factory=dict)  # for provenance
    command: str = ""  # command that runs it; by default `ssac study <name>`
    how: How = How.SHARED
    again: bool = True  # whether `ssac verify` draws recordings from it by default
    reads: tuple[str, ...] = ()  # files of other studies that its own files are made from
    shows: str = ""  # the table that its command prints at the end
    committed: Options = field(default_factory=dict)  # arguments of `cells` for the committed files
    is_committed: bool = True  # whether its files belong to results/

    @property
    def files(self) -> tuple[str, ...]:
        """Names of all its files without the provenances."""
        return tuple(filter(None, (self.runs.file, *(made.file for made in self.makes))))

    @property
    def provenances(self) -> dict[str, Mapping[str, Any]]:
        """Names of its provenance files -> configuration."""
        made = {made.file: made.config or self.config for made in self.makes}
        tables = {file: made.get(file, self.config) for file in self.files if file.endswith(".csv")}
        tables = tables or {self.name: self.config}  # only figures
        return {file.removesuffix(".csv") + PROVENANCE: one for file, one in tables.items()}

    @property
    def options(self) -> dict[str, Any]:
        """Defaults of the arguments of `cells`; `Parameter.empty` for a required argument."""
        return {name: one.default for name, one in signature(self.cells).parameters.items()}

    def command_line(self, options: Options | None = None, shard: tuple[int, int] = WHOLE) -> str:
        """Return the command line that runs the study."""
        words = [self.command or f"ssac study {self.name}"]
        for name, value in (options or {}).items():
            default, flag = self.options[name], name.replace("_", "-")
            if default is Parameter.empty:
                words.append(str(value))
            elif value != default:
                words.append(f"--no-{flag}" if value is False else f"--{flag}")
                words += [] if isinstance(value, bool) else [str(value)]
        return " ".join([*words, *([f"--shard {shard[0]}/{shard[1]}"] if shard != WHOLE else [])])


def run_study(
    study: Study,
    cache: Cache,
    workers: Workers,
    shard: tuple[int, int] = WHOLE,
    options: Options | None = None,
) -> Outcome:
    """Measure the cells of a study or shard that are not in the cache; column CELL comes first."""
    every = study.cells(**(options or {}))
    if not every:
        raise SsacError(f"{study.name}: there are no runs with these options: choose others")
    of_shard = numbered(every, shard)
    cells = [cell for _, cell in of_shard]
    if study.how is How.ALONE:
        outcome = run_alone(cells, study.measure, study.name)
    else:
        outcome = run_cells(cells, cache, workers, study.name, measure=study.measure)
    if not cells:  # more shards than tasks: a file of column names, which can be merged
        columns = [*every[0].columns, *outcome.runs]
        return replace(outcome, runs=outcome.runs.reindex(columns=[CELL, *columns]))
    outcome.runs.insert(0, CELL, [number for number, _ in of_shard])
    return outcome


def numbered(
    cells: Sequence[PlainCell], shard: tuple[int, int] = WHOLE
) -> list[tuple[int, PlainCell]]:
    """Return the numbered cells of shard (i, n), i from 1: those of every n-th task from i on."""
    index, n_shards = shard
    mine = {id(cell) for task in tasks_of(cells)[index - 1 :: n_shards] for cell in task}
    return [(number, cell) for number, cell in enumerate(cells) if id(cell) in mine]


def parse_shard(text: str) -> tuple[int, int]:
    """Parse a shard "i/n"; SsacError when the text is not one."""
    first, _, second = text.partition("/")
    if not (first.isdecimal() and second.isdecimal() and 1 <= int(first) <= int(second)):
        raise SsacError(f"--shard: expected i/n with 1 <= i <= n, such as 2/8, got {text!r}")
    return int(first), int(second)


def check_reads(study: Study, out: Path, made_before: Collection[str] = ()) -> None:
    """Raise SsacError, before hours of work, when a file that a study reads is not there."""
    absent = [one for one in study.reads if one not in made_before and not (out / one).is_file()]
    if absent:
        raise SsacError(
            f"`{study.command_line()}` needs {', '.join(absent)} in {out}: make them first"
        )


def check_own(study: Study, out: Path, shard: tuple[int, int] = WHOLE) -> None:
    """Raise SsacError, before hours of work, when a grid or a shard would replace our results."""
    if (study.is_committed and shard == WHOLE) or not (out / SUMS_FILE).is_file():
        return
    ours = set(study.files) & set(read_checksums(out))
    if ours:
        raise SsacError(
            f"{out / min(ours)}: is a result of the project, and would be lost: name another file"
            " or folder by --out, or rename the TOML file"
        )


def save_study(
    study: Study,
    out: Path,
    cache: Cache,
    workers: Workers,
    shard: tuple[int, int],
    options: Options | None = None,
) -> tuple[Outcome, list[Path]]:
    """Run a study or a shard of it, write its files into a folder, and return their paths."""
    check_folder(out)
    start = time.perf_counter()
    given = {name: value for name, value in (options or {}).items() if name in study.options}
    others = {name: value for name, value in given.items() if value != study.options[name]}
    config = {"study": study.name, SHARD: f"{shard[0]}/{shard[1]}", **study.config}
    outcome = run_study(study, cache, workers, shard, given)
    make_table = study.runs.table
    rows = make_table(outcome.runs, Results(out)) if make_table else outcome.runs
    content = provenance(
        study.command_line(given, shard),
        config | ({"options": others} if others else {}),
        time.perf_counter() - start,
        context_or_none(),
        recordings_simulated=outcome.n_simulated,
        peak_mb_per_worker=round(outcome.peak_mb),
    )
    text = runs_text(study.runs, rows, shard)
    return outcome, save_made(study, out, cache, text, content, shard == WHOLE, given)


def save_made(
    study: Study,
    out: Path,
    cache: Cache,
    runs: str,
    content: Mapping[str, Any],
    is_whole: bool = True,
    options: Options | None = None,
) -> list[Path]:
    """Write the rows, the files made from them, and each table's provenance; return their paths."""
    results = Results(out)

    def files() -> Iterator[File]:
        yield study.runs.file, runs.encode()
        yield provenance_file(study.runs.file, content)
        for made in study.makes if is_whole else ():
            folders = [cache.recording_folder(*flight) for flight in made.filmed(options)]
            yield made.file, made.bytes_of(results, *folders)
            if made.file.endswith(".csv"):
                config = content["config"] if made.config is None else made.config
                yield provenance_file(made.file, {**content, "config": config})

    return save_files(out, files(), study.is_committed and is_whole)


def runs_text(kept: Runs, runs: pd.DataFrame, shard: tuple[int, int] = WHOLE) -> str:
    """Format rows as the text of their file; those of a shard begin with the cells' numbers."""
    columns = [*kept.columns] or [str(name) for name in runs if name != CELL]
    is_numbered = kept.numbered or shard != WHOLE
    return csv_text(runs[[CELL, *columns] if is_numbered else columns], kept.digits)


def check_runs(study: Study, runs: pd.DataFrame, cells: Sequence[PlainCell]) -> None:
    """Raise SsacError unless every cell of the study has exactly one row, in the order of cells."""
    kept, again = study.runs, f": run `{study.command_line()}`"
    expected = read_table(csv_text(pd.DataFrame([dict(cell.columns) for cell in cells])))
    if len(runs) != len(expected) and "method" in expected:
        ours = expected["method"].isin([one.name for one in OURS])
        expected = expected[ours].reset_index(drop=True)  # other packages' methods are not in it
    names = [str(name) for name in expected]
    needed = [*([CELL] if kept.numbered else []), *names, "status"]
    absent = [name for name in needed if name not in runs]
    if absent:
        raise SsacError(f"{kept.file}: has no columns {', '.join(absent)}{again}")
    n = len(expected)
    if len(runs) != n or (kept.numbered and list(runs[CELL]) != list(range(n))):
        raise SsacError(
            f"{kept.file}: expected the cells 0 to {n - 1} in order, got {len(runs)} rows{again}"
        )
    unlike = (runs[names].astype(str) != expected.astype(str)).any(axis=1).to_numpy()
    if unlike.any():
        row = int(unlike.argmax())
        found, wanted = runs[names].to_dict("records")[row], expected.to_dict("records")[row]
        raise SsacError(f"{kept.file}: row {row} is of {found}, expected {wanted}{again}")


def merge(
    shards: Sequence[Path], out: Path, study_of: Callable[[Mapping[str, Any]], Study], cache: Cache
) -> list[Path]:
    """Join the shards of a study to the same bytes as a run in one piece, and make its other files.

    Each shard has its provenance beside it; `study_of` returns the study of its configuration.
    SsacError if the shards are of different grids or code, overlap, are cut off or leave out cells.
    """
    provenances = [_read_provenance(path) for path in shards]
    wholes = [{k: v for k, v in one["config"].items() if k != SHARD} for one in provenances]
    lines: dict[int, tuple[str, Path]] = {}
    headers = []
    for path, whole, one in zip(shards, wholes, provenances, strict=True):
        if whole != wholes[0]:
            raise SsacError(f"{path} is of another grid than {shards[0]}: merge the shards of one")
        for what, name in (("code", "commit"), ("packages", "versions")):
            if one.get(name) != provenances[0].get(name):
                raise SsacError(
                    f"{path} is of the {what} {one.get(name)}, and {shards[0]} of"
                    f" {provenances[0].get(name)}: run these shards with the same {what}"
                )
        header, rows = _numbered_lines(path)
        headers.append(header)
        if header != headers[0]:
            raise SsacError(f"{path} has other columns than {shards[0]}: was the code the same?")
        for number, line in rows:
            if number in lines:
                raise SsacError(f"cell {number} is in {lines[number][1]} and in {path}")
            lines[number] = line, path
    study = study_of(wholes[0])
    if out.name != study.runs.file:
        raise SsacError(f"{out}: the runs of this study are named {study.runs.file or 'none'}")
    if study.files.count(out.name) > 1:  # of an ablation, whose table has the shards' name
        raise SsacError(f"{out}: would be written twice: name it {study.name}_runs.csv")
    n_cells = len(study.cells(**wholes[0].get("options", {})))
    missing = sorted(set(range(n_cells)) - set(lines))
    if missing:
        raise SsacError(
            f"{len(missing)} of {n_cells} cells are in none of the shards, the first of them "
            f"{missing[0]}: give the CSVs of all shards"
        )
    check_own(study, out.parent)
    text = [headers[0], *(lines[number][0] for number in range(n_cells))]
    if not study.runs.numbered:
        text = [line.partition(",")[2] for line in text]
    content = {"command": MERGED, "config": wholes[0], "shards": provenances}
    runs, options = "\n".join(text) + "\n", wholes[0].get("options")
    return save_made(study, out.parent, cache, runs, content, options=options)


def _numbered_lines(path: Path) -> tuple[str, list[tuple[int, str]]]:
    """Read a shard: its header, and the other lines, each with the cell's number at its start."""
    try:
        text = path.read_bytes().decode("utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise SsacError(f"{path}: cannot be read ({error}): run this shard again") from error
    if not text.strip() or not text.endswith("\n"):  # as every table does
        raise SsacError(f"{path}: is empty, or its end is missing: run this shard again")
    header, *lines = text.splitlines()
    numbers = [line.partition(",")[0] for line in lines]
    for number in numbers:
        if not (number.isascii() and number.isdecimal()):
            raise SsacError(
                f"{path}: a row begins with {number[:40]!r}, no cell's number: run this shard again"
            )
    return header, list(zip(map(int, numbers), lines, strict=True))


def _read_provenance(path: Path) -> dict[str, Any]:
    beside = path.with_suffix(PROVENANCE)
    try:
        content: dict[str, Any] = json.loads(beside.read_text(encoding="utf-8"))
        content["config"][SHARD]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise SsacError(
            f"{path}: expected {beside.name} beside it, as ssac sweep and ssac study write it, to "
            f"know what it is part of ({error})"
        ) from error
    return content
