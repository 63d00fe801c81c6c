"""Ablations: one parameter varied at a time, and how far each method's mean errors move with it.

An ablation is a grid in `experiments/configs/` whose name begins with `ablation_`. All methods and
points of a grid see the same flights.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from experiments.drawing.panels import Figure
from experiments.lab.grid import GridConfig, config_names, named_config
from experiments.lab.markdown import digits, markdown_table
from experiments.lab.results import Results
from experiments.lab.scored import SCORED
from experiments.lab.study import Made, Runs, Study
from experiments.lab.summary import answered, by_group, made_of, statistics
from experiments.lab.verify import scored_checks
from experiments.paper.quantities import NOISY_T_D_MARK_MS, POSE_ERRORS, R_ERROR, T_D_ERROR

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

    return by_group(runs, [*varied, "method"], row)


def sizes_table(results: Results) -> str:
    """Mean errors of t_d and R over all angles, by the drone's size and method."""
    table, varied = results.table("ablation_size"), "sim.drone_size_m"
    methods, rows = list(dict.fromkeys(table["method"])), []
    for size_m, of_size in table.groupby(varied, sort=False):
        cells = [f"{size_m:g}"]
        for method in methods:
            of = of_size[of_size["method"] == method]
            means = [float(of[f"{error.column}_mean"].mean()) for error in (T_D_ERROR, R_ERROR)]
            shown = " / ".join(digits(mean) for mean in means if np.isfinite(mean)) or "none"
            n_runs = int(of["n_runs"].sum())
            cells.append(f"{shown} ({n_runs - int(of['failed'].sum())}/{n_runs})")
        rows.append(cells)
    return markdown_table([varied.split(".")[-1], *(f"`{method}`" for method in methods)], rows)


def largest_with_noise(results: Results) -> str:
    """Largest mean error of `tangency` in a cell of the tables' flights with a DAVIS346's noise."""
    means = results.column("ablation_davis346", "t_d_error_ms_mean", method="tangency")
    return f"{np.nanmax(means):.3f} ms"


_NUMBERS: Mapping[str, Mapping[str, Callable[[Results], str]]] = {
    "ablation_size": {"table.ablation.size": sizes_table},
    "ablation_davis346": {
        "davis346.largest": largest_with_noise,
        "davis346.mark": lambda _: f"{NOISY_T_D_MARK_MS:g} ms",
    },
}


def ablation_study(grid: GridConfig, command: str = "") -> Study:
    """Make the study of a grid that shows mean errors, drawn if its TOML says how."""
    name, runs = grid.name, f"{grid.name}_runs"

    def figure(table: pd.DataFrame) -> Figure:
        from experiments.drawing.ablations import ablation_figure

        return ablation_figure(table, grid)

    makes: list[Made] = [made_of(f"{name}.csv", lambda of: ablation_table(of, grid.varied), runs)]
    if grid.figure is not None:
        makes.append(made_of(f"{name}.png", figure, name))
    return Study(
        name, grid.title, grid.cells, SCORED,
        Runs(f"{runs}.csv", (*grid.varied, "flight", "method")), tuple(makes),
        numbers=_NUMBERS.get(name, {}), checks=scored_checks(runs), config=grid.content,
        command=command,
    )  # fmt: skip


ABLATIONS = {
    name: ablation_study(named_config(PREFIX + name), f"ssac ablate {name}")
    for name in (full.removeprefix(PREFIX) for full in config_names(PREFIX))
}
"""By the names that `ssac ablate` takes."""

STUDIES = tuple(ABLATIONS.values())
