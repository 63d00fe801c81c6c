"""Figures of the methods' errors against the angle, or against what an ablation varies.

A figure of the tables has a row of axes for each error and a column for each duration; a marker is
the mean over flights and offsets. One of an ablation has a row for each method and a column for
each error, with one line for each angle or other value that the grid varies. Refused runs have no
error: where there are any, the mean of the others is a hollow marker.
"""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import cycle, pairwise
from operator import attrgetter
from typing import Any

import numpy as np
import pandas as pd

from experiments.drawing.style import (
    PAPER,
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
"""The paper's method and its refinements, without extrinsics; each starts from the one before."""

REFUSED = "refused runs [%]"

_LEAST = 0.01  # of each error, in its own unit: smaller ones are drawn there
_ANGLE_STEP_DEG = 30.0  # at most
_THRESHOLD = 1.0  # of each error, in its unit: the largest of the success curves
_SPREAD_DEG = 2.0  # between the columns of neighbouring methods, so that bars do not cover

# Label of an ablation's line, by the parameter that varies from line to line.
_NAMES = {
    "sim.angle_deg": "{:g} deg",
    "sim.spline.duration_s": "{:g} s",
    "ssac.rules.tangency.joins_body": "body joined: {}",
}
_MARKERS = "osD^vPX"
_STEP = 0.03  # of the axis, between neighbouring lines of an ablation: none covers another
_LOG_FROM = 8.0  # largest over least mean from which an error's axis is logarithmic
_MAX_VALUES = 6  # up to so many values of the parameter are ticks of the axis


def error_figure(
    runs: pd.DataFrame, published: Mapping[float, pd.DataFrame], what: str = "Simulation"
) -> Figure:
    """Draw all methods' errors, runs and means, beside the paper's tables by duration [s]."""
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
        refused = int((own["status"] != "ok").sum())
        labelled[f"{method} ({refused} of {len(own)} refused)" if refused else method] = look
    marks = _marks(
        labelled,
        0.8,
        ("the paper's mean", PAPER),
        STANDARD_ERROR,
        (
            f"a single run; at {_LEAST:g} if below",
            {"marker": ".", "ls": "none", "ms": 5, "mew": 0.0},
        ),
        *_survivors(runs),
    )
    ratios = {"height_ratios": (1.7, 1.0, 1.0)}
    title = f"{what}: mean errors of all methods, beside the paper's"
    return _error_grid(title, runs, 10.0, draw, marks, 0.85 * _LEAST, **ratios)


def beyond_figure(runs: pd.DataFrame, published: Mapping[float, pd.DataFrame]) -> Figure:
    """Draw what REFINED gain over the paper, beside the marks that `tangency` is to reach."""
    methods = [method for method in REFINED if method in set(runs["method"])]
    looks = method_looks([*REFINED])
    ends: dict[str, list[float]] = {error: [] for error in ERRORS}

    def draw(axes: Axes, duration_s: float, part: pd.DataFrame, error: Quantity) -> None:
        """Draw means, the paper's first and the methods' beside it, in order."""
        axes.axhline(error.mark, color=looks["tangency"].color, lw=1.0, ls="--", zorder=1)
        paper = published_means(published, duration_s, "ssac", error.column)
        if paper is not None:
            look = replace(looks["ssac"], marker="*")
            _draw_bars(axes, paper, look, -0.5 * _SPREAD_DEG * len(REFINED), ls=":")
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

    first = ("the paper's ssac", {"color": looks["ssac"].color, **PAPER})
    mark = ("mark for tangency", {"color": looks["tangency"].color, "ls": "--", "lw": 1.0})
    others = STANDARD_ERROR, mark, *_survivors(runs[runs["method"].isin(methods)])
    title = "Mean errors of each refinement, beside the paper's"
    ours = {method: looks[method] for method in methods}
    return _error_grid(title, runs, 8.4, draw, [first, *_marks(ours, 1.2, *others)])


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

    said = f"root mean square error of up to {cells['n_runs'].max()} flights"
    rms = (said, {"marker": "o", "ms": 5, "lw": 0})
    bound = ("its Cramer-Rao bound", {"marker": "_", "ms": 8, "mew": 1.8, "lw": 0})
    title = "Errors, and the least that the flights' noise allows"
    return _error_grid(title, cells, 8.4, draw, _marks(looks, 0, rms, bound))


def success_figure(runs: pd.DataFrame) -> Figure:
    """Draw the share of all runs, the refused among them, whose error is below a threshold."""
    looks = method_looks(method_order(runs["method"]))
    durations_s = sorted(runs["duration_s"].unique())
    most = f"{_THRESHOLD:g} ms or deg"
    title = f"Runs whose error is below a threshold; area under each curve (AUC) up to {most}"
    shape = len(ERRORS), len(durations_s)
    figure, grid = panels(title, 9.0, *shape, sharex="row", sharey=True)
    widths = dict(zip(looks, np.linspace(2.4, 0.8, len(looks)), strict=True))  # the last on top
    for row, error in zip(grid, ERRORS.values(), strict=True):
        for axes, duration_s in zip(row, durations_s, strict=True):
            part = runs[runs["duration_s"] == duration_s]
            for method, look in looks.items():
                of, there = part[part["method"] == method], runs["method"] == method
                if runs.loc[there, error.column].isna().all():
                    continue  # the method does not give this quantity
                errors = np.sort(_with_error(of, error)[error.column].to_numpy(np.float64))
                below = errors[errors < _THRESHOLD]
                shares = 100.0 * np.arange(len(below) + 1) / max(len(of), 1)
                left = (1.0 - below / _THRESHOLD).sum() / max(len(of), 1)
                axes.step(
                    [0.0, *below, _THRESHOLD], [*shares, shares[-1]], where="post",
                    ls="--" if look.is_known else "-", color=look.color, lw=widths[method],
                    label=f"{method} {100.0 * left:.1f}",
                )  # fmt: skip
            axes.set(xlim=(0.0, _THRESHOLD), ylim=(0.0, 102.0))
            axes.legend(fontsize=7, loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False,
                        title="AUC [%]", title_fontsize=7)  # fmt: skip
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
    """Draw errors over angles, a row for each error; the logarithmic axes begin at `bottom`."""
    durations_s, angles_deg = (sorted(table[name].unique()) for name in ("duration_s", "angle_deg"))
    shape = len(ERRORS), len(durations_s)
    figure, grid = panels(title, height_in, *shape, sharex=True, sharey="row", **ratios)
    for row, error in zip(grid, ERRORS.values(), strict=True):
        for axes, duration_s in zip(row, durations_s, strict=True):
            draw(axes, float(duration_s), table[table["duration_s"] == duration_s], error)
            axes.set(yscale="log", xticks=angles_deg)
            if bottom is not None:
                axes.set_ylim(bottom=bottom)
        label_log_axis(row[0].yaxis)
        row[0].set_ylabel(error.label)
    for column, duration_s in zip(grid.T, durations_s, strict=True):
        column[0].set_title(f"Recordings of {duration_s:g} s", fontsize=11)
        column[-1].set_xlabel(ANGLE_LABEL)
    legend_outside(figure, 4, marks)
    return figure


def _columns(methods: Sequence[str], width_deg: float) -> list[tuple[str, float]]:
    """Return each method's shift [deg] beside an angle, so that none covers another."""
    n = len(methods)
    return [(method, width_deg * ((k + 0.5) / n - 0.5)) for k, method in enumerate(methods)]


def flight_means(runs: pd.DataFrame, error: str, by: str = "angle_deg") -> pd.DataFrame:
    """Return mean and standard error of an error, and counts of runs, by angle or another column.

    Means are over the runs that are "ok". All offsets of a flight share its recording, so a flight,
    told by its seed, counts once in the standard error, which is NaN of a single flight.
    """
    ok = _with_error(runs, ERRORS[error])
    by_place = ok.groupby(by)[error]
    return pd.DataFrame({
        "mean": by_place.mean(),
        "standard_error": ok.groupby([by, "seed"])[error].mean().groupby(by).sem(),
        "answered": by_place.size(), "runs": runs.groupby(by).size(),
    })  # fmt: skip


def published_means(
    published: Mapping[float, pd.DataFrame], duration_s: float, method: str, error: str
) -> pd.DataFrame | None:
    """Return the paper's means by angle, pooled over offsets; None where the paper has none."""
    start = {q.name: q.published for q in PUBLISHED_ERRORS}.get(f"{method}_{error}")
    table = published.get(duration_s)
    if table is None or f"{start}_mean" not in table:
        return None
    by_angle = table.assign(variance=table[f"{start}_std"] ** 2).groupby("angle_deg")
    # A flight counts once, as in `flight_means`. The published deviations are over n, not n - 1.
    standard_error = np.sqrt(by_angle["variance"].mean() / (PUBLISHED_RUNS - 1))
    means = by_angle[f"{start}_mean"].mean()
    return pd.DataFrame({"mean": means, "standard_error": standard_error})


def pooled(cells: pd.DataFrame, columns: list[str]) -> pd.DataFrame:
    """Return root mean squares of columns by angle, over the offsets, each weighted by its runs."""
    squares = cells[columns].pow(2).mul(cells["n_runs"], axis=0)
    by_angle = squares.groupby(cells["angle_deg"]).sum()
    n_runs = cells["n_runs"].groupby(cells["angle_deg"]).sum()
    return by_angle.div(n_runs, axis=0).pow(0.5)


def _with_error(runs: pd.DataFrame, error: Quantity) -> pd.DataFrame:
    ok = answered(runs)
    return ok[ok[error.column].notna()]


def _draw_bars(
    axes: Axes, means: pd.DataFrame, look: Look, shift_deg: float, side: int = 1, **style: Any
) -> None:
    """Draw a line of means over the table's index, with bars of their standard errors."""
    x, marks = means.index.to_numpy(np.float64) + shift_deg, {"ms": 5, **look.style}
    if look.marker == "*":
        marks["ms"] = PAPER["ms"]
    style = {"ls": "-", "lw": 1.2, "elinewidth": 1.0, "zorder": 3, **style}
    axes.errorbar(x, means["mean"], means["standard_error"], **marks, **style)
    if "runs" in means:
        mark_survivors(axes, x, means["mean"], means["answered"], means["runs"], side, **marks)


def _marks(looks: Mapping[str, Look], width: float, *others: Named) -> list[Named]:
    """Return the entries of a legend: looks by name, then other marks."""
    of_looks = [(name, {"lw": width, "ms": 5, **look.style}) for name, look in looks.items()]
    return [*of_looks, *others]


def ablation_figure(runs: pd.DataFrame, grid: GridConfig) -> Figure:
    """Draw the runs of an ablation: a row for each method, a line for each value of what varies.

    The offsets of a flight are pooled. Where two parameters vary beside the one on the x axis, each
    value of the second has a row, each method has a line, and the first is pooled.
    """
    look = grid.figure
    assert look is not None
    # The first parameter of each axis of the grid, except the axis that has x.
    others = [next(iter(axis[0])) for axis in grid.axes if look.x not in axis[0]]
    others = [name for name in others if name != "sim.t_d_s"] or ["sim.angle_deg"]
    row_of, line_of = ("method", others[0]) if len(others) == 1 else (others[-1], "method")
    runs = runs.assign(**{look.x: look.scale * runs[look.x]})
    labels = {name: error.label for name, error in ERRORS.items() if runs[name].notna().any()}
    if (runs["status"] != "ok").any():
        labels[REFUSED] = REFUSED
    lines, row_values = _lines(runs, line_of), _values(runs, row_of)
    shape = len(row_values), len(labels)
    figure, rows = panels("", 1.4 + 2.0 * shape[0], *shape, sharex=True, sharey="col")
    for row, value in zip(rows, row_values, strict=True):
        for axes, quantity in zip(row, labels, strict=True):
            for k, (name, line_look) in enumerate(lines.items()):
                of = runs[(runs[row_of] == value) & (runs[line_of] == name)]
                aside = _STEP * (k - 0.5 * (len(lines) - 1))
                _draw_line(axes, of, look, quantity, line_look, aside)
        row[0].set_ylabel(_value_name(row_of, value), weight="bold")
    for column, (quantity, label) in zip(rows.T, labels.items(), strict=True):
        column[0].set_title(label, fontsize=10)
        _set_scales(column, runs, look, quantity)
    figure.supxlabel(look.label, fontsize=10)
    at_point = runs.assign(ok=runs["status"] == "ok").groupby([row_of, line_of, look.x])
    n_flights, is_ok = int(at_point["seed"].nunique().max()), at_point["ok"].mean()
    named = {_value_name(line_of, value): of for value, of in lines.items()}
    marks = [
        *_marks(named, 1.2, *_default(rows, look)),
        *([STANDARD_ERROR] if n_flights > 1 else []),
        *([SURVIVORS] if is_ok.between(0.0, 1.0, inclusive="neither").any() else []),
    ]
    what = f"Mean errors of {n_flights} flights" if n_flights > 1 else "Errors of one flight"
    what += " at all angles" if "sim.angle_deg" in others[:-1] else ""  # pooled
    title = f"{what}: {grid.title[0].lower()}{grid.title[1:]}"
    above = {"loc": "outside upper center", "title": title, "title_fontsize": 12}
    legend_outside(figure, 3 if len(marks) <= 6 else 4, marks, **above)
    return figure


def _default(rows: Any, look: FigureConfig) -> list[Named]:
    """Draw and name the default of the x axis; angles, all of which are filmed, have none."""
    if look.x == "sim.angle_deg":
        return []
    default, units = look.scale * _default_of(look.x), re.findall(r"\[(\w+)\]", look.label)
    said = " ".join(["default:", f"{default:g}", *units[:1]])
    if look.log and default <= 0.0:
        return [(f"{said}, not on this axis", {"ls": "none"})]
    for axes in rows.flat:
        axes.axvline(default, color="0.4", lw=0.9, ls="--", zorder=1)
    return [(said, {"color": "0.4", "ls": "--"})]


def _default_of(name: str) -> float:
    """Give the default of a parameter by its dotted name, in its own unit."""
    if name == "sim.drone_size_m":  # whose default, None, leaves it to the drone
        return quadrotor().size_m
    if name == "ssac.n_min":  # whose default, None, may leave it to a thin object
        return N_MIN
    root, _, path = name.partition(".")
    sim, ssac = configs_of({})
    return float(attrgetter(path)(sim if root == "sim" else ssac))


def _values(runs: pd.DataFrame, name: str) -> list[Any]:
    return method_order(runs[name]) if name == "method" else [*runs[name].unique()]


def _lines(runs: pd.DataFrame, name: str) -> dict[Any, Look]:
    """Give each value of a parameter, or each method, the look of its line."""
    values = _values(runs, name)
    if name == "method":
        return method_looks(values)
    of = zip(values, np.linspace(0.0, 1.0, len(values)), cycle(_MARKERS), strict=False)
    return {value: Look(value_color(name, value, place), marker) for value, place, marker in of}


def _value_name(name: str, value: Any) -> str:
    if name == "sim.background_files":  # a list, as text
        return ", ".join(re.findall(r"([\w-]+)\.\w+", str(value))) or "even sky"
    return _NAMES.get(name, "{}").format(value)


def _draw_line(
    axes: Axes, runs: pd.DataFrame, of: FigureConfig, quantity: str, look: Look, aside: float
) -> None:
    """Draw means with standard errors, or bars of refused runs, shifted by a share of the axis."""
    found = flight_means(runs, T_D_ERROR.column if quantity == REFUSED else quantity, of.x)
    x = found.index.to_numpy(np.float64)
    if of.log:
        found.index = pd.Index(x * (x.max() / x.min()) ** aside)
    else:
        found.index = pd.Index(x + aside * np.ptp(x))
    if quantity == REFUSED:
        refused = 100.0 * (1.0 - found["answered"].fillna(0.0) / found["runs"])
        axes.vlines(found.index, 0.0, refused, color=look.color, lw=3.0)
    elif runs[quantity].notna().any():
        # Numbers stand away from the other methods' marks.
        _draw_bars(axes, found, look, 0.0, -1 if aside < 0.0 else 1)


def _set_scales(column: Any, runs: pd.DataFrame, look: FigureConfig, quantity: str) -> None:
    """Set the scales that the axes of a column share; error bars may end below what is shown."""
    from matplotlib.ticker import NullLocator

    axes, values = column[0], np.unique(runs[look.x].to_numpy(np.float64))
    if look.log:
        axes.set_xscale("log")
        label_log_axis(axes.xaxis, 2)  # more would touch each other
    if len(values) <= _MAX_VALUES:
        axes.set_xticks(values)
        axes.xaxis.set_minor_locator(NullLocator())
        axes.tick_params("x", labelsize=7)
    if quantity == REFUSED:
        axes.set_ylim(0.0, 105.0)
        return
    drawn = [bars.lines[0].get_ydata() for one in column for bars in one.containers]
    means = np.concatenate(drawn)
    least, most = np.nanmin(means), np.nanmax(means)
    if most < _LOG_FROM * least:
        axes.set_ylim(bottom=0.0)
    else:
        axes.set_yscale("log")
        axes.set_ylim(bottom=0.6 * least)
        label_log_axis(axes.yaxis)
