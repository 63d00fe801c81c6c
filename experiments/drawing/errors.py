"""Errors of methods against the angle: beside the paper's, of the refinements, over their bounds.

Each figure has a row of axes for each error and a column for each duration. A marker is the mean
over flights and offsets. Runs that failed have no error; a legend counts them.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator, NullLocator

from experiments.drawing.style import (
    STANDARD_ERROR,
    SURVIVORS,
    Figure,
    Look,
    legend_below,
    mark_survivors,
    method_looks,
    panels,
)
from experiments.paper.comparison import PUBLISHED_ERRORS, PUBLISHED_RUNS
from experiments.paper.esim import method_order
from experiments.paper.quantities import ANGLE_LABEL, ERRORS, T_D_ERROR, Quantity
from ssac.errors import SsacError

REFINED = ("ssac", "joint", "tangency")
"""Methods without the extrinsics, from the paper's on; each starts from the one before."""

_LEAST = 0.01  # of each error, in its own unit: what is below is drawn there
_ANGLE_STEP_DEG = 30.0  # at most

_PAPER = Look("#555555", "*")
_THRESHOLD = 1.0  # of each error, in its unit: the largest of the success curves
_MARK_COLOR = "#D55E00"
_SPREAD_DEG = 2.0  # between the columns of neighbouring methods, so that bars do not cover


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
            ok = _answered(own, error.column)
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
    styles = (
        ("the paper's mean", {"marker": "*", "ls": ":", "ms": 9}),
        STANDARD_ERROR,
        ("a single run", {"marker": ".", "ls": "none", "ms": 5, "mew": 0.0}),
        *([SURVIVORS] if (runs["status"] != "ok").any() else []),
    )
    handles = _handles(labelled, 0.8, *styles)
    ratios = {"height_ratios": (1.7, 1.0, 1.0)}
    title = "Mean errors of all methods, beside the paper's"
    return _error_grid(title, runs, 10.0, draw, handles, 0.85 * _LEAST, **ratios)


def beyond_figure(runs: pd.DataFrame, published: Mapping[float, pd.DataFrame]) -> Figure:
    """Draw what REFINED gain over the paper, beside the marks that `tangency` is to reach.

    A method without runs is left out; SsacError if no run is of one of REFINED.
    """
    there = set(runs["method"])
    methods = [method for method in REFINED if method in there]
    if not methods:
        raise SsacError(f"expected runs of {', '.join(REFINED)}, got none of these")
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

    first = Line2D([], [], color=_PAPER.color, marker="*", ls=":", ms=9, label="the paper")
    styles = (
        STANDARD_ERROR,
        ("mark for tangency", {"color": _MARK_COLOR, "ls": "--", "lw": 1.0}),
        *([SURVIVORS] if (runs.loc[runs["method"].isin(methods), "status"] != "ok").any() else []),
    )
    title = "Mean errors of each refinement, beside the paper's"
    return _error_grid(title, runs, 8.4, draw, [first, *_handles(looks, 1.2, *styles)])


def efficiency_figure(cells: pd.DataFrame) -> Figure:
    """Draw `results/efficiency.csv`: how far the errors of each method are from its own bound.

    For each angle and method a line goes from the bound, a stroke, up to the root mean square
    error, a marker: its length on the logarithmic axis is what is lost. The offsets of an angle are
    pooled.
    """
    looks = method_looks(method_order(cells["method"]))

    def draw(axes: Axes, _: float, part: pd.DataFrame, error: Quantity) -> None:
        columns = [f"{error.parameter}_{kind}_{error.unit}" for kind in ("bound", "rms")]
        drawn = [
            m for m in looks if cells.loc[cells["method"] == m, columns].notna().all(axis=None)
        ]
        for method, shift_deg in _columns(drawn, 0.7 * _ANGLE_STEP_DEG):
            look, values = looks[method], pooled(part[part["method"] == method], columns)
            x = values.index.to_numpy(np.float64) + shift_deg
            bounds, errors = (values[column].to_numpy(np.float64) for column in columns)
            axes.vlines(x, bounds, errors, color=look.color, lw=1.2, alpha=0.6, zorder=2)
            axes.plot(x, bounds, ls="none", marker="_", ms=8, mew=1.8, color=look.color, zorder=3)
            axes.plot(x, errors, ls="none", ms=5, zorder=4, **look.style)

    styles = (
        ("root mean square error", {"marker": "o", "ms": 5, "lw": 0}),
        ("its Cramer-Rao bound", {"marker": "_", "ms": 8, "mew": 1.8, "lw": 0}),
    )
    title = "Errors, and the least that the flights' noise allows"
    return _error_grid(title, cells, 8.4, draw, _handles(looks, 0, *styles))


