"""The tables' runs in, their errors beside the Cramer-Rao bound out: `ssac efficiency`.

Two tables: one row for each run (`efficiency_runs.csv`), and one for each cell and method
(`efficiency.csv`), whose efficiency is the bound's root mean square over the flights over that of
the errors. `recording_bound` says what the bound assumes.
"""

import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import joblib
import numpy as np
import pandas as pd
import typer
from threadpoolctl import threadpool_limits
from tqdm import tqdm

from experiments.figures.efficiency import efficiency_figure
from experiments.figures.style import save_png
from experiments.paper.esim import csv_text, method_order, ordered_runs, runs_from_csv
from experiments.run.cache import DEFAULT_FOLDER, Cache
from experiments.run.command import CacheOption, WorkersOption
from experiments.run.grid import Cell, named_config
from experiments.run.provenance import save_provenance
from experiments.studies.recording_bound import KNOWN_POSE, SAMPLES, MethodBound, recording_bounds
from sim.render.gl_context import open_context
from ssac.errors import SsacError
from ssac.files.whole_file import whole_file

TABLES = ("esim_10", "esim_20")

Flight = tuple[float, float, int]
"""Duration [s], angle [deg] and number: what a recording is known by in `runs.csv`."""

_FLIGHT = ["duration_s", "angle_deg", "flight"]
CELL = ("duration_s", "angle_deg", "t_d_ms", "method")

UNITS = {"t_d": "ms", "r": "deg", "t": "deg"}
"""Of the errors of t_d, R and t."""


def efficiency_command(
    results: Annotated[Path, typer.Option(help="Folder with `runs.csv`.")] = Path("results"),
    workers: WorkersOption = -1,
    cache: CacheOption = DEFAULT_FOLDER,
    out: Annotated[Path, typer.Option(help="Folder for the CSVs and the PNG.")] = Path("results"),
) -> None:
    """Put every run of the tables beside the least error that its true track allows."""
    start = time.perf_counter()
    runs = bounded_runs(results / "runs.csv")
    bounds = flight_bounds(runs, Cache(cache), workers)
    beside = runs_beside_bounds(runs, bounds)
    cells = efficiency_table(beside)
    out.mkdir(parents=True, exist_ok=True)
    wall_time_s = time.perf_counter() - start
    gl = open_context()
    for name, table in (("efficiency_runs.csv", beside), ("efficiency.csv", cells)):
        with whole_file(out / name) as temporary:
            temporary.write_text(csv_text(table), encoding="utf-8", newline="\n")
        config = {"tables": TABLES, "methods": list(cells["method"].unique())}
        save_provenance(out / name, "ssac efficiency", config, wall_time_s, gl)
    save_png(efficiency_figure(pd.read_csv(out / "efficiency.csv")), out / "efficiency.png")
    summary = efficiency_table(beside, ("duration_s", "method"))
    typer.echo(summary.to_string(index=False, float_format=lambda value: f"{value:.3g}"))
    typer.echo(f"written to {out / 'efficiency.csv'}")


def bounded_runs(path: Path) -> pd.DataFrame:
    """Read the runs of those methods that have a bound; say on stderr which are not there.

    Raises
    ------
    SsacError
        If the file cannot be read, or has no run of such a method.
    """
    try:
        runs = ordered_runs(runs_from_csv(path.read_text(encoding="utf-8")))
    except (OSError, SsacError) as error:
        raise SsacError(f"{path}: {error}: run `ssac tables` first") from error
    there = set(runs["method"])
    absent = [method for method in SAMPLES if method not in there]
    if len(absent) == len(SAMPLES):
        raise SsacError(f"{path}: expected runs of {', '.join(SAMPLES)}, got none of these")
    if absent:
        typer.echo(f"{path} has no runs of {', '.join(absent)}: left out", err=True)
    kept: pd.DataFrame = runs[runs["method"].isin(SAMPLES)].reset_index(drop=True)
    return kept


