"""A command line in, `reliability.csv` out: `ssac torture`."""

import os
import tempfile
import time
from pathlib import Path
from typing import Annotated

import typer

from experiments.lab.cache import DEFAULT_FOLDER, Cache
from experiments.lab.command import CacheOption, with_options
from experiments.lab.files import record_checksums, save_csv
from experiments.lab.provenance import save_provenance
from experiments.torture.campaign import campaign
from experiments.torture.faults import disturbances
from experiments.torture.reliability import (
    BAD,
    COMMAND,
    COMMITTED,
    CSV_FILE,
    Extent,
    reliability_config,
    reliability_table,
    silent_share,
)
from ssac.cli.exits import NO_ESTIMATE
from ssac.cli.options import number
from ssac.files.whole_file import check_folder


def torture_command(
    cases: Annotated[
        int, number("Number of damaged inputs.", 1, 10_000_000, metavar="COUNT")
    ] = COMMITTED.cases,
    seed: Annotated[int, number("Seed of all damage.", 0, 2**32 - 1)] = COMMITTED.seed,
    kills: Annotated[
        int, number("Number of sweeps killed at random times.", 0, 10_000, metavar="COUNT")
    ] = COMMITTED.kills,
    full_disks: Annotated[
        int | None,
        number(
            "Number of sweeps on a disk that fills up.",
            0,
            10_000,
            metavar="COUNT",
            default_words=f"{COMMITTED.full_disks} as root, who alone can make such disks",
        ),
    ] = None,
    others: Annotated[
        int,
        number(
            "Number of trials of each other kind: sweeps that share a cache, dead workers, damaged "
            "meshes.",
            0,
            10_000,
            metavar="COUNT",
        ),
    ] = COMMITTED.others,
    out: Annotated[Path, typer.Option(help="Folder for the CSV.", metavar="FOLDER")] = Path(
        "results"
    ),
    cache: CacheOption = DEFAULT_FOLDER,
) -> None:
    """Damage inputs of all kinds, disturb sweeps, and see what becomes of them.

    What is finished is kept in the cache, so that an interrupted campaign goes on where it was.
    Exit code 0: none ended as it must not; 1: some did, and they are listed on stderr.
    """
    check_folder(out)
    start, kept = time.perf_counter(), Cache(cache)
    if full_disks is None:
        full_disks = COMMITTED.full_disks if os.geteuid() == 0 else 0
    extent = Extent(cases, seed, kills, full_disks, others)
    with tempfile.TemporaryDirectory() as folder:
        found = list(campaign(cases, seed, Path(folder), kept, show_progress=True))
        found += disturbances(extent, Path(folder) / "sweeps", kept)
    counts = reliability_table(found)
    path = out / CSV_FILE
    save_csv(path, counts)
    seconds = time.perf_counter() - start
    settings = reliability_config(extent)
    save_provenance(path, command_of(extent), settings, seconds, None)
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
    committed = reliability_config()
    return with_options(
        COMMAND,
        {
            f"--{name.replace('_', '-')}": (value, committed[name])
            for name, value in reliability_config(extent).items()
        },
    )