def success_figure(runs: pd.DataFrame, _: Any = None) -> Figure:
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
                ok = np.sort(_answered(of, error.column)[error.column].to_numpy(np.float64))
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
    handles: Sequence[Line2D],
    bottom: float | None = None,
    **ratios: Any,
) -> Figure:
    """Lay out axes with angles below, and errors on a logarithmic axis.

    They are within a decade or two, but for those of t_d of all methods, from `bottom` on.
    """
    durations_s, angles_deg = (sorted(table[name].unique()) for name in ("duration_s", "angle_deg"))
    shape = len(ERRORS), len(durations_s)
    figure, grid = panels(title, height_in, *shape, sharex=True, sharey="row", **ratios)
    for row, error in zip(grid, ERRORS.values(), strict=True):
        for axes, duration_s in zip(row, durations_s, strict=True):
            draw(axes, float(duration_s), table[table["duration_s"] == duration_s], error)
            axes.set(yscale="log", xticks=angles_deg)
            if bottom is not None:
                axes.set_ylim(bottom=bottom)
            axes.yaxis.set_major_formatter("{x:g}")
            axes.yaxis.set_minor_formatter("")
            if bottom is None or error is not T_D_ERROR:
                axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
                axes.yaxis.set_minor_locator(NullLocator())
        row[0].set_ylabel(error.label)
    for column, duration_s in zip(grid.T, durations_s, strict=True):
        column[0].set_title(f"Recordings of {duration_s:g} s", fontsize=11)
        column[-1].set_xlabel(ANGLE_LABEL)
    legend_below(figure, 4, handles)
    return figure


def _columns(methods: Sequence[str], width_deg: float) -> list[tuple[str, float]]:
    """Give methods their columns beside an angle, so that they do not cover each other."""
    n = len(methods)
    return [(method, width_deg * ((k + 0.5) / n - 0.5)) for k, method in enumerate(methods)]


def flight_means(runs: pd.DataFrame, error: str) -> pd.DataFrame:
    """Mean error by angle over all runs that are "ok", its standard error, and how many runs.

    All offsets of a flight share its recording, so a flight counts once in the standard error.
    """
    ok = _answered(runs, error)
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
    columns = [q.published for q in PUBLISHED_ERRORS if (q.method, q.error) == (method, error)]
    table = published.get(duration_s)
    if table is None or not columns or f"{columns[0]}_mean" not in table:
        return None
    by_angle = table.assign(variance=table[f"{columns[0]}_std"] ** 2).groupby("angle_deg")
    standard_error = np.sqrt(by_angle["variance"].mean() / PUBLISHED_RUNS)
    means = by_angle[f"{columns[0]}_mean"].mean()
    return pd.DataFrame({"mean": means, "standard_error": standard_error})


def pooled(cells: pd.DataFrame, columns: list[str]) -> pd.DataFrame:
    """Root mean squares of some columns by angle, over the offsets, as many runs as each has."""
    squares = cells[columns].pow(2).mul(cells["n_runs"], axis=0)
    by_angle = squares.groupby(cells["angle_deg"]).sum()
    n_runs = cells["n_runs"].groupby(cells["angle_deg"]).sum()
    result: pd.DataFrame = by_angle.div(n_runs, axis=0).pow(0.5)
    return result


def _answered(runs: pd.DataFrame, error: str) -> pd.DataFrame:
    return runs[(runs["status"] == "ok") & runs[error].notna()]


def _draw_bars(axes: Axes, means: pd.DataFrame, look: Look, shift_deg: float, **style: Any) -> None:
    """Draw means by angle, a line through them, and their standard errors."""
    x, marks = means.index.to_numpy(np.float64) + shift_deg, {"ms": 5, **look.style}
    if look.marker == "*":
        marks["ms"] = 9
    style = {"ls": "-", "lw": 1.2, "elinewidth": 1.0, "zorder": 3, **style}
    axes.errorbar(x, means["mean"], means["standard_error"], **marks, **style)
    if "runs" in means:
        mark_survivors(axes, x, means["mean"], means["answered"], means["runs"], **marks)


def _handles(
    looks: Mapping[str, Look], width: float, *others: tuple[str, Mapping[str, Any]]
) -> list[Line2D]:
    """Name looks in a legend, then other marks."""
    named = [
        Line2D([], [], lw=width, ms=5, label=name, **look.style) for name, look in looks.items()
    ]
    return named + [Line2D([], [], label=text, **{"color": "0.3", **st}) for text, st in others]