def flight_bounds(
    runs: pd.DataFrame, cache: Cache, workers: int = -1
) -> dict[Flight, dict[str, MethodBound]]:
    """Find the bounds of all methods on all recordings of the runs.

    Parameters
    ----------
    runs : pd.DataFrame
        As of `bounded_runs`.
    cache : Cache
        Keeps the recordings; those that are not there are simulated.
    workers : int
        Processes; -1: one for each core.

    Raises
    ------
    SsacError
        If a run is of a flight that the tables' grids do not have.
    """
    cells = table_flights()
    flights: list[Flight] = list(dict.fromkeys(runs[_FLIGHT].itertuples(index=False, name=None)))
    for flight in flights:
        if flight not in cells:
            duration_s, angle_deg, number = flight
            raise SsacError(
                f"runs of {duration_s:g} s at {angle_deg:g} deg, flight {number}: in neither of "
                f"{' and '.join(TABLES)}: expected the runs of `ssac tables`"
            )
    methods = method_order(runs["method"])
    cache = Cache(cache.folder.resolve())
    flights.sort(key=lambda flight: -flight[0])  # so that no worker is left alone with a long one
    found = joblib.Parallel(n_jobs=workers, return_as="generator")(
        joblib.delayed(_bounds)(cells[flight], cache, methods) for flight in flights
    )
    shown = tqdm(zip(flights, found, strict=True), desc="recordings", total=len(flights))
    return dict(shown)


def table_flights() -> dict[Flight, Cell]:
    """Give one cell of each recording of the tables."""
    return {
        (cell.sim.spline.duration_s, cell.sim.angle_deg, cell.flight): cell
        for name in TABLES
        for cell in named_config(name).cells()
    }


def runs_beside_bounds(
    runs: pd.DataFrame, bounds: Mapping[Flight, Mapping[str, MethodBound]]
) -> pd.DataFrame:
    """Put the bound of each run that is "ok" beside its errors.

    Returns
    -------
    pd.DataFrame
        `duration_s`, `angle_deg`, `t_d_ms`, `flight`, `method`, `sigma_px` (measured noise of a
        sample of median weight), `n_samples` (that the bound counts), and of t_d [ms], R [deg] and
        t [deg] the bound and the error; NaN for the pose where it was given.
    """
    rows = []
    for run in runs[runs["status"] == "ok"].to_dict("records"):
        method = str(run["method"])
        found = bounds[run["duration_s"], run["angle_deg"], run["flight"]][method]
        given = method in KNOWN_POSE
        rows.append(
            {
                **{name: run[name] for name in ("duration_s", "angle_deg", "t_d_ms", "flight")},
                "method": method,
                "sigma_px": found.sigma_px,
                "n_samples": found.n_samples,
                "t_d_bound_ms": 1e3 * found.bound.t_d_s,
                "t_d_error_ms": run["t_d_error_ms"],
                "r_bound_deg": np.nan if given else np.rad2deg(found.bound.R_rad),
                "r_error_deg": run["r_error_deg"],
                "t_bound_deg": np.nan if given else np.rad2deg(found.bound.t_rad),
                "t_error_deg": run["t_error_deg"],
            }
        )
    table: pd.DataFrame = pd.DataFrame(rows)
    return table


def efficiency_table(beside: pd.DataFrame, keys: Sequence[str] = CELL) -> pd.DataFrame:
    """Sum up the runs that share their keys, by default those of each cell and method.

    Parameters
    ----------
    beside : pd.DataFrame
        As of `runs_beside_bounds`.
    keys : Sequence[str]
        Columns of it.

    Returns
    -------
    pd.DataFrame
        The keys, `n_runs` that are "ok", the means of `sigma_px` and `n_samples`, and of t_d [ms],
        R [deg] and t [deg] the root mean squares of bound and error, and their ratio, the
        efficiency; NaN for the pose where it was given.
    """
    rows = []
    for key, part in beside.groupby(list(keys), sort=False):
        row: dict[str, Any] = dict(zip(keys, key, strict=True))
        row |= {"n_runs": len(part)}
        row |= {name: part[name].mean() for name in ("sigma_px", "n_samples")}
        for parameter, unit in UNITS.items():
            bound, rms = (
                float(np.sqrt(np.mean(part[f"{parameter}_{kind}_{unit}"].to_numpy() ** 2)))
                for kind in ("bound", "error")
            )
            row[f"{parameter}_bound_{unit}"] = bound
            row[f"{parameter}_rms_{unit}"] = rms
            row[f"{parameter}_efficiency"] = bound / rms if rms > 0.0 else np.nan
        rows.append(row)
    table: pd.DataFrame = pd.DataFrame(rows)
    return table


def _bounds(cell: Cell, cache: Cache, methods: list[str]) -> dict[str, MethodBound]:
    with threadpool_limits(1):  # one worker a core
        folder = cache.recording_folder(cell.sim, cell.seed)
        return recording_bounds(folder, cache, methods, cell.estimator)
