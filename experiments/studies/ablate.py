"""Grids in configs/ablation_*.toml in, mean errors as CSV and a figure each out: `ssac ablate`."""

import time
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import pandas as pd
import typer

from experiments.figures.ablations import ablation_figure
from experiments.figures.style import save_png
from experiments.run.cache import DEFAULT_FOLDER, Cache
from experiments.run.command import CacheOption, SchedulerOption, WorkersOption, finish
from experiments.run.grid import GridConfig, config_names, named_config
from experiments.run.provenance import save_provenance
from experiments.run.schedule import Outcome, Workers, run_cells
from experiments.studies.sweep import save_csv
from sim.render.gl_context import open_context
from ssac.errors import SsacError

PREFIX = "ablation_"

_ERRORS = {
    "t_d_error_ms": ("mean", "std", "median"),
    "r_error_deg": ("mean", "std"),
    "t_error_deg": ("mean", "std"),
}


def ablate_command(
    names: Annotated[
        list[str] | None,
        typer.Argument(help="Of ablations, such as window.  [default: all]", show_default=False),
    ] = None,
    out: Annotated[Path, typer.Option(help="Folder for the CSVs and figures.")] = Path("results"),
    workers: WorkersOption = -1,
    scheduler: SchedulerOption = "",
    cache: CacheOption = DEFAULT_FOLDER,
) -> None:
    """Vary one parameter of simulator or estimator at a time; mean errors as CSV, and a figure."""
    grids = [_grid(name) for name in names or ablation_names()]
    outcomes = [ablate(grid, out, Cache(cache), Workers(workers, scheduler)) for grid in grids]
    runs = pd.concat([outcome.runs for outcome in outcomes])
    recordings = sum(outcome.n_recordings for outcome in outcomes)
    simulated = sum(outcome.n_simulated for outcome in outcomes)
    peak_mb = max(outcome.peak_mb for outcome in outcomes)
    finish(Outcome(runs, recordings, simulated, peak_mb), Cache(cache), out)


def ablation_names() -> list[str]:
    """List the ablations that come with the project."""
    return [name.removeprefix(PREFIX) for name in config_names(PREFIX)]


def ablate(grid: GridConfig, out: Path, cache: Cache, workers: Workers) -> Outcome:
    """Run one ablation, and write its CSV and figure into the folder `out`."""
    start = time.perf_counter()
    outcome = run_cells(grid.cells(), cache, workers, grid.name)
    path = out / f"{grid.name}.csv"
    save_csv(path, ablation_table(outcome.runs, grid.varied))
    save_provenance(
        path,
        f"ssac ablate {grid.name.removeprefix(PREFIX)}",
        grid.content,
        time.perf_counter() - start,
        open_context(),
        recordings_simulated=outcome.n_simulated,
    )
    if grid.figure is not None:
        # From the file, so that anyone who has it draws the same bytes.
        save_png(ablation_figure(pd.read_csv(path), grid), path.with_suffix(".png"))
    return outcome


def ablation_table(runs: pd.DataFrame, varied: Sequence[str]) -> pd.DataFrame:
    """Mean errors at each point of a grid.

    Parameters
    ----------
    runs : pd.DataFrame
        As `schedule.run_cells` gives them.
    varied : Sequence[str]
        Columns that tell the points apart.

    Returns
    -------
    pd.DataFrame
        One row for each point and method, in their order: the varied parameters, `method`,
        `n_runs`, `failed` (status not "ok"), and over the other runs the mean, standard deviation
        (over the number of runs) and median of the errors, and the mean number of samples.
    """
    keys = [*varied, "method"]
    hashable = runs.assign(**{name: runs[name].map(_hashable) for name in varied})
    rows = []
    for point, group in hashable.groupby(keys, sort=False):
        ok = group[group["status"] == "ok"]
        row: dict[str, Any] = dict(zip(keys, point, strict=True))
        row |= {"n_runs": len(group), "failed": len(group) - len(ok)}
        for error, statistics in _ERRORS.items():
            row[f"{error}_mean"] = ok[error].mean()
            row[f"{error}_std"] = ok[error].std(ddof=0)
            if "median" in statistics:
                row[f"{error}_median"] = ok[error].median()
        row["n_samples_mean"] = ok["n_samples"].mean()
        rows.append(row)
    table: pd.DataFrame = pd.DataFrame(rows)
    return table


def _grid(name: str) -> GridConfig:
    if name not in ablation_names():
        raise SsacError(f"unknown ablation {name!r}: use one of {', '.join(ablation_names())}")
    return named_config(PREFIX + name)


def _hashable(value: Any) -> Any:
    return tuple(value) if isinstance(value, list) else value
