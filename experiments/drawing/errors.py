"""Errors of methods against the angle, and against whatever an ablation varies.

Of the tables each figure has a row of axes for each error and a column for each duration; a marker
is the mean over flights and offsets. Of an ablation a row is a method and a column an error, with
one line for each angle or whatever else the grid varies. Runs that failed have no error: a mean of
the others is hollow.
"""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import reduce
from itertools import pairwise
from typing import Any

import numpy as np
import pandas as pd

from experiments.drawing.style import (
    STANDARD_ERROR,
    SURVIVORS,
    Axes,
    Figure,
    Look,
    Named,
    label_log_axis,
    legend_outside,
    mark_survivors,
    method_looks,
    panels,
    value_color,
)
from experiments.lab.grid import FigureConfig, GridConfig, configs_of
from experiments.lab.summary import answered
from experiments.paper.comparison import PUBLISHED_ERRORS, PUBLISHED_RUNS
from experiments.paper.esim import ANGLE_LABEL, ERRORS, T_D_ERROR, Quantity, method_order
from sim.scene.flyers import quadrotor
from ssac.config import N_MIN

REFINED = ("ssac", "joint", "tangency")
"""Methods without the extrinsics, from the paper's on; each starts from the one before."""

FAILED = "failed"

_LEAST = 0.01  # of each error, in its own unit: what is below is drawn there
_ANGLE_STEP_DEG = 30.0  # at most
_PAPER = Look("#555555", "*")
_THRESHOLD = 1.0  # of each error, in its unit: the largest of the success curves
_MARK_COLOR = "#D55E00"
_SPREAD_DEG = 2.0  # between the columns of neighbouring methods, so that bars do not cover

# Of an ablation's line, by the parameter that it stands for.
_NAMES = {
    "sim.angle_deg": "{:g} deg",
    "sim.spline.duration_s": "{:g} s",
    "sim.drone": "{}",
    "sim.t_d_s": "offset {:g} s",
    "ssac.rules.tangency.joins_body": "body joined: {}",
}
_MARKERS = "osD^vPX"
_DASHES = ("-", (0, (1.2, 1.2)), (0, (5.0, 1.5)), "-.")  # of a second parameter's values
_LOG_FROM = 8.0  # largest over least mean from which an error's axis is logarithmic
_MAX_VALUES = 6  # of the parameter, all of which are written below the axis
_SHORT = 10.0**1.6  # largest over least up to which an axis is labelled at 1, 2 and 5


def error_figure(runs: pd.DataFrame, published: Mapping[float, pd.DataFrame]) -> Figure:
    """Draw the errors of all methods, single runs and means, beside the paper's.

    `published` has the paper's table of each duration [s].
    """
    angles_deg = sorted(runs["angle_deg"].unique())
    step_deg = float(np.diff(angles_deg).min(initial=_ANGLE_STEP_DEG))
    looks = method_looks(method_order(runs["method"]))

    def draw(axes: Axes, duration_s: float, part: pd.DataFrame, error: Quantity) -> None:
        drawn = [m for m in looks if runs.loc[runs["method"] == m, error.column].notna().any()]
        for method, shift_deg in _columns(drawn, 0.84 * step_deg):
            look = looks[method]
            own = part[part["method"] == method]
            ok = _with_error(own, error)
            if len(ok):
                axes.plot(
                    ok["angle_deg"] + shift_deg, ok[error.column].clip(lower=_LEAST), ls="none",
                    marker=".", ms=3.0, mew=0.0, color=look.color, alpha=0.5, zorder=2,
                )  # fmt: skip
                means = flight_means(own, error.column).assign(
                    mean=lambda of: of["mean"].clip(lower=_LEAST)
                )
                _draw_bars(axes, means, look, shift_deg, lw=0.8, elinewidth=1.2, zorder=4)
            paper = published_means(published, duration_s, method, error.column)
            if paper is not None:
                _draw_bars(
                    axes, paper, replace(look, marker="*", is_known=False), shift_deg, ls=":"
                )
        for left, right in pairwise(angles_deg):
            axes.axvline(0.5 * (left + right), color="0.9", lw=0.6, zorder=0)

    labelled = {}
    for method, look in looks.items():
        own = runs[runs["method"] == method]
        failed = int((own["status"] != "ok").sum())
        labelled[f"{method} ({failed} of {len(own)} failed)" if failed else method] = look
    marks = _marks(
        labelled,
        0.8,
        ("the paper's mean", {"marker": "*", "ls": ":", "ms": 9}),
        STANDARD_ERROR,
        ("a single run", {"marker": ".", "ls": "none", "ms": 5, "mew": 0.0}),
        *_survivors(runs),
    )
    ratios = {"height_ratios": (1.7, 1.0, 1.0)}
    title = "Mean errors of all methods, beside the paper's"
    return _error_grid(title, runs, 10.0, draw, marks, 0.85 * _LEAST, **ratios)


