"""A user's own grid as a study: each run a row, and a table of its points with a figure.

`ssac sweep` and `ssac ablate` take the file; docs/sweeps.md says what the columns are.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from scipy.stats import t as student

from experiments.lab.grid import GridConfig
from experiments.lab.scored import SCORED
from experiments.lab.study import Made, Runs, Study
from experiments.paper.quantities import ERRORS

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LEVEL = 0.95


def sweep_study(grid: GridConfig, runs_file: str, points: str, command: str) -> Study:
    """Make the study of a grid.

    Parameters
    ----------
    runs_file
        File of the rows.
    points
        Name of the table of points and of the figure, without a suffix.
    """
    runs = runs_file.removesuffix(".csv")
    return Study(
        grid.name,
        grid.title,
        grid.cells,
        SCORED,
        Runs(runs_file, (*grid.varied, "flight", "method")),
        (
            Made(f"{points}.csv", lambda results: points_table(results.table(runs), grid.varied)),
            Made(f"{runs}.png" if points != grid.name else f"{points}.png",
                 lambda results: points_figure(results.table(points), grid.varied)),
        ),
        config={"grid": dict(grid.content), "name": grid.name},
        command=command,
        shows=points,
        is_committed=False,
    )  # fmt: skip


def points_table(runs: pd.DataFrame, varied: Sequence[str]) -> pd.DataFrame:
    """Sum up the runs at each point of a grid.

    Returns
    -------
    pd.DataFrame
        One row for each point and method, in their order: what varies, `method`, `runs`,
        `answered` (status "ok"), `refusals` (how often each other status came), and of each error,
        over the answered runs, the mean, its 95 % interval `_low` to `_high` (Student's t), and the
        median. Empty where nothing is known.
    """
    keys = [*varied, "method"]
    rows = []
    for point, group in runs.groupby(keys, sort=False, dropna=False):
        ok = group[group["status"] == "ok"]
        refused = group.loc[group["status"] != "ok", "status"].value_counts().sort_index()
        row: dict[str, Any] = dict(zip(keys, point, strict=True))
        row |= {"runs": len(group), "answered": len(ok)}
        row["refusals"] = ", ".join(f"{status} {n}" for status, n in refused.items())
        for error in ERRORS:
            row |= {f"{error}_{name}": value for name, value in _of_error(ok[error]).items()}
        rows.append(row)
    table: pd.DataFrame = pd.DataFrame(rows)
    return table


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


def points_figure(points: pd.DataFrame, varied: Sequence[str]) -> "Figure":
    """Draw the mean errors with their intervals against the first number that varies."""
    from matplotlib.figure import Figure

    from experiments.drawing.style import WIDTH_IN, quiet_axes

    drawn = [error for error in ERRORS if points[f"{error}_mean"].notna().any()] or [*ERRORS][:1]
    numbers = [name for name in varied if pd.api.types.is_numeric_dtype(points[name])]
    x = numbers[0] if numbers else "method"
    others = [name for name in (*varied, "method") if name != x]
    figure = Figure(figsize=(WIDTH_IN, 3.8), layout="constrained")
    for axes, error in zip(figure.subplots(1, len(drawn), squeeze=False)[0], drawn, strict=True):
        lines = points.groupby(others, sort=False, dropna=False) if others else [((), points)]
        for point, line in lines:
            if numbers:
                line = line.sort_values(x)
            mean = line[f"{error}_mean"]
            below, above = mean - line[f"{error}_low"], line[f"{error}_high"] - mean
            names = ", ".join(str(value) for value in point)
            axes.errorbar(
                line[x].to_numpy(), mean.to_numpy(), np.nan_to_num([below, above]),
                marker="o", ms=4, lw=1.2, elinewidth=0.9, label=names,
            )  # fmt: skip
        quiet_axes(axes)
        axes.set_ylim(bottom=0.0)
        axes.set_xlabel(x, fontsize=9)
        axes.set_title(ERRORS[error].label, fontsize=10)
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, fontsize=8, frameon=False)
    return figure
