"""Errors of an ablation against the value that it varies.

A row of axes for each method, a column for each error; one line for each angle, or for whatever
else the grid varies. Where runs failed, the means of the others are hollow, and one more column
shows the share of those that failed.
"""

import re
from functools import reduce
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator, NullLocator
from numpy.typing import NDArray

from experiments.drawing.style import (
    STANDARD_ERROR,
    SURVIVORS,
    Figure,
    mark_survivors,
    panels,
    value_color,
)
from experiments.lab.grid import FigureConfig, GridConfig, configs_of
from experiments.paper.esim import method_order
from experiments.paper.quantities import ERRORS
from sim.scene.flyers import quadrotor
from ssac.config import N_MIN
from ssac.errors import SsacError

FAILED = "failed"

_PARTS = ("mean", "std")  # of an error's columns
# Of a line, by the parameter that it stands for.
_NAMES = {"sim.angle_deg": "{:g} deg", "sim.spline.duration_s": "{:g} s", "sim.drone": "{}",
          "sim.t_d_s": "offset {:g} s",
          "ssac.rules.tangency.joins_body": "body joined: {}"}  # fmt: skip
_MARKERS = "osD^vPX"
_DASHES = ("-", (0, (1.2, 1.2)), (0, (5.0, 1.5)), "-.")  # of a second parameter's values
_LOG_FROM = 8.0  # largest over least mean from which an error's axis is logarithmic
_MAX_VALUES = 6  # of the parameter, all of which are written below the axis
_DECADES = 1.6  # up to which an axis is labelled at 1, 2 and 5


def ablation_figure(means: pd.DataFrame, grid: GridConfig) -> Figure:
    """Draw an ablation of its means, one row for each point of the grid and method.

    SsacError if the configuration has no table [figure], or the means lack a column.
    """
    look = grid.figure
    if look is None:
        raise SsacError(f"{grid.name}: its TOML has no table [figure]: add one with x and label")
    # Each axis of the grid, but for the one on which x moves, by its first parameter.
    others = [next(iter(axis[0])) for axis in grid.axes if look.x not in axis[0]]
    columns = [look.x, *others, "method", "n_runs", FAILED]
    columns += [f"{error}_{part}" for error in ERRORS for part in _PARTS]
    absent = [column for column in columns if column not in means]
    if absent:
        raise SsacError(f"{grid.name}: its means lack the columns {', '.join(absent)}: rerun it")

    methods = method_order(means["method"])
    quantities = [error for error in ERRORS if means[f"{error}_mean"].notna().any()]
    if (means[FAILED] > 0).any():
        quantities.append(FAILED)
    shape = len(methods), len(quantities)
    figure, rows = panels("", 1.4 + 2.0 * shape[0], *shape, sharex=True, sharey="col")
    lines = _lines(means, others)
    for row, method in zip(rows, methods, strict=True):
        for axes, quantity in zip(row, quantities, strict=True):
            for part, style in lines.values():
                _draw_line(axes, part[part["method"] == method], look, quantity, style)
        row[0].set_ylabel(method, weight="bold")
    for axes, quantity in zip(rows[0], quantities, strict=True):
        axes.set_title(
            "failed runs [%]" if quantity == FAILED else ERRORS[quantity].label, fontsize=10
        )
        _set_scales(axes, means, look, quantity)
    default = look.scale * default_value(look.x)
    on_axis = default > 0.0 or not look.log
    for axes in rows.flat if on_axis else ():
        axes.axvline(default, color="0.4", lw=0.9, ls="--", zorder=1)
    figure.supxlabel(look.label, fontsize=10)
    handles = [
        Line2D([], [], label=name, lw=1.2, ms=4.5, **style) for name, (_, style) in lines.items()
    ]
    label = f"default: {default:g}{'' if on_axis else ', not on this axis'}"
    handles.append(Line2D([], [], color="0.4", ls="--" if on_axis else "none", label=label))
    said = (STANDARD_ERROR, SURVIVORS) if FAILED in quantities else (STANDARD_ERROR,)
    handles += [Line2D([], [], **{"color": "0.3", **style}, label=words) for words, style in said]
    figure.legend(handles=handles, loc="outside upper center", ncols=3 if len(handles) <= 6 else 4,
                  fontsize=8, frameon=False, title=grid.title, title_fontsize=12)  # fmt: skip
    return figure


