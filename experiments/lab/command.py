"""The commands that run studies; their options are ALL_OPTIONS and the parameters of `cells`."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from inspect import Parameter, Signature, signature
from pathlib import Path
from typing import Annotated, Any, TypeVar

import pandas as pd
import typer

from experiments.lab.cache import DEFAULT_FOLDER, Cache
from experiments.lab.cell import CRASHED
from experiments.lab.results import Results
from experiments.lab.schedule import Outcome, Workers
from experiments.lab.study import (
    WHOLE,
    How,
    Options,
    Study,
    check_own,
    check_reads,
    parse_shard,
    save_study,
)
from ssac.cli.exits import BUG
from ssac.cli.options import argument, named
from ssac.errors import PluginError, SsacError

T = TypeVar("T")

_KEYWORD = Parameter.KEYWORD_ONLY
_SCREEN = 120  # characters in a line
NOT_SIMULATED = "recording: SimError: "  # begins the reason of a run that the simulator rejects


def _some(workers: int) -> int:
    """Return a number of worker processes; SsacError unless it is -1, or 1 or more."""
    if workers < 1 and workers != -1:
        raise SsacError(
            f"--workers: expected 1 or more, or -1 for one for each core, got {workers}"
        )
    return workers


WorkersOption = Annotated[
    int, typer.Option(help="Worker processes; -1: one per core.", metavar="COUNT", callback=_some)
]
SchedulerOption = Annotated[
    str, named("ADDRESS", "Run on a Dask cluster: host:port of its scheduler.")
]
OutOption = Annotated[Path, named("FOLDER", "Folder for the results.")]
CacheOption = Annotated[Path, named("FOLDER", "Folder that keeps finished recordings and runs.")]
ShardOption = Annotated[
    str, named("I/N", "Run only part I of N and write its runs; join them with `ssac merge`.")
]

ALL_OPTIONS: Mapping[str, Parameter] = {
    name: Parameter(name, _KEYWORD, annotation=annotation, default=default)
    for name, annotation, default in (
        ("out", OutOption, Path("results")),
        ("shard", ShardOption, "1/1"),
        ("workers", WorkersOption, -1),
        ("scheduler", SchedulerOption, ""),
        ("cache", CacheOption, DEFAULT_FOLDER),
    )
}
"""Options shared by the commands that run studies, by name."""

Chosen = tuple[Sequence[Study], Options]
"""Studies to run, and values of their options; a value `out` is the folder for the results."""


def command_of(parts: Mapping[str, Sequence[Study]], help_text: str) -> Callable[..., None]:
    """Make the command that runs the studies of the parts that a user names, or of all parts."""
    studies = [study for some in parts.values() for study in some]
    options = {k: v for study in studies for k, v in signature(study.cells).parameters.items()}
    part = argument("PART", f"Parts to run: {', '.join(parts)}.  [default: all]")
    chosen_parts = Parameter(
        "parts", _KEYWORD, annotation=Annotated[list[str] | None, part], default=None
    )

    def choose(**given: Any) -> Chosen:
        some = chosen(given.pop("parts", None) or [*parts], parts, "part")
        return [study for part in some for study in part], given

    own = [one.replace(kind=_KEYWORD) for one in options.values()]
    choose.__signature__ = Signature([chosen_parts, *own] if len(parts) > 1 else own)  # type: ignore[attr-defined]
    choose.__doc__ = help_text
    alone = all(study.how is How.ALONE for study in studies)
    return running(choose, ("out", "cache") if alone else tuple(ALL_OPTIONS))


def running(
    choose: Callable[..., Chosen], shared: Sequence[str] = tuple(ALL_OPTIONS)
) -> Callable[..., None]:
    """Make a command from `choose`, which selects studies, and the shared options.

    An option of `choose` takes the place of a shared one; if it is `out`, `choose` also returns it.
    """
    own = {k: v.replace(kind=_KEYWORD) for k, v in signature(choose).parameters.items()}
    others = {name: ALL_OPTIONS[name] for name in shared if name not in own}
    parameters = [*own.values(), *others.values()]

    def command(**given: Any) -> None:
        studies, values = choose(**{name: given[name] for name in own})
        workers = Workers(given.get("workers", 1), given.get("scheduler", ""))
        cache, shard = Cache(given["cache"]), given.get("shard", "1/1")
        run_studies(studies, values.get("out", given["out"]), cache, workers, shard, values)

    command.__doc__ = choose.__doc__
    command.__annotations__ = {one.name: one.annotation for one in parameters}
    command.__signature__ = Signature(parameters)  # type: ignore[attr-defined]
    return command


def chosen(names: Iterable[str], known: Mapping[str, T], kind: str) -> list[T]:
    """Return the known things with these names, in order; SsacError for an unknown name."""
    for name in names:
        if name not in known:
            raise SsacError(f"unknown {kind} {name!r}: use one of {', '.join(known)}")
    return [known[name] for name in names]


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
    files = [file for study in studies for file in study.files]
    twice = [file for file in files if files.count(file) > 1]
    if twice:
        raise SsacError(f"{twice[0]} would be written twice: run one by one, or rename a TOML file")
    for study in studies:
        check_own(study, out, part)
    made = set(files)
    for study in studies if part == WHOLE else ():
        check_reads(study, out, made)
    outcomes, written = [], []
    for study in studies:
        outcome, paths = save_study(study, out, cache, workers, part, options)
        outcomes.append(outcome)
        written += paths
        if study.shows and part == WHOLE:
            typer.echo(on_screen(Results(out).table(study.shows)))
    finish(outcomes, cache, *written)


def on_screen(table: pd.DataFrame) -> str:
    """Format a table for a terminal; a mean, its 95 % interval and the median share one column."""
    shown = {}
    for name in map(str, table):
        error, _, kind = name.rpartition("_")
        if f"{error}_low" not in table or f"{error}_median" not in table:
            texts = table[name].map(lambda one: f"{one:g}" if isinstance(one, float) else str(one))
            none = "0" if name == "refusals" else ""
            shown[name] = texts.where(table[name].notna(), none)
        elif kind == "mean" and table[name].notna().any():
            half = (table[name] - table[f"{error}_low"]).map("{:.2g}".format)
            mean, median = (
                table[f"{error}_{of}"].map("{:.3g}".format) for of in ("mean", "median")
            )
            text = (mean + "±" + half + " " + median).str.replace("±nan", "")
            shown[f"{error} ± median"] = text.where(table[name].notna(), "")
    return pd.DataFrame(shown).to_string(index=False, line_width=_SCREEN)


def finish(outcomes: Sequence[Outcome], cache: Cache, *files: Path) -> None:
    """Report what was done; runs that crashed are a bug, of ours or of another package."""
    runs = pd.concat([outcome.runs for outcome in outcomes], ignore_index=True)
    n_recordings = sum(outcome.n_recordings for outcome in outcomes)
    n_simulated = sum(outcome.n_simulated for outcome in outcomes)
    n_deaths = sum(outcome.n_deaths for outcome in outcomes)
    peak_mb = max(outcome.peak_mb for outcome in outcomes)
    lines = [
        f"{len(runs)} runs; recordings worked on: {n_recordings} ({n_simulated} of them simulated)",
        *([f"{n_deaths} workers died and were replaced"] if n_deaths else []),
        *([f"peak memory of a worker: {peak_mb:.0f} MB"] if peak_mb else []),
        f"size of the cache {cache.folder}: {cache.size_bytes() / 1e9:.2f} GB",
    ]
    failed = runs[runs["status"] != "ok"].fillna({"method": "others", "variant": "others"})
    of = next((name for name in ("method", "variant") if name in failed), "status")
    for (name, status), group in failed.groupby([of, "status"]):
        lines.append(f"{name}: {len(group)} runs {status}: {group['reason'].iloc[0]}")
    typer.echo("\n".join(lines), err=True)
    for path in files:
        typer.echo(f"written to {path}")
    reasons = runs["reason"][runs["status"] == CRASHED].tolist()
    if not reasons:
        return
    if all(reason.startswith(NOT_SIMULATED) for reason in reasons):
        reason = reasons[0].removeprefix(NOT_SIMULATED)
        raise SsacError(f"{len(reasons)} runs have no recording, the first of them: {reason}")
    theirs = all(f" {PluginError.__name__}: " in reason for reason in reasons)
    whose = "other packages' methods" if theirs else "this program"
    typer.echo(
        f"error: a bug in {whose}: {len(reasons)} runs crashed, their reasons are in the rows; run"
        " again to try them again",
        err=True,
    )
    raise typer.Exit(BUG)
