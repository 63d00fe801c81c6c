"""Ablations: one parameter varied at a time, and how far each method's mean errors move with it.

An ablation is a grid in `experiments/configs/` whose name begins with `ablation_`. All methods and
points of a grid see the same flights.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from experiments.lab.grid import GridConfig, config_names, named_config
from experiments.lab.markdown import digits, markdown_table
from experiments.lab.results import Results
from experiments.lab.scored import SCORED
from experiments.lab.study import Made, Runs, Study
from experiments.lab.verify import scored_checks
from experiments.paper.quantities import NOISY_T_D_MARK_MS, R_ERROR, T_D_ERROR

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PREFIX = "ablation_"

_ERRORS = {
    "t_d_error_ms": ("mean", "std", "median"),
    "r_error_deg": ("mean", "std"),
    "t_error_deg": ("mean", "std"),
}

SHOWN: Mapping[str, Sequence[str]] = {
    "size": ["sim.drone_size_m"],
}
"""Of ablations that a page shows: columns that tell the rows apart; all else is averaged over."""


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


def page_table(results: Results, name: str) -> str:
    """Mean errors of t_d and R over all angles, for each value of what varies, by method."""
    stem, varied = f"{PREFIX}{name}", SHOWN[name]
    table = results.table(stem)
    methods = list(dict.fromkeys(table["method"]))
    columns = [results.texts(stem, column) for column in varied]
    points = list(zip(*columns, strict=True))
    rows = []
    for values in dict.fromkeys(points):
        part = table[[point == values for point in points]]
        cells = list(values)
        for method in methods:
            of = part[part["method"] == method]
            answered = int((of["n_runs"] - of["failed"]).sum())
            shown = [
                digits(float(of[column].mean())) if column in of else "none"
                for column in (f"{T_D_ERROR.column}_mean", f"{R_ERROR.column}_mean")
            ]
            means = " / ".join(text for text in shown if text != "none") or "none"
            cells.append(f"{means} ({answered}/{int(of['n_runs'].sum())})")
        rows.append(cells)
    return markdown_table([*(c.split(".")[-1] for c in varied), *(f"`{m}`" for m in methods)], rows)


def largest_with_noise(results: Results) -> str:
    """Largest mean error of `tangency` in a cell of the tables' flights with a DAVIS346's noise."""
    means = results.column("ablation_davis346", "t_d_error_ms_mean", method="tangency")
    return f"{np.nanmax(means):.3f} ms"


def ablation_study(grid: GridConfig, command: str = "", **more: Any) -> Study:
    """Make the study of a grid that shows mean errors, drawn if its TOML says how."""

    def table(results: Results) -> pd.DataFrame:
        return ablation_table(results.table(f"{grid.name}_runs"), grid.varied)

    def figure(results: Results) -> "Figure":
        from experiments.drawing.ablations import ablation_figure

        return ablation_figure(results.table(grid.name), grid)

    makes = [Made(f"{grid.name}.csv", table)]
    if grid.figure is not None:
        makes.append(Made(f"{grid.name}.png", figure))
    runs = Runs(f"{grid.name}_runs.csv", (*grid.varied, "flight", "method"))
    return Study(
        grid.name, grid.title, grid.cells, SCORED, runs, tuple(makes),
        checks=scored_checks(f"{grid.name}_runs"), config=grid.content, command=command, **more,
    )  # fmt: skip


def _study(name: str) -> Study:
    numbers: dict[str, Callable[[Results], str]] = {}
    if name in SHOWN:
        numbers[f"table.ablation.{name}"] = partial(page_table, name=name)
    if name == "davis346":
        numbers |= {
            "davis346.largest": largest_with_noise,
            "davis346.mark": lambda _: f"{NOISY_T_D_MARK_MS:g} ms",
        }
    return ablation_study(named_config(PREFIX + name), f"ssac ablate {name}", numbers=numbers)


ABLATIONS = {
    name: _study(name) for name in (full.removeprefix(PREFIX) for full in config_names(PREFIX))
}
"""By the names that `ssac ablate` takes."""

STUDIES = tuple(ABLATIONS.values())
