"""A grid in TOML in, the study of it out: a method's errors at each of its points.

Ablations (configs/ablation_*.toml) are such studies. All methods and points of a grid see the same
flights.
"""

from collections.abc import Callable, Sequence
from typing import Any

import pandas as pd
from matplotlib.figure import Figure

from experiments.drawing.ablations import ablation_figure
from experiments.lab.grid import GridConfig, config_names, named_config
from experiments.lab.scored import SCORED
from experiments.lab.study import Study

PREFIX = "ablation_"

_ERRORS = {
    "t_d_error_ms": ("mean", "std", "median"),
    "r_error_deg": ("mean", "std"),
    "t_error_deg": ("mean", "std"),
}


def grid_study(
    grid: GridConfig,
    summarise: Callable[[pd.DataFrame], pd.DataFrame],
    draw: Callable[[pd.DataFrame, pd.DataFrame], Figure] | None = None,
    command: str = "",
) -> Study:
    """Make the study of a grid, whose measure is to run a method and score it."""
    keys = (*grid.varied, "flight", "method")
    return Study(
        grid.name, grid.title, grid.cells, SCORED, summarise, keys, draw,
        config=dict(grid.content), command=command,
    )  # fmt: skip


def means_study(grid: GridConfig, command: str = "") -> Study:
    """Make the study of a grid that shows mean errors, drawn if its TOML says how."""
    draws = grid.figure is not None
    return grid_study(
        grid,
        lambda runs: ablation_table(runs, grid.varied),
        (lambda means, _: ablation_figure(means, grid)) if draws else None,
        command,
    )


def ablation_names() -> list[str]:
    """List the ablations that come with the project."""
    return [name.removeprefix(PREFIX) for name in config_names(PREFIX)]


def ablation_study(name: str) -> Study:
    """Give an ablation, by its short name."""
    return means_study(named_config(PREFIX + name), f"ssac ablate {name}")


def ablation_table(runs: pd.DataFrame, varied: Sequence[str]) -> pd.DataFrame:
    """Mean errors at each point of a grid.

    Parameters
    ----------
    runs
        Rows of the grid's runs.
    varied
        Columns that tell the points apart.

    Returns
    -------
    pd.DataFrame
        One row for each point and method, in their order: the varied parameters, `method`,
        `n_runs`, `failed` (status not "ok"), and over the other runs the mean, standard deviation
        (over the number of runs) and median of the errors, and the mean number of samples.
    """
    keys = [*varied, "method"]
    rows = []
    for point, group in runs.groupby(keys, sort=False):
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
