"""Studies of a grid: the ablations, and a user's own (`ssac ablate`, `ssac sweep`).

An ablation is a grid in `experiments/configs/` whose name begins with `ablation_`: one parameter is
varied at a time, to see how far each method's mean errors move with it. All methods and points of a
grid see the same flights. docs/sweeps.md describes the columns of a user's own grid.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
import pandas as pd
from scipy.special import stdtrit

from experiments.drawing.errors import ablation_figure
from experiments.drawing.style import Figure, legend_outside, mark_survivors, panels
from experiments.lab.grid import FigureConfig, GridConfig, config_names, named_config
from experiments.lab.results import Results
from experiments.lab.scored import SCORED
from experiments.lab.study import Runs, Study
from experiments.lab.summary import answered, by_group, digits, made_of, markdown_table, statistics
from experiments.lab.verify import scored_checks
from experiments.paper.esim import ERRORS, NOISY_MARKS, POSE_ERRORS, R_ERROR, T_D_ERROR

PREFIX = "ablation_"


def ablation_table(runs: pd.DataFrame, varied: Sequence[str]) -> pd.DataFrame:
    """Mean errors of the runs that are "ok", at each point of a grid and by method."""

    def row(group: pd.DataFrame) -> dict[str, Any]:
        ok = answered(group)
        return {
            **{"n_runs": len(group), "failed": len(group) - len(ok)},
            **statistics(ok, [T_D_ERROR.column], "mean", "std", "median"),
            **statistics(ok, POSE_ERRORS, "mean", "std"),
            **statistics(ok, ["n_samples"], "mean"),
        }

    return by_group(*varied, "method")(row)(runs)


def sizes_table(results: Results) -> str:
    """Mean errors of t_d and R over all angles, by the drone's size and method."""
    table, varied = results.table("ablation_size"), "sim.drone_size_m"
    rows = []
    for size_m, of_size in table.groupby(varied, sort=False):
        row = {varied.split(".")[-1]: f"{size_m:g}"}
        for method, of in of_size.groupby("method", sort=False):
            means = [float(of[f"{error.column}_mean"].mean()) for error in (T_D_ERROR, R_ERROR)]
            shown = " / ".join(digits(mean) for mean in means if np.isfinite(mean)) or "none"
            n_runs = int(of["n_runs"].sum())
            row[f"`{method}`"] = f"{shown} ({n_runs - int(of['failed'].sum())}/{n_runs})"
        rows.append(row)
    return markdown_table(pd.DataFrame(rows))


def largest_with_noise(results: Results) -> str:
    """Give the largest mean errors of `tangency` in a cell with a DAVIS346's noise."""
    rows = results.rows("ablation_davis346", method="tangency")
    most = {error: rows[f"{error.column}_mean"].max() for error in NOISY_MARKS}
    return ", ".join(f"{value:.3f} {error.unit}" for error, value in most.items())


_NUMBERS: Mapping[str, Mapping[str, Callable[[Results], str]]] = {
    "ablation_size": {"table.ablation.size": sizes_table},
    "ablation_davis346": {
        "davis346.largest": largest_with_noise,
        "davis346.mark": lambda _: ", ".join(f"{m:g} {of.unit}" for of, m in NOISY_MARKS.items()),
    },
}


def ablation_study(grid: GridConfig, command: str) -> Study:
    """Make the study of a grid's mean errors, with the figure that its TOML describes."""
    name, runs = grid.name, f"{grid.name}_runs"
    return Study(
        name, grid.title, grid.cells, SCORED,
        Runs(f"{runs}.csv", (*grid.varied, "flight", "method")),
        (made_of(f"{name}.csv", lambda of: ablation_table(of, grid.varied), runs),
         made_of(f"{name}.png", partial(ablation_figure, grid=grid), runs)),
        numbers=_NUMBERS.get(name, {}), checks=scored_checks(runs), config=grid.content,
        command=command,
    )  # fmt: skip


LEVEL = 0.95  # of the interval of a mean


