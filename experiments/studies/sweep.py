"""A user's own grid as a study: each run a row, and a table of its points with a figure.

`ssac sweep` and `ssac ablate` take the file; docs/sweeps.md says what the columns are.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import t as student

from experiments.drawing.panels import Figure, legend_below, panels
from experiments.lab.grid import GridConfig
from experiments.lab.scored import SCORED
from experiments.lab.study import Runs, Study
from experiments.lab.summary import answered, by_group, made_of
from experiments.paper.quantities import ERRORS

LEVEL = 0.95


def sweep_study(grid: GridConfig, runs_file: str, points: str, command: str) -> Study:
    """Make the study of a grid; `points` is the stem of the table of points, and of the figure."""
    runs = runs_file.removesuffix(".csv")
    figure = f"{runs if points != grid.name else points}.png"
    return Study(
        grid.name, grid.title, grid.cells, SCORED,
        Runs(runs_file, (*grid.varied, "flight", "method")),
        (made_of(f"{points}.csv", lambda table: points_table(table, grid.varied), runs),
         made_of(figure, lambda table: points_figure(table, grid.varied), points)),
        config={"grid": dict(grid.content), "name": grid.name}, command=command, shows=points,
        is_committed=False,
    )  # fmt: skip


def points_table(runs: pd.DataFrame, varied: Sequence[str]) -> pd.DataFrame:
    """Sum up the runs at each point of a grid, by method.

    `refusals` says how often each status but "ok" came; of each error there are, over the answered
    runs, the mean, its 95 % interval `_low` to `_high` (Student's t), and the median. Empty where
    nothing is known.
    """

    def row(group: pd.DataFrame) -> dict[str, Any]:
        ok, statuses = answered(group), group["status"].value_counts().sort_index()
        row: dict[str, Any] = {"runs": len(group), "answered": len(ok)}
        row["refusals"] = ", ".join(f"{one} {n}" for one, n in statuses.items() if one != "ok")
        for error in ERRORS:
            row |= {f"{error}_{name}": value for name, value in _of_error(ok[error]).items()}
        return row

    return by_group(runs, [*varied, "method"], row, dropna=False)


def _of_error(column: "pd.Series[Any]") -> dict[str, float]:
    """Mean of an error with its interval, and the median."""
    values = column.dropna().to_numpy(np.float64)
    n = len(values)
    if n == 0:
        return dict.fromkeys(("mean", "low", "high", "median"), np.nan)
    mean, half = float(np.mean(values)), np.nan
    if n > 1:
        deviation = float(np.std(values, ddof=1)) / np.sqrt(n)
        half = float(student.ppf(0.5 + 0.5 * LEVEL, n - 1)) * deviation
    return {"mean": mean, "low": mean - half, "high": mean + half, "median": np.median(values)}


def points_figure(points: pd.DataFrame, varied: Sequence[str]) -> Figure:
    """Draw the mean errors with their intervals against the first number that varies."""
    drawn = [error for error in ERRORS if points[f"{error}_mean"].notna().any()] or [*ERRORS][:1]
    numbers = [name for name in varied if pd.api.types.is_numeric_dtype(points[name])]
    x = numbers[0] if numbers else "method"
    others = [name for name in (*varied, "method") if name != x]
    figure, (panel_of,) = panels(3.8, columns=len(drawn))
    for axes, error in zip(panel_of, drawn, strict=True):
        lines = points.groupby(others, sort=False, dropna=False) if others else [((), points)]
        for point, line in lines:
            line = line.sort_values(x) if numbers else line
            mean = line[f"{error}_mean"]
            below, above = mean - line[f"{error}_low"], line[f"{error}_high"] - mean
            axes.errorbar(
                line[x].to_numpy(), mean.to_numpy(), np.nan_to_num([below, above]), marker="o",
                ms=4, lw=1.2, elinewidth=0.9, label=", ".join(str(value) for value in point),
            )  # fmt: skip
        axes.set_ylim(bottom=0.0)
        axes.set_xlabel(x, fontsize=9)
        axes.set_title(ERRORS[error].label, fontsize=10)
    legend_below(figure, 4)
    return figure
