"""Names of studies in; their runs, summaries and figures out: `ssac study` and `ssac ablate`."""

import time
from pathlib import Path
from typing import Annotated

import pandas as pd
import typer

from experiments.lab.cache import DEFAULT_FOLDER, Cache
from experiments.lab.command import CacheOption, SchedulerOption, WorkersOption, finish
from experiments.lab.files import record_checksums, save_csv
from experiments.lab.provenance import save_provenance
from experiments.lab.schedule import Outcome, Workers
from experiments.lab.study import WHOLE, Study, parse_shard, read_others, run_study, save_derived
from experiments.studies.catalogue import ABLATIONS, STUDIES, chosen_studies
from sim.render.gl_context import context_or_none
from ssac.errors import SsacError
from ssac.files.whole_file import check_folder

OutOption = Annotated[Path, typer.Option(help="Folder for the CSVs and figures.", metavar="FOLDER")]
ShardOption = Annotated[
    str,
    typer.Option(
        help="Run only part I of N and write its runs; join them with `ssac merge`.", metavar="I/N"
    ),
]


def study_command(
    names: Annotated[
        list[str] | None,
        typer.Argument(
            help="Studies to run; --list names them.", metavar="NAME", show_default=False
        ),
    ] = None,
    list_them: Annotated[bool, typer.Option("--list", help="List the studies.")] = False,
    shard: ShardOption = "1/1",
    out: OutOption = Path("results"),
    workers: WorkersOption = -1,
    scheduler: SchedulerOption = "",
    cache: CacheOption = DEFAULT_FOLDER,
) -> None:
    """Run studies; all runs and their summary as CSV, and a figure each."""
    if list_them:
        for study in STUDIES.values():
            typer.echo(f"{study.name:20} {study.title}")
        return
    if not names:
        raise SsacError(f"name a study: {', '.join(STUDIES)}")
    studies = chosen_studies(names, STUDIES, "study")
    run_studies(studies, out, Cache(cache), Workers(workers, scheduler), shard)


def ablate_command(
    names: Annotated[
        list[str] | None,
        typer.Argument(
            help="Ablations to run, such as window.  [default: all]",
            metavar="NAME",
            show_default=False,
        ),
    ] = None,
    shard: ShardOption = "1/1",
    out: OutOption = Path("results"),
    workers: WorkersOption = -1,
    scheduler: SchedulerOption = "",
    cache: CacheOption = DEFAULT_FOLDER,
) -> None:
    """Vary one parameter of simulator or estimator at a time; mean errors as CSV, and a figure."""
    studies = chosen_studies(names or list(ABLATIONS), ABLATIONS, "ablation")
    run_studies(studies, out, Cache(cache), Workers(workers, scheduler), shard)


def run_studies(
    studies: list[Study], out: Path, cache: Cache, workers: Workers, shard: str = "1/1"
) -> None:
    """Run studies one after the other, and write the files of each as soon as it is done."""
    part = parse_shard(shard)
    check_folder(out)
    if part == WHOLE:
        for study in studies:
            read_others(study, out)  # before hours of work
    outcomes, written = [], []
    for study in studies:
        outcome, paths = save_study(study, out, cache, workers, part)
        outcomes.append(outcome)
        written += paths
    finish(_joined(outcomes), cache, *written)


def save_study(
    study: Study, out: Path, cache: Cache, workers: Workers, shard: tuple[int, int] = WHOLE
) -> tuple[Outcome, list[Path]]:
    """Run a study, or a shard of it, and write what there is of its files into a folder."""
    start = time.perf_counter()
    outcome = run_study(study, cache, workers, shard)
    runs_path = out / study.runs_file
    save_csv(runs_path, outcome.runs)
    written = [runs_path]
    if shard == WHOLE:
        written += save_derived(study, out)
    command = study.command_line
    if shard != WHOLE:
        command += f" --shard {shard[0]}/{shard[1]}"
    for path in written:
        if path.suffix == ".csv":
            save_provenance(
                path,
                command,
                {"study": study.name, "shard": f"{shard[0]}/{shard[1]}", **study.config},
                time.perf_counter() - start,
                context_or_none(),
                recordings_simulated=outcome.n_simulated,
            )
    if shard == WHOLE:
        record_checksums(out, written)
    return outcome, written


def _joined(outcomes: list[Outcome]) -> Outcome:
    """Sum up several studies."""
    return Outcome(
        pd.concat([outcome.runs for outcome in outcomes], ignore_index=True),
        sum(outcome.n_recordings for outcome in outcomes),
        sum(outcome.n_simulated for outcome in outcomes),
        max(outcome.peak_mb for outcome in outcomes),
        sum(outcome.n_deaths for outcome in outcomes),
    )