def sweep_study(grid: GridConfig, runs_file: str, command: str, points: str = "") -> Study:
    """Make the study of a grid.

    `points` is the stem of the table of points and of the figure; empty: they are called like the
    runs, the table with `_cells` behind.
    """
    runs, config = runs_file.removesuffix(".csv"), {"grid": dict(grid.content), "name": grid.name}
    if points:
        config["points"] = points
    figure, points = f"{points or runs}.png", points or f"{runs}_cells"
    return Study(
        grid.name, grid.title, grid.cells, SCORED,
        Runs(runs_file, (*grid.varied, "flight", "method")),
        (made_of(f"{points}.csv", lambda table: points_table(table, grid.varied), runs),
         made_of(figure, lambda table: points_figure(table, grid), points)),
        config=config, command=command, shows=points,
        is_committed=False,
    )  # fmt: skip


def points_table(runs: pd.DataFrame, varied: Sequence[str]) -> pd.DataFrame:
    """Sum up the runs at each point of a grid, by method, as docs/sweeps.md says."""

    def row(group: pd.DataFrame) -> dict[str, Any]:
        ok, statuses = answered(group), group["status"].value_counts().sort_index()
        row: dict[str, Any] = {"runs": len(group), "answered": len(ok)}
        row["refusals"] = ", ".join(f"{one} {n}" for one, n in statuses.items() if one != "ok")
        for error in ERRORS:
            row |= {f"{error}_{name}": value for name, value in _of_error(ok[error]).items()}
        return row

    return by_group(*varied, "method")(row)(runs)


def _of_error(column: "pd.Series[Any]") -> dict[str, float]:
    """Mean of an error with its interval (Student's t), and the median."""
    values: Any = column.dropna()
    mean, freedom = values.mean(), len(values) - 1
    half = float(stdtrit(freedom, 0.5 + 0.5 * LEVEL)) * values.sem()
    return {"mean": mean, "low": mean - half, "high": mean + half, "median": values.median()}


def points_figure(points: pd.DataFrame, grid: GridConfig) -> Figure:
    """Draw mean errors with intervals against the figure's, or the first numeric, parameter.

    Parameters that move together with it make no lines of their own.
    """
    drawn = [error for error in ERRORS if points[f"{error}_mean"].notna().any()] or [*ERRORS][:1]
    numbers = [name for name in grid.varied if pd.api.types.is_numeric_dtype(points[name])]
    (first, *_) = numbers or ["method"]
    look = grid.figure or FigureConfig(first, first)
    x = look.x
    along = {x, *(name for axis in grid.axes if x in axis[0] for name in axis[0])}
    others = [name for name in (*grid.varied, "method") if name not in along]
    title = f"Mean errors; a bar is the interval of {LEVEL:.0%}"
    figure, (panel_of,) = panels(title, 3.8, columns=len(drawn))
    for axes, error in zip(panel_of, drawn, strict=True):
        lines = points.groupby(others, sort=False, dropna=False) if others else [((), points)]
        for point, line in lines:
            line = line.sort_values(x) if numbers else line
            mean, at = line[f"{error}_mean"], look.scale * line[x] if numbers else line[x]
            label = ", ".join(str(value) for value in point)
            below, above = mean - line[f"{error}_low"], line[f"{error}_high"] - mean
            drawn_line = axes.errorbar(
                at.to_numpy(), mean.to_numpy(), np.nan_to_num([below, above]), marker="o",
                ms=4, lw=1.2, elinewidth=0.9, label=label,
            )  # fmt: skip
            marker = {"marker": "o", "ms": 4, "color": drawn_line.lines[0].get_color()}
            mark_survivors(axes, at, mean, line["answered"], line["runs"], **marker)
        axes.set_ylim(bottom=0.0)
        if look.log:
            axes.set_xscale("log")
        axes.set_xlabel(look.label, fontsize=9)
        axes.set_title(ERRORS[error].label, fontsize=10)
    legend_outside(figure, 4)
    return figure


ABLATIONS = {
    name: ablation_study(named_config(PREFIX + name), f"ssac ablate {name}")
    for name in (full.removeprefix(PREFIX) for full in config_names(PREFIX))
}
"""By the names that `ssac ablate` takes."""

STUDIES = tuple(ABLATIONS.values())
