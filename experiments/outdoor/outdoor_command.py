"""A command line in, the outdoor twin's tables and figure out: `ssac outdoor`."""

import time
from pathlib import Path
from typing import Annotated, Any

import pandas as pd
import typer

from experiments.lab.cache import DEFAULT_FOLDER, Cache, recording_key, run_key
from experiments.lab.command import CacheOption, OutOption, check_is_folder, with_options
from experiments.lab.files import record_checksums
from experiments.lab.provenance import save_provenance
from experiments.outdoor.flights import (
    CLOUDS_PX_S,
    DURATION_S,
    FIRST_SEED,
    N_FLIGHTS,
    THIRD_T_D_S,
    load_truth,
    outdoor_config,
    seed_of,
    third_config,
)
from experiments.outdoor.third import THREE_CAMERAS, TWO_AT_ONCE, at_once, at_once_row
from experiments.outdoor.twin import COLUMNS, KINDS, compared, twin_row
from ssac.cli.options import number
from ssac.files.whole_file import whole_file
from ssac.pipeline.plots import save_comparison

COMMAND = "ssac outdoor"
RUNS_FILE, ORACLE_FILE, FIGURE_FILE = "outdoor.csv", "outdoor_oracle.csv", "outdoor.png"

_CODE = ("experiments.outdoor.third",)
_MEASURED = [name for name in COLUMNS if name not in ("flight", "kind", "status", "reason")]


def outdoor_command(
    out: OutOption = Path("results"),
    flights: Annotated[int, number("Number of flights.", 1, 1000, metavar="COUNT")] = N_FLIGHTS,
    duration: Annotated[
        float, number("Duration of each flight.", 10, 3600, "seconds")
    ] = DURATION_S,
    third: Annotated[
        bool, typer.Option("--third/--no-third", help="Solve each flight with a third camera too.")
    ] = True,
    cache: CacheOption = DEFAULT_FOLDER,
) -> None:
    """Simulate the paper's outdoor set-up, and find clocks, pose and the drone's path.

    What is finished is kept in the cache, so that an interrupted run goes on where it was.
    """
    check_is_folder(out)
    start, kept = time.perf_counter(), Cache(cache)
    rows = [
        _row(kept, duration, flight, kind, lambda line: typer.echo(line, err=True))
        for flight in range(flights)
        for kind in kinds_of(third)
    ]
    runs = pd.DataFrame(rows, columns=COLUMNS)
    seconds = time.perf_counter() - start
    command = command_of(flights, duration, third)
    settings = outdoor_settings(flights, duration, third)
    for name, table in ((RUNS_FILE, runs), (ORACLE_FILE, oracle_table(runs))):
        with whole_file(out / name) as temporary:
            table.to_csv(temporary, index=False, float_format="%.6g", lineterminator="\n")
        save_provenance(out / name, command, settings, seconds, None)
    written = [out / RUNS_FILE, out / ORACLE_FILE, *_drawn(kept, duration, out / FIGURE_FILE)]
    record_checksums(out, written)
    typer.echo(oracle_table(runs).to_string(index=False, float_format="%.3g"))
    typer.echo(f"written to {', '.join(map(str, written))}")


def command_of(flights: int, duration_s: float, third: bool) -> str:
    """Give the command line that makes the tables, for their provenance."""
    options = {
        "--flights": (flights, N_FLIGHTS),
        "--duration": (duration_s, DURATION_S),
        "--third": (third, True),
    }
    return with_options(COMMAND, options)


def kinds_of(third: bool = True) -> tuple[str, ...]:
    """List the kinds of rows of a flight."""
    return (*KINDS, TWO_AT_ONCE, THREE_CAMERAS) if third else (*KINDS, TWO_AT_ONCE)


def outdoor_settings(
    flights: int = N_FLIGHTS, duration_s: float = DURATION_S, third: bool = True
) -> dict[str, Any]:
    """Give what the tables are made with, for provenance."""
    return {
        "flights": flights,
        "first_seed": FIRST_SEED,
        "kinds": kinds_of(third),
        "sim": outdoor_config(duration_s),
        "clouds_px_s": CLOUDS_PX_S,
    }


def oracle_table(runs: pd.DataFrame) -> pd.DataFrame:
    """Give means over the flights that were answered, and how many these are, by kind."""
    table = []
    for kind, group in runs.groupby("kind", sort=False):
        answered = group[group.rmse_m.notna()]
        means = {name: answered[name].mean() for name in _MEASURED}
        table.append({"kind": kind, "answered": len(answered), "of": len(group), **means})
    return pd.DataFrame(table)


def _row(cache: Cache, duration_s: float, flight: int, kind: str, log: Any) -> dict[str, Any]:
    """Give a row from the cache, or make it."""
    config, seed = outdoor_config(duration_s), seed_of(flight)
    with_third = [third_config(config)] if kind == THREE_CAMERAS else []
    recordings = tuple(recording_key(each, seed) for each in (config, *with_third))
    key = run_key(recordings, ("outdoor", flight, kind), _CODE)
    row = cache.load_run(key)
    if row is None:
        folder = cache.recording_folder(config, seed)
        truth = load_truth(folder)
        if with_third:
            other = cache.recording_folder(with_third[0], seed)
            truths = truth, load_truth(other, THIRD_T_D_S)
            made = at_once_row((folder, other), config, truths, flight)
        elif kind == TWO_AT_ONCE:
            made = at_once_row((folder,), config, (truth,), flight)
        else:
            made = twin_row(folder, config, truth, flight, kind)
        row = {name: None if value != value else value for name, value in made.items()}  # NaN
        cache.save_run(key, row)
    log(f"flight {flight}, {kind}: {row['status']}, path RMSE {row['rmse_m']} m")
    return row


def _drawn(cache: Cache, duration_s: float, file: Path) -> list[Path]:
    """Draw the first flight, all adjusted at once, beside its RTK; no figure if it was refused."""
    file.unlink(missing_ok=True)
    config = outdoor_config(duration_s)
    folder = cache.recording_folder(config, seed_of(0))
    truth = load_truth(folder)
    answer = at_once((folder,), config, (truth,), 0)
    if not answer.paths:
        return []
    save_comparison(file, compared(answer.paths[0].path, truth, 0))
    return [file]
