"""A command line in, `reliability.csv` out: `ssac torture`."""

import tempfile
import time
from pathlib import Path
from typing import Annotated

import typer

from experiments.run.provenance import save_provenance
from experiments.studies.study import save_csv
from experiments.torture.campaign import BAD, campaign, table
from experiments.torture.faults import full_disks as full_disks_of
from experiments.torture.faults import killed_sweeps
from ssac.console.exits import NO_ESTIMATE
from ssac.console.options import number
from ssac.files.whole_file import check_folder

CSV_FILE = "reliability.csv"


def torture_command(
    cases: Annotated[int, number("Damaged inputs.", 1, 10_000_000, metavar="COUNT")] = 20_000,
    seed: Annotated[int, number("Of all damage.", 0, 2**32 - 1)] = 0,
    kills: Annotated[int, number("Sweeps killed at random times.", 0, 10_000)] = 0,
    full_disks: Annotated[
        int, number("Sweeps on disks that become full; needs root.", 0, 10_000)
    ] = 0,
    out: Annotated[Path, typer.Option(help="For the CSV.", metavar="FOLDER")] = Path("results"),
) -> None:
    """Damage inputs of all kinds and see what becomes of them.

    Exit code 0: none ended as it must not; 1: some did, and they are listed on stderr.
    """
    check_folder(out)
    start = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        found = campaign(cases, seed, Path(folder), show_progress=True)
        found += killed_sweeps(kills, seed, Path(folder) / "kills")
        found += full_disks_of(full_disks, seed, Path(folder) / "disks")
    counts = table(found)
    path = out / CSV_FILE
    save_csv(path, counts)
    made_with = {"cases": cases, "seed": seed, "kills": kills, "full_disks": full_disks}
    save_provenance(path, "ssac torture", made_with, time.perf_counter() - start, None)
    typer.echo(counts.to_string(index=False))
    bad = [case for case in found if case.outcome in (*BAD, "silently_fewer")]
    for case in bad:
        typer.echo(
            f"{case.outcome}: {case.kind}, {case.damage}, number {case.number}: {case.said}",
            err=True,
        )
    typer.echo(f"written to {path}")
    if any(case.outcome in BAD for case in bad):
        raise typer.Exit(NO_ESTIMATE)