def default_value(name: str) -> float:
    """Give the default of a parameter by its dotted name, in its own unit."""
    if name == "sim.drone_size_m":  # whose default, None, leaves it to the drone
        return quadrotor().size_m
    if name == "ssac.n_min":  # whose default, None, may leave it to a thin object
        return N_MIN
    root, *path = name.split(".")
    roots: dict[str, Any] = dict(zip(("sim", "ssac"), configs_of({}), strict=True))
    return float(reduce(getattr, path, roots[root]))


def _lines(
    means: pd.DataFrame, others: list[str]
) -> dict[str, tuple[pd.DataFrame, dict[str, Any]]]:
    """Split the means by the other parameters: rows and look of each line, by what it is of.

    The first parameter sets the colour (`style.value_color`). A second one sets marker and dashes;
    the first sets the marker where it is alone.
    """
    if not others:
        return {"mean": (means, _look(value_color("", 0, 0.0), 0, 0))}
    parts = list(means.groupby(others, sort=True))
    values = [means[name].nunique() for name in others]
    n_inner = values[1] if len(values) == 2 else 1
    places = np.linspace(0.0, 1.0, len(parts) // n_inner)
    lines = {}
    for k, (key, part) in enumerate(parts):
        outer, inner = divmod(k, n_inner)
        color = value_color(others[0], key[0], places[outer])
        style = _look(color, *((outer, 0) if n_inner == 1 else (inner, inner)))
        lines[", ".join(map(_line_name, others, key))] = part, style
    return lines


def _look(color: Any, kind: int, dash: int) -> dict[str, Any]:
    marker, dashes = _MARKERS[kind % len(_MARKERS)], _DASHES[dash % len(_DASHES)]
    return {"color": color, "marker": marker, "ls": dashes}


def _line_name(name: str, value: Any) -> str:
    """Say in words which value of a parameter a line is of."""
    if name == "sim.background_files":  # a list, as text
        return ", ".join(re.findall(r"([\w-]+)\.\w+", str(value))) or "even sky"
    return _NAMES.get(name, f"{name} = {{}}").format(value)


def _draw_line(
    axes: Axes, rows: pd.DataFrame, look: FigureConfig, quantity: str, style: dict[str, Any]
) -> None:
    """Draw means and their standard errors, which on a mean of errors never reach zero."""
    rows = rows.sort_values(look.x)
    x = look.scale * rows[look.x].to_numpy(np.float64)
    if quantity == FAILED:
        axes.plot(x, 100.0 * rows[FAILED] / rows["n_runs"], lw=1.2, ms=4.5, **style)
    elif rows[f"{quantity}_mean"].notna().any():
        n_ok = (rows["n_runs"] - rows[FAILED]).to_numpy(np.float64)
        mean, std = (rows[f"{quantity}_{part}"].to_numpy(np.float64) for part in _PARTS)
        error = std / np.sqrt(n_ok.clip(min=1))
        axes.errorbar(x, mean, error, lw=1.2, ms=4.5, elinewidth=0.9, **style)
        mark_survivors(axes, x, mean, n_ok, rows["n_runs"], ms=4.5, **style)


def _set_scales(axes: Axes, means: pd.DataFrame, look: FigureConfig, quantity: str) -> None:
    """Set both axes; those of a column share them."""
    values = look.scale * np.unique(means[look.x].to_numpy(np.float64))
    if look.log:
        axes.set_xscale("log")
        _label_log_axis(axes.xaxis, values)
    if len(values) <= _MAX_VALUES:
        axes.set_xticks(values)
        axes.xaxis.set_minor_locator(NullLocator())
        axes.tick_params("x", labelsize=7)
    found = means[FAILED if quantity == FAILED else f"{quantity}_mean"].to_numpy(np.float64)
    if quantity == FAILED or np.nanmax(found) < _LOG_FROM * np.nanmin(found):
        axes.set_ylim(bottom=0.0)
    else:
        axes.set_yscale("log")
        _label_log_axis(axes.yaxis, found)


def _label_log_axis(axis: Axis, values: NDArray[np.float64]) -> None:
    """Write plain numbers, and enough of them, on a logarithmic axis."""
    axis.set_major_formatter("{x:g}")
    axis.set_minor_formatter("")
    if np.nanmax(values) < 10.0**_DECADES * np.nanmin(values):
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axis.set_minor_locator(NullLocator())
