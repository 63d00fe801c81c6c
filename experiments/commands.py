"""Commands over all studies: run them, join shards, check committed results and quoted numbers."""

import secrets
import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from experiments.lab.again import draw, recomputed, sources_of
from experiments.lab.cache import DEFAULT_FOLDER, Cache
from experiments.lab.command import CacheOption, Chosen, WorkersOption, chosen, running
from experiments.lab.grid import GridConfig, grid_from_content, load_config
from experiments.lab.quote import pages, rewrite_numbers, stale_numbers
from experiments.lab.recorded import check_mesh
from experiments.lab.results import Results
from experiments.lab.schedule import Workers
from experiments.lab.study import How, Study, merge
from experiments.lab.verify import Finding, file_findings, found, shared_findings, study_findings
from experiments.paper.comparison import PUBLISHED_SHA256
from experiments.scenes.options import MAX_SEED
from experiments.studies import all_studies
from experiments.studies.ablations import ABLATIONS, sweep_study
from ssac.cli.options import argument, flag, named, number
from ssac.errors import SsacError
from ssac.files.ros_bags import bag_of
from ssac.files.whole_file import check_targets, check_writable

N_RECORDINGS = 6  # by default the number of recordings that `ssac verify` draws


@running
def study_command(
    names: Annotated[
        list[str] | None,
        argument(
            "NAME", "Studies to run; --list names them. One of your own data has these behind it."
        ),
    ] = None,
    list_them: Annotated[bool, flag("list", "List the studies.")] = False,
) -> Chosen:
    """Run studies; all runs and their summary as CSV, and a figure each."""
    known = {
        name: study
        for name, study in all_studies().items()
        if not study.command or study.command.startswith("ssac ablate")  # no command of its own
    }
    if list_them:
        for study in known.values():
            typer.echo(f"{study.name:20} {study.title}")
        raise typer.Exit
    if not names:
        raise SsacError(f"name a study: {', '.join(known)}")
    first = known.get(names[0])
    if first is not None and first.how is How.GIVEN:
        return [first], _given(first, names[1:])
    studies = chosen(names, known, "study")
    for study in studies:
        if study.how is How.GIVEN:
            raise SsacError(f"{study.name}: is of your own data: run it by itself")
    return studies, {}


@running
def ablate_command(
    names: Annotated[
        list[str] | None,
        argument(
            "NAME", "Ablations to run, such as window, or TOML files of your own.  [default: all]"
        ),
    ] = None,
) -> Chosen:
    """Vary one parameter of simulator or estimator at a time; mean errors as CSV, and a figure."""
    own = {name: _own(Path(name)) for name in names or () if name.endswith(".toml")}
    return chosen(names or list(ABLATIONS), {**ABLATIONS, **own}, "ablation"), {}


@running
def sweep_command(
    config: Annotated[Path, argument("CONFIG", "TOML file of the grid (docs/sweeps.md).")],
    out: Annotated[
        Path | None, named("FILE", "CSV to write.  [default: results/<config>.csv]")
    ] = None,
) -> Chosen:
    """Run any grid over any parameters of simulator and estimator; one CSV row per run.

    Beside it stand a table of the grid's points, `<name>_cells.csv`, and a figure of that table.
    """
    grid = _checked(load_config(config))
    out = out or Path("results") / f"{grid.name}.csv"
    _check_table(out)
    return [sweep_study(grid, out.name, f"ssac sweep {config}")], {"out": out.parent}


def merge_command(
    out: Annotated[Path, argument("OUT", "CSV to write.")],
    shards: Annotated[list[Path], argument("SHARD", "CSVs of all shards.")],
    cache: CacheOption = DEFAULT_FOLDER,
) -> None:
    """Join the CSVs of all shards of a sweep or study: the same bytes as in one piece.

    The files that are made from the runs are written beside them.
    """
    _check_table(out)
    if out.exists():
        check_targets([out], shards)

    def study_of(config: Mapping[str, Any]) -> Study:
        if "name" in config:  # a grid of the user's
            grid = grid_from_content(config["name"], config["grid"])
            return sweep_study(grid, out.name, "ssac sweep", config.get("points", ""))
        studies = all_studies()
        if config.get("study") not in studies:
            raise SsacError(
                f"the shards are of the study {config.get('study')!r}, which is none of this"
                " version"
            )
        return studies[config["study"]]

    for path in merge(shards, out, study_of, Cache(cache)):
        typer.echo(f"written to {path}")


