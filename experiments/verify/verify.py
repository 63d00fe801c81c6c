"""The committed results in, whether they can be trusted out: `ssac verify`.

Everything that must be there is, nothing else is, each file is as its command wrote it; what
follows from the runs is made again from them, and the numbers that pages quote are what the results
say; and some runs, drawn anew each time, are made again from nothing: simulated into a folder of
their own, measured, and put beside the committed rows.
Exit code 0: all right; 1: something differs; 2: there is no such folder.
"""

import secrets
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated

import typer

from experiments.lab.command import WorkersOption
from experiments.lab.finding import Finding, found
from experiments.lab.schedule import Workers
from experiments.lab.study import Study
from experiments.network.four import FOUR_CAMERAS
from experiments.physical.catalogue import PHYSICAL_STUDIES
from experiments.quoted.numbers import pages, stale_numbers
from experiments.studies.catalogue import STUDIES
from experiments.verify.derived import (
    figure_findings,
    physical_findings,
    renderer_findings,
    study_findings,
    table_findings,
)
from experiments.verify.files import file_findings
from experiments.verify.manifest import campaigns, manifest_of
from experiments.verify.recompute import recomputed
from experiments.verify.sample import SLOW, TABLES, draw, sources_of
from ssac.cli.options import number
from ssac.errors import SsacError

N_RECORDINGS = 6
"""Drawn if nothing else is said."""

_SEEDS = 2**32

ALL_STUDIES: Mapping[str, Study] = {
    **STUDIES,
    **PHYSICAL_STUDIES,
    FOUR_CAMERAS.name: FOUR_CAMERAS,
}
CAMPAIGNS = campaigns()


def verify_command(
    results: Annotated[
        Path, typer.Option(help="Folder with the results.", metavar="FOLDER")
    ] = Path("results"),
    recordings: Annotated[
        int, number("Recordings to simulate and run again.", 0, 10_000, metavar="COUNT")
    ] = N_RECORDINGS,
    sample_seed: Annotated[
        int | None,
        number("Seed of the draw of those recordings.", 0, _SEEDS - 1, default_words="a new one"),
    ] = None,
    slow: Annotated[
        bool, typer.Option("--slow", help=f"Draw from {', '.join(SLOW)}: minutes each.")
    ] = False,
    only: Annotated[
        str | None,
        typer.Option(
            help=f"Draw from this study alone, or from the {TABLES}.",
            metavar="NAME",
            show_default="all",
        ),
    ] = None,
    workers: WorkersOption = -1,
) -> None:
    """Check that the results are whole and follow from their runs; make some runs again."""
    if not results.is_dir():
        raise SsacError(f"{results}: no such folder: run `make tables studies figures bench` first")
    sources = sources_of(ALL_STUDIES, slow, only)
    manifest = manifest_of(ALL_STUDIES, CAMPAIGNS)
    failed = _report(file_findings(results, manifest))
    failed += _report(table_findings(results))
    failed += _report(study_findings(results, ALL_STUDIES))
    failed += _report(renderer_findings(results, ALL_STUDIES))
    failed += _report(physical_findings(results, manifest))
    failed += _report(figure_findings(results, ALL_STUDIES))
    failed += _report(page_findings(results))
    if recordings:
        seed = secrets.randbelow(_SEEDS) if sample_seed is None else sample_seed
        options = f"--sample-seed {seed} --recordings {recordings}" + (" --slow" if slow else "")
        options += f" --only {only}" if only else ""
        typer.echo(f"recordings drawn by: ssac verify {options}")
        drawn = draw(sources, recordings, seed)
        with tempfile.TemporaryDirectory(prefix="ssac-verify-") as folder:
            failed += _report(recomputed(drawn, results, Path(folder), Workers(workers)))
    typer.echo(f"{failed} of the checks above differ" if failed else "all of it as committed")
    if failed:
        raise typer.Exit(1)


def page_findings(results: Path) -> list[Finding]:
    """Check the numbers that the pages beside a folder of results quote from it."""
    root = results.resolve().parent
    if root.joinpath("results") != results.resolve() or not pages(root):
        return []  # results that were written elsewhere: no page quotes them
    return [found("the pages quote the results", lambda: tuple(stale_numbers(root)))]


def _report(findings: Sequence[Finding]) -> int:
    """Print findings; return how many differ."""
    for finding in findings:
        for line in finding.lines():
            typer.echo(line)
    return sum(bool(finding.faults) for finding in findings)
