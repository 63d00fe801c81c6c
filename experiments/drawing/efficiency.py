"""The figure of how far the errors of each method are from its own Cramer-Rao bound.

For each angle and method a line goes from the bound, a stroke, up to the root mean square error, a
marker: its length on the logarithmic axis is what is lost.
"""

from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from experiments.drawing.style import WIDTH_IN, Look, error_axes, label_grid, method_looks
from experiments.paper.esim import method_order
from experiments.paper.quantities import ERRORS

_STEP_DEG = 30.0  # between angles
_SHARE = 0.7  # of this step that the methods' columns take


def efficiency_figure(cells: pd.DataFrame) -> Figure:
    """Draw `results/efficiency.csv`, one column of axes for each duration.

    Parameters
    ----------
    cells
        As of `efficiency.efficiency_table`; the offsets of an angle are pooled.
    """
    durations_s, methods = sorted(cells["duration_s"].unique()), method_order(cells["method"])
    looks = method_looks(methods)
    figure = Figure(figsize=(WIDTH_IN, 8.0), layout="constrained")
    grid = figure.subplots(len(ERRORS), len(durations_s), sharex=True, sharey="row", squeeze=False)
    for row, error in zip(grid, ERRORS.values(), strict=True):
        columns = [f"{error.parameter}_{kind}_{error.unit}" for kind in ("bound", "rms")]
        drawn = [
            method
            for method in methods
            if cells.loc[cells["method"] == method, columns].notna().all(axis=None)
        ]
        for axes, duration_s in zip(row, durations_s, strict=True):
            error_axes(axes, sorted(cells["angle_deg"].unique()))
            of_duration = cells[cells["duration_s"] == duration_s]
            for slot, method in enumerate(drawn):
                shift_deg = _SHARE * _STEP_DEG * ((slot + 0.5) / len(drawn) - 0.5)
                own = of_duration[of_duration["method"] == method]
                _draw(axes, own, columns, looks[method], shift_deg)
        row[0].set_ylabel(error.label)
    label_grid(figure, grid, durations_s, _legend(looks))
    return figure


def pooled(cells: pd.DataFrame, columns: list[str]) -> pd.DataFrame:
    """Root mean squares of some columns by angle, over the offsets, as many runs as each has."""
    squares = cells[columns].pow(2).mul(cells["n_runs"], axis=0)
    by_angle = squares.groupby(cells["angle_deg"]).sum()
    n_runs = cells["n_runs"].groupby(cells["angle_deg"]).sum()
    result: pd.DataFrame = by_angle.div(n_runs, axis=0).pow(0.5)
    return result


def _draw(
    axes: Axes, cells: pd.DataFrame, columns: list[str], look: Look, shift_deg: float
) -> None:
    values = pooled(cells, columns)
    x = values.index.to_numpy(np.float64) + shift_deg
    bounds, errors = (values[column].to_numpy(np.float64) for column in columns)
    axes.vlines(x, bounds, errors, color=look.color, lw=1.2, alpha=0.6, zorder=2)
    axes.plot(x, bounds, ls="none", marker="_", ms=8, mew=1.8, color=look.color, zorder=3)
    axes.plot(
        x, errors, ls="none", marker=look.marker, ms=5, mfc=look.face, mec=look.color, zorder=4
    )


def _legend(looks: dict[str, Look]) -> list[Line2D]:
    handles = [
        Line2D([], [], color=look.color, marker=look.marker, mfc=look.face, lw=0, ms=5, label=name)
        for name, look in looks.items()
    ]
    styles: tuple[tuple[str, dict[str, Any]], ...] = (
        ("root mean square error", {"marker": "o", "ms": 5}),
        ("its Cramer-Rao bound", {"marker": "_", "ms": 8, "mew": 1.8}),
    )
    handles += [Line2D([], [], color="0.3", lw=0, label=label, **style) for label, style in styles]
    return handles
