"""The paper's simulation tables: their grids, their quantities, and their rows, made from runs.

A run is one method on one flight with one offset. `lab.study.check_runs` checks that the runs are
complete, without repetition; failed runs are counted, and enter no mean.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
import pandas as pd

from experiments.lab.grid import Cell, GridConfig, flight_seed, named_config
from sim.recording import SimConfig
from ssac.pipeline.registry import METHODS


@dataclass(frozen=True)
class Quantity:
    """One error of an estimate; less is better."""

    parameter: str  # parameter of the pose or the clock: prefix of its columns
    unit: str  # suffix of its columns
    symbol: str  # in plain text
    tex: str  # TeX, for figures
    mark: float  # upper limit for `tangency`'s mean in each cell

    @property
    def column(self) -> str:
        """Name of its column in tables of runs."""
        return f"{self.parameter}_error_{self.unit}"

    @property
    def heading(self) -> str:
        """Heading of a column, in plain text."""
        return f"{self.symbol} [{self.unit}]"

    @property
    def label(self) -> str:
        """Label of a figure's axis."""
        return f"error of {self.tex} [{self.unit}]"


T_D_ERROR = Quantity("t_d", "ms", "t_d", "$t_d$", 0.05)
R_ERROR = Quantity("r", "deg", "R", "R", 0.1)
T_ERROR = Quantity("t", "deg", "t", "t", 0.05)

ERRORS = {error.column: error for error in (T_D_ERROR, R_ERROR, T_ERROR)}
"""All quantities, by the names of their columns."""

NOISY_MARKS = {T_D_ERROR: 0.1, R_ERROR: 0.12, T_ERROR: 0.06}
"""Marks for the tables' flights with the noise of a DAVIS346."""

POSE_ERRORS = (R_ERROR.column, T_ERROR.column)

ANGLE_LABEL = "angle between the lines of sight [deg]"


TABLES = ("esim_10", "esim_20")
"""Configurations of the paper's simulation tables: one for each duration."""


@cache
def table_grids() -> tuple[GridConfig, ...]:
    """Read the grids of the tables."""
    return tuple(named_config(name) for name in TABLES)


@cache
def table_cells() -> tuple[Cell, ...]:
    """List every run of the tables."""
    return tuple(cell for grid in table_grids() for cell in grid.cells())


def drawn(sim: SimConfig, flights: Iterable[int]) -> Iterator[tuple[int, int]]:
    """Yield (number, seed) of each flight, for the duration and angle of a configuration."""
    for flight in flights:
        yield flight, flight_seed(sim.spline.duration_s, sim.angle_deg, flight)


ANGLES_DEG = tuple(sorted({cell.sim.angle_deg for cell in table_cells()}))
"""Angles of the tables, in rising order; the studies use the same."""

DURATIONS_S = tuple(sorted({cell.sim.spline.duration_s for cell in table_cells()}))
"""Durations of the tables, in rising order."""

RUN_COLUMNS = (
    "duration_s", "angle_deg", "t_d_ms", "flight", "seed", "method", "status", "reason",
    "t_d_estimate_ms", "t_d_error_ms", "r_error_deg", "t_error_deg", "t_d_std_ms", "r_std_deg",
    "t_std_deg", "r_mahalanobis", "t_mahalanobis", "n_samples", "d_avg_px", "n_events_cam1",
    "n_events_cam2",
)  # fmt: skip

KEY = ["duration_s", "angle_deg", "t_d_ms", "flight", "method"]
"""Columns that identify the run of a row; its `seed` is the one that `ssac simulate` takes."""

_WHOLE = ("flight", "seed", "n_samples", "n_events_cam1", "n_events_cam2")


def ordered_runs(runs: pd.DataFrame) -> pd.DataFrame:
    """Sort runs and columns as in `runs.csv`; drop other columns and turn counts into integers."""
    runs = in_order(runs.reindex(columns=list(RUN_COLUMNS)), KEY)
    return runs.astype(dict.fromkeys(_WHOLE, "Int64"))


def in_order(rows: pd.DataFrame, keys: Sequence[str]) -> pd.DataFrame:
    """Sort rows by columns, methods as `method_order` does."""
    place = {name: number for number, name in enumerate(method_order(rows["method"]))}
    return rows.sort_values(
        list(keys),
        key=lambda column: column.map(place) if column.name == "method" else column,
        ignore_index=True,
    )


def method_order(methods: Iterable[str]) -> list[str]:
    """Order methods as the registry does; those that are not registered here come last, by name."""
    there = set(methods)
    return [name for name in METHODS if name in there] + sorted(there - set(METHODS))


def pose_methods(runs: pd.DataFrame) -> list[str]:
    """List the methods that give a pose in any run, in order."""
    return method_order(runs.loc[runs[list(POSE_ERRORS)].notna().any(axis=1), "method"])


def esim_table(runs: pd.DataFrame, duration_s: float) -> pd.DataFrame:
    """Return all methods' mean errors on the recordings of one duration, in the paper's row order.

    Runs are as `ordered_runs` takes them; those of other durations only say which methods give a
    pose. Columns are `angle_deg`, `t_d_ms`, `n_runs` (flights), then for each method the mean and
    the standard deviation (over the number of runs, as in the paper) of each error, and
    `<method>_failed`, the number of runs whose status is not "ok". Failed runs do not enter the
    means; where no run is "ok" the means are NaN.
    """
    runs = ordered_runs(runs)
    poses = pose_methods(runs)
    of_duration = runs[runs["duration_s"] == duration_s]
    rows = []
    for (angle_deg, t_d_ms), cell in of_duration.groupby(["angle_deg", "t_d_ms"]):
        row = {"angle_deg": angle_deg, "t_d_ms": t_d_ms, "n_runs": cell["flight"].nunique()}
        # NumPy, since pandas takes 1 ms for each of the thousands of selections.
        of, is_ok = cell["method"].to_numpy(), cell["status"].to_numpy() == "ok"
        errors = {name: cell[name].to_numpy(np.float64) for name in ERRORS}
        for method in method_order(of):
            mine = of == method
            for error in (T_D_ERROR.column, *(POSE_ERRORS if method in poses else ())):
                values = errors[error][mine & is_ok & np.isfinite(errors[error])]
                row[f"{method}_{error}_mean"] = values.mean() if len(values) else np.nan
                row[f"{method}_{error}_std"] = values.std() if len(values) else np.nan
            row[f"{method}_failed"] = int((mine & ~is_ok).sum())
        rows.append(row)
    return pd.DataFrame(rows)


def esim_tables(runs: pd.DataFrame) -> dict[float, pd.DataFrame]:
    """Return the table of each duration in the runs, by duration [s]."""
    return {float(value): esim_table(runs, value) for value in sorted(runs["duration_s"].unique())}