def beyond_figure(runs: pd.DataFrame, published: Mapping[float, pd.DataFrame]) -> Figure:
    """Draw what REFINED gain over the paper, beside the marks that `tangency` is to reach.

    A method without runs is left out.
    """
    methods = [method for method in REFINED if method in set(runs["method"])]
    looks = method_looks(methods)
    ends: dict[str, list[float]] = {error: [] for error in ERRORS}

    def draw(axes: Axes, duration_s: float, part: pd.DataFrame, error: Quantity) -> None:
        """Draw means, the paper's first and the methods' beside it, in order."""
        axes.axhline(error.mark, color=_MARK_COLOR, lw=1.0, ls="--", zorder=1)
        paper = published_means(published, duration_s, "ssac", error.column)
        if paper is not None:
            _draw_bars(axes, paper, _PAPER, -0.5 * _SPREAD_DEG * len(REFINED), ls=":")
        ours = {m: flight_means(part[part["method"] == m], error.column) for m in methods}
        for place, (method, means) in enumerate(ours.items(), start=1):
            _draw_bars(axes, means, looks[method], _SPREAD_DEG * (place - 0.5 * len(REFINED)))
        within = ends[error.column]
        within.append(error.mark)
        for means in (*ours.values(), *([] if paper is None else [paper])):
            # The ends of the bars, but none below half its mean.
            lower = np.maximum(means["mean"] - means["standard_error"], 0.5 * means["mean"])
            within += [*lower, *(means["mean"] + means["standard_error"])]
        axes.set_ylim(0.9 * min(within), 1.1 * max(within))

    first = ("the paper", {"color": _PAPER.color, "marker": "*", "ls": ":", "ms": 9})
    mark = ("mark for tangency", {"color": _MARK_COLOR, "ls": "--", "lw": 1.0})
    others = STANDARD_ERROR, mark, *_survivors(runs[runs["method"].isin(methods)])
    title = "Mean errors of each refinement, beside the paper's"
    return _error_grid(title, runs, 8.4, draw, [first, *_marks(looks, 1.2, *others)])


def _survivors(runs: pd.DataFrame) -> list[Named]:
    return [SURVIVORS] if (runs["status"] != "ok").any() else []


def efficiency_figure(cells: pd.DataFrame) -> Figure:
    """Draw `results/efficiency.csv`: how far the errors of each method are from its own bound.

    For each angle and method a line goes from the bound, a stroke, up to the root mean square
    error, a marker: its length on the logarithmic axis is what is lost. The offsets of an angle are
    pooled.
    """
    looks = method_looks(method_order(cells["method"]))

    def draw(axes: Axes, _: float, part: pd.DataFrame, error: Quantity) -> None:
        columns = [f"{error.parameter}_{kind}_{error.unit}" for kind in ("bound", "rms")]
        there = cells[columns].notna().all(axis=1).groupby(cells["method"]).all()
        drawn = [method for method in looks if there[method]]
        for method, shift_deg in _columns(drawn, 0.7 * _ANGLE_STEP_DEG):
            look, values = looks[method], pooled(part[part["method"] == method], columns)
            x = values.index.to_numpy(np.float64) + shift_deg
            bounds, errors = (values[column].to_numpy(np.float64) for column in columns)
            axes.vlines(x, bounds, errors, color=look.color, lw=1.2, alpha=0.6, zorder=2)
            axes.plot(x, bounds, ls="none", marker="_", ms=8, mew=1.8, color=look.color, zorder=3)
            axes.plot(x, errors, ls="none", ms=5, zorder=4, **look.style)

    rms = ("root mean square error", {"marker": "o", "ms": 5, "lw": 0})
    bound = ("its Cramer-Rao bound", {"marker": "_", "ms": 8, "mew": 1.8, "lw": 0})
    title = "Errors, and the least that the flights' noise allows"
    return _error_grid(title, cells, 8.4, draw, _marks(looks, 0, rms, bound))


