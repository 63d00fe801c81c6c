"""The command `ssac torture`, which makes `reliability.csv`."""

import tempfile
import time
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from experiments.damage.campaign import campaign
from experiments.damage.reliability import (
    BAD,
    COMMAND,
    COMMITTED,
    CSV_FILE,
    Extent,
    reliability_table,
    silent_share,
)
from experiments.lab.cache import DEFAULT_FOLDER, Cache
from experiments.lab.command import CacheOption, with_options
from experiments.lab.files import record_checksums, save_csv
from experiments.lab.provenance import save_provenance
from ssac.cli.exits import NO_ESTIMATE
from ssac.cli.options import number
from ssac.files.whole_file import check_folder


def torture_command(
    cases: Annotated[
        int, number("Number of damaged inputs.", 1, 10_000_000, metavar="COUNT")
    ] = COMMITTED.cases,
    seed: Annotated[int, number("Seed of all damage.", 0, 2**32 - 1)] = COMMITTED.seed,
    out: Annotated[Path, typer.Option(help="Folder for the CSV.", metavar="FOLDER")] = Path(
        "results"
    ),
    cache: CacheOption = DEFAULT_FOLDER,
) -> None:
    """Damage inputs of all kinds, and see what becomes of them.

    What is finished is kept in the cache, so that an interrupted campaign goes on where it was.
    Exit code 0: none ended as it must not; 1: some did, and they are listed on stderr.
    """
    check_folder(out)
    start, kept = time.perf_counter(), Cache(cache)
    extent = Extent(cases, seed)
    with tempfile.TemporaryDirectory() as folder:
        found = list(campaign(extent, Path(folder), kept, show_progress=True))
    counts = reliability_table(found)
    path = out / CSV_FILE
    save_csv(path, counts)
    seconds = time.perf_counter() - start
    save_provenance(path, command_of(extent), extent, seconds, None)
    record_checksums(out, [path])
    typer.echo(counts.to_string(index=False))
    typer.echo(
        f"{100.0 * silent_share(counts):.2g} % of the event files damaged in the middle were read "
        "with over 1 % fewer events and no warning"
    )
    bad = [case for case in found if case.outcome in (*BAD, "silently_fewer")]
    for case in bad:
        typer.echo(
            f"{case.outcome}: {case.kind}, {case.damage}, number {case.number}: {case.said}",
            err=True,
        )
    typer.echo(f"written to {path}")
    if any(case.outcome in BAD for case in bad):
        raise typer.Exit(NO_ESTIMATE)


def command_of(extent: Extent) -> str:
    """Give the command line of a campaign, for its provenance."""
    committed = asdict(COMMITTED)
    options = {f"--{name}": (value, committed[name]) for name, value in asdict(extent).items()}
    return with_options(COMMAND, options)
