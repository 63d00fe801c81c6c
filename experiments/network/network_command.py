"""A command line in, tables of networks of cameras out: `ssac network`."""

import time
from pathlib import Path
from typing import Annotated

import typer

from experiments.lab.cache import DEFAULT_FOLDER, Cache
from experiments.lab.command import (
    CacheOption,
    OutOption,
    SchedulerOption,
    WorkersOption,
    check_is_folder,
    chosen_parts,
    parts_argument,
    run_studies,
)
from experiments.lab.files import record_checksums, save_csv
from experiments.lab.provenance import save_provenance
from experiments.lab.schedule import Workers
from experiments.network.four import COMMAND, N_FLIGHTS, four_cameras
from experiments.network.long_flights import DURATIONS_S, growth_config, network_growth
from ssac.cli.options import number

GROWTH_FILE = "network_growth.csv"
PARTS = ("four", "growth")


def network_command(
    parts: Annotated[list[str] | None, parts_argument(PARTS)] = None,
    out: OutOption = Path("results"),
    flights: Annotated[
        int, number("Flights seen by four cameras.", 1, 1000, metavar="COUNT")
    ] = N_FLIGHTS,
    workers: WorkersOption = -1,
    scheduler: SchedulerOption = "",
    cache: CacheOption = DEFAULT_FOLDER,
) -> None:
    """Solve many cameras at once: four of events, and how time grows with eight of frames.

    What is finished of the former is kept in the cache, so that an interrupted run goes on.
    """
    chosen = chosen_parts(parts, PARTS)
    check_is_folder(out)
    if "four" in chosen:
        command = COMMAND if flights == N_FLIGHTS else f"{COMMAND} --flights {flights}"
        study = four_cameras(flights, command)
        run_studies([study], out, Cache(cache), Workers(workers, scheduler))
    if "growth" in chosen:
        start, path = time.perf_counter(), out / GROWTH_FILE
        table = network_growth(DURATIONS_S, lambda line: typer.echo(line, err=True))
        save_csv(path, table)
        save_provenance(path, COMMAND, growth_config(), time.perf_counter() - start, None)
        record_checksums(out, [path])
        typer.echo(table.to_string(index=False, float_format="%.4g"))
        typer.echo(f"written to {path}")