def success_figure(runs: pd.DataFrame) -> Figure:
    """Draw the share of all runs, the refused among them, whose error is below a threshold.

    Beside each method stands the area under its curve, in percent of all there is.
    """
    looks = method_looks(method_order(runs["method"]))
    durations_s = sorted(runs["duration_s"].unique())
    title = "Runs within a threshold, and the area under each curve (AUC)"
    shape = len(ERRORS), len(durations_s)
    figure, grid = panels(title, 9.0, *shape, sharex="row", sharey=True)
    for row, error in zip(grid, ERRORS.values(), strict=True):
        for axes, duration_s in zip(row, durations_s, strict=True):
            part = runs[runs["duration_s"] == duration_s]
            for method, look in looks.items():
                of, there = part[part["method"] == method], runs["method"] == method
                if runs.loc[there, error.column].isna().all():
                    continue  # it gives none
                ok = np.sort(_with_error(of, error)[error.column].to_numpy(np.float64))
                shares = 100.0 * np.arange(len(ok) + 1) / max(len(of), 1)
                left = np.clip(1.0 - ok / _THRESHOLD, 0.0, None).sum() / max(len(of), 1)
                axes.step(
                    [0.0, *ok, max(_THRESHOLD, *ok[-1:])], [*shares, shares[-1]], where="post",
                    ls="--" if look.is_known else "-", color=look.color, lw=1.3,
                    label=f"{method} {100.0 * left:.1f}",
                )  # fmt: skip
            axes.set(xlim=(0.0, _THRESHOLD), ylim=(0.0, 102.0))
            axes.legend(fontsize=7, loc="center right", title="AUC [%]", title_fontsize=7)
            axes.set_xlabel(error.label)
        row[0].set_ylabel("runs [%]")
    for axes, duration_s in zip(grid[0], durations_s, strict=True):
        axes.set_title(f"Recordings of {duration_s:g} s", fontsize=11)
    return figure


def _error_grid(
    title: str,
    table: pd.DataFrame,
    height_in: float,
    draw: Callable[[Axes, float, pd.DataFrame, Quantity], None],
    marks: Sequence[Named],
    bottom: float | None = None,
    **ratios: Any,
) -> Figure:
    """Lay out axes with angles below, and errors on a logarithmic axis, from `bottom` on."""
    durations_s, angles_deg = (sorted(table[name].unique()) for name in ("duration_s", "angle_deg"))
    shape = len(ERRORS), len(durations_s)
    figure, grid = panels(title, height_in, *shape, sharex=True, sharey="row", **ratios)
    for row, error in zip(grid, ERRORS.values(), strict=True):
        for axes, duration_s in zip(row, durations_s, strict=True):
            draw(axes, float(duration_s), table[table["duration_s"] == duration_s], error)
            axes.set(yscale="log", xticks=angles_deg)
            if bottom is not None:
                axes.set_ylim(bottom=bottom)
            # All are within a decade or two, but for those of t_d of all methods.
            label_log_axis(axes.yaxis, bottom is None or error is not T_D_ERROR)
        row[0].set_ylabel(error.label)
    for column, duration_s in zip(grid.T, durations_s, strict=True):
        column[0].set_title(f"Recordings of {duration_s:g} s", fontsize=11)
        column[-1].set_xlabel(ANGLE_LABEL)
    legend_outside(figure, 4, marks)
    return figure


