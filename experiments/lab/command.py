"""The commands of studies: their options are those of all, and the parameters of `cells`.

What they check and what they say at the end is the same for all of them.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from inspect import Parameter, Signature, signature
from pathlib import Path
from typing import Annotated, Any

import pandas as pd
import typer

from experiments.lab.cache import DEFAULT_FOLDER, Cache
from experiments.lab.cell import CRASHED
from experiments.lab.grid import Cell
from experiments.lab.results import Results
from experiments.lab.schedule import Outcome, Workers
from experiments.lab.study import (
    WHOLE,
    How,
    Options,
    Study,
    check_reads,
    parse_shard,
    save_study,
)
from sim.recording import SimConfig
from sim.render.config import RENDERERS
from ssac.cli.exits import BUG
from ssac.errors import PluginError, SsacError

NOT_SIMULATED = "recording: SimError: "
"""Begins the reason of a run of which the simulator says that its configuration makes no sense."""


def _some(workers: int) -> int:
    """Refuse numbers of processes that nothing could run on."""
    if workers < 1 and workers != -1:
        raise SsacError(
            f"--workers: expected 1 or more, or -1 for one for each core, got {workers}"
        )
    return workers


WorkersOption = Annotated[
    int,
    typer.Option(help="Worker processes; -1: one per core.", metavar="COUNT", callback=_some),
]
SchedulerOption = Annotated[
    str,
    typer.Option(help="Run on a Dask cluster: host:port of its scheduler.", metavar="ADDRESS"),
]
OutOption = Annotated[Path, typer.Option(metavar="FOLDER", help="Folder for the results.")]
CacheOption = Annotated[
    Path, typer.Option(help="Folder that keeps finished recordings and runs.", metavar="FOLDER")
]

RendererOption = Annotated[
    str, typer.Option(help=f"Renderer: {' or '.join(RENDERERS)} (OpenGL).", metavar="NAME")
]
CheckOption = Annotated[
    bool,
    typer.Option(
        "--check/--no-check",
        help="Check some instants against OpenGL; --no-check where there is none.",
    ),
]
ShardOption = Annotated[
    str,
    typer.Option(
        help="Run only part I of N and write its runs; join them with `ssac merge`.", metavar="I/N"
    ),
]

ALL_OPTIONS: Mapping[str, tuple[Any, Any]] = {
    "out": (OutOption, Path("results")),
    "shard": (ShardOption, "1/1"),
    "workers": (WorkersOption, -1),
    "scheduler": (SchedulerOption, ""),
    "cache": (CacheOption, DEFAULT_FOLDER),
}
"""Of every command that runs studies: annotation and default by name."""


def command_of(parts: Mapping[str, Sequence[Study]], help_text: str) -> Callable[..., None]:
    """Make the command that runs some studies.

    Parameters
    ----------
    parts
        Studies by the name of the part of the command that they are; without a choice if it is one.
    """
    studies = [study for some in parts.values() for study in some]
    alone = all(study.how is How.ALONE for study in studies)
    of_studies = {
        name: one for study in studies for name, one in signature(study.cells).parameters.items()
    }
    of_all = {
        name: Parameter(name, Parameter.KEYWORD_ONLY, annotation=annotation, default=default)
        for name, (annotation, default) in ALL_OPTIONS.items()
        if not alone or name in ("out", "cache")
    }
    parameters = [one.replace(kind=Parameter.KEYWORD_ONLY) for one in of_studies.values()]
    if len(parts) > 1:
        named = Annotated[list[str] | None, parts_argument(parts)]
        first = Parameter("parts", Parameter.KEYWORD_ONLY, annotation=named, default=None)
        parameters.insert(0, first)
    parameters += of_all.values()

    def command(**given: Any) -> None:
        """Run the studies of the parts that are named."""
        chosen = chosen_parts(given.pop("parts", None), parts)
        some = [study for part in chosen for study in parts[part]]
        options = {name: given[name] for name in of_studies}
        workers = Workers(given.get("workers", 1), given.get("scheduler", ""))
        cache, shard = Cache(given["cache"]), given.get("shard", "1/1")
        run_studies(some, given["out"], cache, workers, shard, options)

    command.__doc__ = help_text
    command.__annotations__ = {one.name: one.annotation for one in parameters}
    command.__signature__ = Signature(parameters)  # type: ignore[attr-defined]
    return command


def run_studies(
    studies: Sequence[Study],
    out: Path,
    cache: Cache,
    workers: Workers,
    shard: str = "1/1",
    options: Options | None = None,
) -> None:
    """Run studies one after the other, and write the files of each as soon as it is done."""
    part = parse_shard(shard)
    made = {file for study in studies for file in study.files}
    for study in studies if part == WHOLE else ():
        check_reads(study, out, made)
    outcomes, written = [], []
    for study in studies:
        outcome, paths = save_study(study, out, cache, workers, part, options)
        if outcome is not None:
            outcomes.append(outcome)
        written += paths
        if study.shows and part == WHOLE:
            typer.echo(Results(out).table(study.shows).to_string(index=False))
    if outcomes:
        finish(_joined(outcomes), cache, *written)
    else:
        for path in written:
            typer.echo(f"written to {path}")


def _joined(outcomes: Sequence[Outcome]) -> Outcome:
    """Sum up several studies."""
    return Outcome(
        pd.concat([outcome.runs for outcome in outcomes], ignore_index=True),
        sum(outcome.n_recordings for outcome in outcomes),
        sum(outcome.n_simulated for outcome in outcomes),
        max(outcome.peak_mb for outcome in outcomes),
        sum(outcome.n_deaths for outcome in outcomes),
    )


def parts_argument(parts: Iterable[str]) -> Any:
    """Make the argument that names some parts of a command; `chosen_parts` reads it."""
    return typer.Argument(
        help=f"Parts to run: {', '.join(parts)}.  [default: all]",
        metavar="PART",
        show_default=False,
    )


def chosen_parts(named: Sequence[str] | None, parts: Iterable[str]) -> list[str]:
    """Return the parts of a command that were named, all where none was.

    Raises
    ------
    SsacError
        If there is no such part.
    """
    known = list(parts)
    unknown = [name for name in named or () if name not in known]
    if unknown:
        raise SsacError(f"unknown part {unknown[0]!r}: use one of {', '.join(known)}")
    return list(named or known)


def check_is_folder(out: Path) -> None:
    """Refuse to begin work whose results would have no place; SsacError says so."""
    if not out.is_dir():
        raise SsacError(f"{out}: there is no such folder: make it, or name another")


def drawn_by(cells: Iterable[Cell], renderer: str, check: bool) -> list[Cell]:
    """Return the same cells, with what their recordings are drawn by."""

    def drawn(sim: SimConfig) -> SimConfig:
        return replace(sim, render=replace(sim.render, renderer=renderer, check=check))

    return [replace(cell, sim=drawn(cell.sim)) for cell in cells]


def finish(outcome: Outcome, cache: Cache, *files: Path) -> None:
    """Say what was done, and whether runs crashed, which is a bug: ours, or of other packages.

    Raises
    ------
    SsacError
        If runs have no recording, as nothing can be simulated of what the configuration asks for.
    """
    runs = outcome.runs
    failed = runs[runs["status"] != "ok"]
    of = next((name for name in ("method", "variant", "signal") if name in failed), "status")
    typer.echo(
        f"{len(runs)} runs; recordings worked on: {outcome.n_recordings} "
        f"({outcome.n_simulated} of them simulated)",
        err=True,
    )
    if outcome.n_deaths:
        typer.echo(f"{outcome.n_deaths} workers died and were replaced", err=True)
    if outcome.peak_mb:
        typer.echo(f"peak memory of a worker: {outcome.peak_mb:.0f} MB", err=True)
    typer.echo(f"size of the cache {cache.folder}: {cache.size_bytes() / 1e9:.2f} GB", err=True)
    for (name, status), group in failed.groupby([of, "status"]):
        typer.echo(f"{name}: {len(group)} runs {status}: {group['reason'].iloc[0]}", err=True)
    for path in files:
        typer.echo(f"written to {path}")
    crashed = runs[runs["status"] == CRASHED]
    refused = crashed[crashed["reason"].astype(str).str.startswith(NOT_SIMULATED)]
    if len(crashed) and len(refused) == len(crashed):
        reason = str(refused["reason"].iloc[0]).removeprefix(NOT_SIMULATED)
        raise SsacError(f"{len(refused)} runs have no recording, the first of them: {reason}")
    if outcome.n_crashed:
        theirs = crashed["reason"].astype(str).str.contains(f" {PluginError.__name__}: ")
        whose = "other packages' methods" if theirs.all() else "this program"
        typer.echo(
            f"error: a bug in {whose}: {outcome.n_crashed} runs crashed, their reasons are in the"
            " rows; run again to try them again",
            err=True,
        )
        raise typer.Exit(BUG)
