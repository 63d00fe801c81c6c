"""Nothing in, the paper's simulation tables out: `ssac tables`."""

import time
from pathlib import Path
from typing import Annotated, Any

import pandas as pd
import typer

from experiments.lab.cache import DEFAULT_FOLDER, Cache
from experiments.lab.command import (
    CacheOption,
    CheckOption,
    RendererOption,
    SchedulerOption,
    WorkersOption,
    drawn_by,
    finish,
    other_than_default,
)
from experiments.lab.files import record_checksums
from experiments.lab.provenance import provenance, write_provenance
from experiments.lab.schedule import Workers, run_cells
from experiments.paper.esim import runs_of_grid
from experiments.paper.grids import table_cells, table_grids
from experiments.paper.results import (
    COMPARISON_FILE,
    PAGE_FILE,
    RUNS_FILE,
    SUMMARY_FILE,
    save_results,
)
from sim.render.gl_context import context_or_none
from ssac.files.whole_file import check_folder


def tables_config() -> dict[str, Any]:
    """Give what the tables are made with, for their provenance."""
    return {grid.name: grid.content for grid in table_grids()}


def tables_command(
    out: Annotated[Path, typer.Option(help="Folder for the tables.", metavar="FOLDER")] = Path(
        "results"
    ),
    workers: WorkersOption = -1,
    scheduler: SchedulerOption = "",
    cache: CacheOption = DEFAULT_FOLDER,
    renderer: RendererOption = "native",
    check: CheckOption = True,
) -> None:
    """Regenerate the paper's simulation tables: every method on every recording."""
    check_folder(out)
    start = time.perf_counter()
    grids = table_grids()
    cells = drawn_by(table_cells(), renderer, check)
    outcome = run_cells(cells, Cache(cache), Workers(workers, scheduler))
    wall_time_s = time.perf_counter() - start
    made_with = provenance(
        " ".join(["ssac tables", *other_than_default(renderer, check)]),
        tables_config(),
        wall_time_s,
        context_or_none(),
        recordings_simulated=outcome.n_simulated,
        peak_mb_per_worker=round(outcome.peak_mb),
    )
    save_results(runs_of_grid(outcome.runs), out, made_with)
    names = (RUNS_FILE, COMPARISON_FILE, SUMMARY_FILE, *(f"{grid.name}.csv" for grid in grids))
    files = [out / name for name in names]
    for path in files:
        write_provenance(path, made_with)
    record_checksums(out, [*files, out / PAGE_FILE])
    typer.echo(pd.read_csv(out / SUMMARY_FILE).to_string(index=False))
    typer.echo(f"{wall_time_s:.0f} s", err=True)
    finish(outcome, Cache(cache), *files, out / PAGE_FILE)