def _columns(methods: Sequence[str], width_deg: float) -> list[tuple[str, float]]:
    """Give methods their columns beside an angle, so that they do not cover each other."""
    n = len(methods)
    return [(method, width_deg * ((k + 0.5) / n - 0.5)) for k, method in enumerate(methods)]


def flight_means(runs: pd.DataFrame, error: str) -> pd.DataFrame:
    """Mean error by angle over all runs that are "ok", its standard error, and how many runs.

    All offsets of a flight share its recording, so a flight counts once in the standard error.
    """
    ok = _with_error(runs, ERRORS[error])
    of_flight = ok.groupby(["angle_deg", "flight"])[error].mean().groupby("angle_deg")
    standard_error = of_flight.std(ddof=0) / np.sqrt(of_flight.size())
    by_angle = ok.groupby("angle_deg")[error]
    n_runs = runs.groupby("angle_deg").size().reindex(standard_error.index)
    return pd.DataFrame({
        "mean": by_angle.mean(), "standard_error": standard_error,
        "answered": by_angle.size(), "runs": n_runs,
    })  # fmt: skip


def published_means(
    published: Mapping[float, pd.DataFrame], duration_s: float, method: str, error: str
) -> pd.DataFrame | None:
    """Give the paper's means by angle, pooled over offsets; a flight counts once as well.

    None where the paper has none.
    """
    start = {q.name: q.published for q in PUBLISHED_ERRORS}.get(f"{method}_{error}")
    table = published.get(duration_s)
    if table is None or f"{start}_mean" not in table:
        return None
    by_angle = table.assign(variance=table[f"{start}_std"] ** 2).groupby("angle_deg")
    standard_error = np.sqrt(by_angle["variance"].mean() / PUBLISHED_RUNS)
    means = by_angle[f"{start}_mean"].mean()
    return pd.DataFrame({"mean": means, "standard_error": standard_error})


def pooled(cells: pd.DataFrame, columns: list[str]) -> pd.DataFrame:
    """Root mean squares of some columns by angle, over the offsets, as many runs as each has."""
    squares = cells[columns].pow(2).mul(cells["n_runs"], axis=0)
    by_angle = squares.groupby(cells["angle_deg"]).sum()
    n_runs = cells["n_runs"].groupby(cells["angle_deg"]).sum()
    result: pd.DataFrame = by_angle.div(n_runs, axis=0).pow(0.5)
    return result


def _with_error(runs: pd.DataFrame, error: Quantity) -> pd.DataFrame:
    ok = answered(runs)
    return ok[ok[error.column].notna()]


def _draw_bars(axes: Axes, means: pd.DataFrame, look: Look, shift_deg: float, **style: Any) -> None:
    """Draw means by angle, a line through them, and their standard errors."""
    x, marks = means.index.to_numpy(np.float64) + shift_deg, {"ms": 5, **look.style}
    if look.marker == "*":
        marks["ms"] = 9
    style = {"ls": "-", "lw": 1.2, "elinewidth": 1.0, "zorder": 3, **style}
    axes.errorbar(x, means["mean"], means["standard_error"], **marks, **style)
    if "runs" in means:
        mark_survivors(axes, x, means["mean"], means["answered"], means["runs"], **marks)


def _marks(looks: Mapping[str, Look], width: float, *others: Named) -> list[Named]:
    """Name looks in a legend, then other marks."""
    of_looks = [(name, {"lw": width, "ms": 5, **look.style}) for name, look in looks.items()]
    return [*of_looks, *others]