def numbers_command(
    root: Annotated[Path, named("FOLDER", "Folder with README.md, docs/ and results/.")] = Path(
        "."
    ),
    check: Annotated[bool, flag("check", "Write nothing; fail if a number is stale.")] = False,
) -> None:
    """Write the numbers that README.md and docs/ quote, as they are in results/ now."""
    if check:
        stale = stale_numbers(root, all_numbers())
        for line in stale:
            typer.echo(line)
        if stale:
            raise SsacError(f"{len(stale)} stale numbers: run `ssac numbers`")
        return
    for path in rewrite_numbers(root, all_numbers()):
        typer.echo(f"written: {path}")


def verify_command(
    results: Annotated[Path, named("FOLDER", "Folder with the results.")] = Path("results"),
    recordings: Annotated[
        int, number("Recordings to simulate and run again.", 0, 10_000, metavar="COUNT")
    ] = N_RECORDINGS,
    sample_seed: Annotated[
        int | None,
        number("Seed of the draw of those recordings.", 0, MAX_SEED, default_words="a new one"),
    ] = None,
    only: Annotated[
        str | None, named("NAME", "Draw from this study alone, such as tables.", "all")
    ] = None,
    workers: WorkersOption = -1,
) -> None:
    """Check that the results are whole and follow from their runs; make some runs again."""
    if not results.is_dir():
        raise SsacError(f"{results}: no such folder: run `make tables studies figures bench` first")
    studies = all_studies()
    sources = sources_of(studies, only)
    kept = Results(results)
    committed = [study for study in studies.values() if study.is_committed]
    failed = _report(file_findings(results, committed, PUBLISHED_SHA256))
    failed += sum(_report(study_findings(study, kept)) for study in committed)
    failed += _report(shared_findings(committed, kept))
    failed += _report(page_findings(results))
    if recordings:
        seed = secrets.randbelow(MAX_SEED + 1) if sample_seed is None else sample_seed
        options = f"--sample-seed {seed} --recordings {recordings}"
        options += f" --only {only}" if only else ""
        typer.echo(f"recordings drawn by: ssac verify {options}")
        drawn = draw(sources, recordings, seed)
        with tempfile.TemporaryDirectory(prefix="ssac-verify-") as folder:
            failed += _report(recomputed(drawn, kept, Path(folder), Workers(workers)))
    typer.echo(f"{failed} of the checks above differ" if failed else "all of it as committed")
    if failed:
        raise typer.Exit(1)


def page_findings(results: Path) -> list[Finding]:
    """Check the numbers that the pages beside a folder of results quote from it."""
    root = results.resolve().parent
    if root.joinpath("results") != results.resolve() or not pages(root):
        return []  # no page quotes results that were written elsewhere
    return [found("the pages quote the results", lambda: stale_numbers(root, all_numbers()))]


def all_numbers() -> dict[str, Callable[[Results], str]]:
    """Give the numbers of all studies."""
    return {
        name: number for study in all_studies().values() for name, number in study.numbers.items()
    }


def _given(study: Study, words: Sequence[str]) -> dict[str, Path]:
    """Return, by option, the files of the user's data, as given behind a study's name."""
    needed = list(study.options)
    if len(words) != len(needed):
        expected = " ".join(name.upper() for name in needed)
        raise SsacError(f"{study.name}: expected {expected} behind it, got {' '.join(words)!r}")
    absent = [word for word in words if not (Path(word).is_file() or bag_of(Path(word)))]
    if absent:
        raise SsacError(f"{absent[0]}: no such file, nor a bag or a topic of one: check the path")
    return dict(zip(needed, map(Path, words), strict=True))


def _own(path: Path) -> Study:
    grid = _checked(load_config(path))
    return sweep_study(grid, f"{grid.name}_runs.csv", f"ssac ablate {path}", grid.name)


def _check_table(out: Path) -> None:
    """Raise SsacError unless a table and what is made of it can be written."""
    if out.suffix != ".csv":
        raise SsacError(f"{out}: the table is a CSV, and its name must end with .csv")
    check_writable(out)


def _checked(grid: GridConfig) -> GridConfig:
    """Return the grid; SsacError, before any work is done, if a mesh of it cannot be used."""
    for mesh in {cell.sim.drone_file for cell in grid.cells() if cell.sim.drone_file is not None}:
        check_mesh(mesh)
    return grid


def _report(findings: Iterable[Finding]) -> int:
    """Print findings; return how many differ."""
    n_differ = 0
    for finding in findings:
        typer.echo("\n".join(finding.lines()))
        n_differ += bool(finding.faults)
    return n_differ
