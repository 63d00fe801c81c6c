"""A command line in, the physical twin's tables, error budget and figures out: `ssac physical`."""

import time
from collections.abc import Callable, Mapping
from functools import partial
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
from experiments.lab.files import record_checksums, save_text
from experiments.lab.provenance import save_provenance
from experiments.lab.schedule import Workers
from experiments.lab.study import Study
from experiments.physical.budget import budget_study
from experiments.physical.latency import latency_study
from experiments.physical.mini import (
    COMMAND,
    COMPARISON_FILE,
    DURATIONS_S,
    comparison_text,
    mini_study,
)
from sim.render.gl_context import context_or_none
from ssac.cli.options import number

PARTS: Mapping[str, tuple[Callable[..., Study], ...]] = {
    "tables": tuple(partial(mini_study, duration_s) for duration_s in DURATIONS_S),
    "budget": (budget_study,),
    "latency": (latency_study,),
}


def physical_command(
    parts: Annotated[list[str] | None, parts_argument(PARTS)] = None,
    out: OutOption = Path("results"),
    recordings: Annotated[
        int | None,
        number(
            "Recordings at each point; fewer for a trial run.",
            1,
            1000,
            metavar="COUNT",
            default_words="the study's",
        ),
    ] = None,
    workers: WorkersOption = -1,
    scheduler: SchedulerOption = "",
    cache: CacheOption = DEFAULT_FOLDER,
) -> None:
    """Simulate the paper's small-scale physical set-up: its tables, and what each fault costs.

    What is finished is kept in the cache, so that an interrupted run goes on where it was.
    """
    chosen = chosen_parts(parts, PARTS)
    check_is_folder(out)
    start = time.perf_counter()
    for part in chosen:
        run_studies(_studies(part, recordings), out, Cache(cache), Workers(workers, scheduler))
        if part == "tables":
            _save_comparison(out, recordings, time.perf_counter() - start)


def _studies(part: str, recordings: int | None) -> list[Study]:
    if recordings is None:
        return [make() for make in PARTS[part]]
    return [make(recordings, f"{COMMAND} --recordings {recordings}") for make in PARTS[part]]


def _save_comparison(out: Path, recordings: int | None, seconds: float) -> None:
    path = out / COMPARISON_FILE
    save_text(path, comparison_text(out))
    command = COMMAND if recordings is None else f"{COMMAND} --recordings {recordings}"
    config = {one.name: one.config for one in _studies("tables", recordings)}
    save_provenance(path, command, config, seconds, context_or_none())
    record_checksums(out, [path])
    typer.echo(f"written to {path}")