def ablation_figure(means: pd.DataFrame, grid: GridConfig) -> Figure:
    """Draw an ablation of its means, one row for each point of the grid and method."""
    look = grid.figure
    assert look is not None
    # Each axis of the grid, but for the one on which x moves, by its first parameter.
    others = [next(iter(axis[0])) for axis in grid.axes if look.x not in axis[0]]
    methods = method_order(means["method"])
    labels = {
        name: error.label for name, error in ERRORS.items() if means[f"{name}_mean"].notna().any()
    }
    if (means[FAILED] > 0).any():
        labels[FAILED] = "failed runs [%]"
    shape = len(methods), len(labels)
    figure, rows = panels("", 1.4 + 2.0 * shape[0], *shape, sharex=True, sharey="col")
    lines = _lines(means, others)
    for row, method in zip(rows, methods, strict=True):
        for axes, quantity in zip(row, labels, strict=True):
            for part, style in lines.values():
                _draw_line(axes, part[part["method"] == method], look, quantity, style)
        row[0].set_ylabel(method, weight="bold")
    for axes, (quantity, label) in zip(rows[0], labels.items(), strict=True):
        axes.set_title(label, fontsize=10)
        _set_scales(axes, means, look, quantity)
    default = look.scale * default_value(look.x)
    on_axis = default > 0.0 or not look.log
    for axes in rows.flat if on_axis else ():
        axes.axvline(default, color="0.4", lw=0.9, ls="--", zorder=1)
    figure.supxlabel(look.label, fontsize=10)
    said = f"default: {default:g}{'' if on_axis else ', not on this axis'}"
    marks = [
        *((name, {"lw": 1.2, "ms": 4.5, **style}) for name, (_, style) in lines.items()),
        (said, {"color": "0.4", "ls": "--" if on_axis else "none"}),
        STANDARD_ERROR,
        *([SURVIVORS] if FAILED in labels else []),
    ]
    above = {"loc": "outside upper center", "title": grid.title, "title_fontsize": 12}
    legend_outside(figure, 3 if len(marks) <= 6 else 4, marks, **above)
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
    """Split the means by the other parameters: rows and look of each line, by what it is of."""
    if not others:
        return {"mean": (means, {"color": value_color("", 0, 0.0), "marker": "o", "ls": "-"})}
    parts = list(means.groupby(others, sort=True))
    n_inner = means[others[1]].nunique() if len(others) == 2 else 1
    places = np.linspace(0.0, 1.0, len(parts) // n_inner)
    lines = {}
    for k, (key, part) in enumerate(parts):
        outer, inner = divmod(k, n_inner)
        kind = outer if n_inner == 1 else inner  # the first sets the marker where it is alone
        look = {
            "color": value_color(others[0], key[0], places[outer]),
            "marker": _MARKERS[kind % len(_MARKERS)],
            "ls": _DASHES[inner % len(_DASHES)],
        }
        lines[", ".join(map(_line_name, others, key))] = part, look
    return lines


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
        mean, std = (rows[f"{quantity}_{part}"].to_numpy(np.float64) for part in ("mean", "std"))
        error = std / np.sqrt(n_ok.clip(min=1))
        axes.errorbar(x, mean, error, lw=1.2, ms=4.5, elinewidth=0.9, **style)
        mark_survivors(axes, x, mean, n_ok, rows["n_runs"], ms=4.5, **style)


def _set_scales(axes: Axes, means: pd.DataFrame, look: FigureConfig, quantity: str) -> None:
    """Set both axes; those of a column share them."""
    from matplotlib.ticker import NullLocator

    values = look.scale * np.unique(means[look.x].to_numpy(np.float64))
    if look.log:
        axes.set_xscale("log")
        label_log_axis(axes.xaxis, values.max() < _SHORT * values.min())
    if len(values) <= _MAX_VALUES:
        axes.set_xticks(values)
        axes.xaxis.set_minor_locator(NullLocator())
        axes.tick_params("x", labelsize=7)
    found = means[FAILED if quantity == FAILED else f"{quantity}_mean"]
    if quantity == FAILED or found.max() < _LOG_FROM * found.min():
        axes.set_ylim(bottom=0.0)
    else:
        axes.set_yscale("log")
        label_log_axis(axes.yaxis, found.max() < _SHORT * found.min())
