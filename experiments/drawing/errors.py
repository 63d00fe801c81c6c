"""Errors of methods against the angle, beside the paper's: of all methods, and of the refinements.

A point is one run, a marker the mean over flights and offsets. Runs that failed have no error; the
legend counts them.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator, NullLocator

from experiments.drawing.style import (
    WIDTH_IN,
    Look,
    error_axes,
    label_grid,
    method_looks,
    quiet_axes,
)
from experiments.paper.comparison import PUBLISHED_ERRORS, PUBLISHED_RUNS
from experiments.paper.esim import method_order
from experiments.paper.quantities import ERRORS, T_D_ERROR
from ssac.errors import SsacError

REFINED = ("ssac", "joint", "tangency")
"""Methods without the extrinsics, from the paper's on; each starts from the one before."""

_LEAST = 0.01  # of each error, in its own unit: what is below is drawn there
_ROW_HEIGHTS = (1.7, 1.0, 1.0)
_ANGLE_STEP_DEG = 30.0  # at most
_SHARE = 0.84  # of the least step between angles that the methods' columns take

_PAPER = Look("#555555", "*", hollow=True)
_MARK_COLOR = "#D55E00"
_SPREAD_DEG = 2.0  # between the columns of neighbouring methods, so that bars do not cover


@dataclass(frozen=True)
class Means:
    """Means of one error by angle."""

    angles_deg: tuple[float, ...]
    means: tuple[float, ...]
    standard_errors: tuple[float, ...]


def error_figure(runs: pd.DataFrame, published: Mapping[float, pd.DataFrame]) -> Figure:
    """Draw the errors of all methods against the angle, one column of axes for each duration.

    `published` has the paper's table of each duration [s].
    """
    durations_s = sorted(runs["duration_s"].unique())
    angles_deg = sorted(runs["angle_deg"].unique())
    # The methods' columns are beside the angle, so that they do not cover each other.
    step_deg = float(np.diff(angles_deg).min(initial=_ANGLE_STEP_DEG))
    methods = method_order(runs["method"])
    looks = method_looks(methods)
    figure = Figure(figsize=(WIDTH_IN, 9.6), layout="constrained")
    grid = figure.subplots(
        len(ERRORS),
        len(durations_s),
        sharex=True,
        sharey="row",
        squeeze=False,
        height_ratios=_ROW_HEIGHTS,
    )
    for row, (error, quantity) in zip(grid, ERRORS.items(), strict=True):
        drawn = [m for m in methods if runs.loc[runs["method"] == m, error].notna().any()]
        for axes, duration_s in zip(row, durations_s, strict=True):
            of_duration = runs[runs["duration_s"] == duration_s]
            table = published.get(float(duration_s))
            for slot, method in enumerate(drawn):
                shift_deg = step_deg * _SHARE * ((slot + 0.5) / len(drawn) - 0.5)
                own = of_duration[of_duration["method"] == method]
                _draw_method(axes, own, error, looks[method], shift_deg)
                column = _published_column(method, error)
                if table is not None and f"{column}_mean" in table:
                    _draw_published(axes, published_means(table, column), looks[method], shift_deg)
            _set_scales(axes, angles_deg, error)
        row[0].set_ylabel(quantity.label)
    label_grid(figure, grid, durations_s, _error_legend(runs, looks))
    return figure


def beyond_figure(runs: pd.DataFrame, published: Mapping[float, pd.DataFrame]) -> Figure:
    """Draw what REFINED gain over the paper, beside the marks that `tangency` is to reach.

    A marker is the mean over flights and offsets. A method without runs is left out; SsacError if
    no run is of one of REFINED.
    """
    there = set(runs["method"])
    methods = [method for method in REFINED if method in there]
    if not methods:
        raise SsacError(f"expected runs of {', '.join(REFINED)}, got none of these")
    looks = method_looks(methods)
    durations_s = sorted(runs["duration_s"].unique())
    figure = Figure(figsize=(WIDTH_IN, 8.0), layout="constrained")
    grid = figure.subplots(len(ERRORS), len(durations_s), sharex=True, sharey="row", squeeze=False)
    for row, (error, quantity) in zip(grid, ERRORS.items(), strict=True):
        ends = [quantity.mark]
        for axes, duration_s in zip(row, durations_s, strict=True):
            error_axes(axes, sorted(runs["angle_deg"].unique()))
            axes.axhline(quantity.mark, color=_MARK_COLOR, lw=1.0, ls="--", zorder=1)
            table = published.get(float(duration_s))
            if table is not None:
                paper = published_means(table, _published_column("ssac", error))
                ends += _draw_means(axes, paper, _PAPER, 0, ":")
            of_duration = runs[runs["duration_s"] == duration_s]
            for place, method in enumerate(methods, start=1):
                own = of_duration[of_duration["method"] == method]
                ends += _draw_means(axes, flight_means(own, error), looks[method], place, "-")
        row[0].set_ylim(0.9 * min(ends), 1.1 * max(ends))
        row[0].set_ylabel(quantity.label)
    label_grid(figure, grid, durations_s, _beyond_legend(looks))
    return figure


def flight_means(runs: pd.DataFrame, error: str) -> Means:
    """Mean error by angle over all runs that are "ok", and its standard error.

    All offsets of a flight share its recording, so a flight counts once in the standard error.
    """
    found = []
    for angle_deg, group in _by_angle(_answered(runs, error)):
        by_flight = group.groupby("flight")[error].mean()
        standard_error = by_flight.std(ddof=0) / np.sqrt(len(by_flight))
        found.append((angle_deg, float(group[error].mean()), float(standard_error)))
    return Means(*(tuple(one[k] for one in found) for k in range(3)))


def published_means(table: pd.DataFrame, column: str) -> Means:
    """Give the paper's means by angle, pooled over offsets; a flight counts once as well."""
    found = []
    for angle_deg, group in _by_angle(table):
        variance = float((group[f"{column}_std"] ** 2).mean())
        mean, standard_error = group[f"{column}_mean"].mean(), np.sqrt(variance / PUBLISHED_RUNS)
        found.append((angle_deg, float(mean), float(standard_error)))
    return Means(*(tuple(one[k] for one in found) for k in range(3)))


def _by_angle(rows: pd.DataFrame) -> list[tuple[float, pd.DataFrame]]:
    angles_deg = sorted(rows["angle_deg"].unique())
    return [(float(angle), rows[rows["angle_deg"] == angle]) for angle in angles_deg]


def _answered(runs: pd.DataFrame, error: str) -> pd.DataFrame:
    return runs[(runs["status"] == "ok") & runs[error].notna()]


def _published_column(method: str, error: str) -> str:
    """Start of the column of the paper's tables; empty where the paper has none."""
    columns = [q.published for q in PUBLISHED_ERRORS if (q.method, q.error) == (method, error)]
    return columns[0] if columns else ""


def _set_scales(axes: Axes, angles_deg: list[float], error: str) -> None:
    quiet_axes(axes)
    axes.set(yscale="log", xticks=angles_deg)
    axes.set_ylim(bottom=0.85 * _LEAST)
    axes.yaxis.set_major_formatter("{x:g}")
    axes.yaxis.set_minor_formatter("")
    if error != T_D_ERROR.column:  # two decades at most
        axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axes.yaxis.set_minor_locator(NullLocator())
    for left, right in pairwise(angles_deg):
        axes.axvline(0.5 * (left + right), color="0.9", lw=0.6, zorder=0)


def _draw_method(axes: Axes, runs: pd.DataFrame, error: str, look: Look, shift: float) -> None:
    ok = _answered(runs, error)
    if ok.empty:
        return
    axes.plot(
        ok["angle_deg"] + shift, ok[error].clip(lower=_LEAST), ls="none", marker=".",
        ms=3.0, mew=0.0, color=look.color, alpha=0.5, zorder=2,
    )  # fmt: skip
    means = flight_means(runs, error)
    axes.errorbar(
        np.add(means.angles_deg, shift), np.maximum(means.means, _LEAST),
        means.standard_errors, ls="-", lw=0.8,
        color=look.color, marker=look.marker, ms=5, mfc=look.face, mec=look.color, elinewidth=1.2,
        zorder=4,
    )  # fmt: skip


def _draw_published(axes: Axes, means: Means, look: Look, shift: float) -> None:
    axes.errorbar(
        np.add(means.angles_deg, shift), means.means, means.standard_errors, ls=":", lw=1.2,
        color=look.color, marker="*", ms=9, mfc="white", mec=look.color, elinewidth=1.0, zorder=3,
    )  # fmt: skip


def _draw_means(axes: Axes, means: Means, look: Look, place: int, line: str) -> list[float]:
    """Draw means, the paper's first and the methods' beside it, in order.

    Return the ends of their bars, but none below half its mean.
    """
    shift_deg = _SPREAD_DEG * (place - 0.5 * len(REFINED))
    axes.errorbar(
        np.asarray(means.angles_deg, np.float64) + shift_deg, means.means, means.standard_errors,
        ls=line, color=look.color, marker=look.marker, ms=9 if look is _PAPER else 5,
        mfc=look.face, mec=look.color, lw=1.2, elinewidth=1.0, zorder=3,
    )  # fmt: skip
    middles, reach = np.array(means.means), np.array(means.standard_errors)
    return [*np.maximum(middles - reach, 0.5 * middles).tolist(), *(middles + reach).tolist()]


def _error_legend(runs: pd.DataFrame, looks: Mapping[str, Look]) -> list[Line2D]:
    handles = []
    for method, look in looks.items():
        own = runs[runs["method"] == method]
        failed = int((own["status"] != "ok").sum())
        label = f"{method} ({failed} of {len(own)} failed)" if failed else method
        handles.append(Line2D([], [], color=look.color, marker=look.marker, mfc=look.face, lw=0.8,
                              ms=5, label=label))  # fmt: skip
    styles: tuple[tuple[str, dict[str, Any]], ...] = (
        ("the paper's mean", {"marker": "*", "mfc": "white", "ls": ":", "ms": 9}),
        ("standard error of a mean", {"marker": "|", "ls": "none", "ms": 9, "mew": 1.2}),
        ("a single run", {"marker": ".", "ls": "none", "ms": 5, "mew": 0.0}),
    )
    return handles + [Line2D([], [], color="0.3", label=text, **style) for text, style in styles]


def _beyond_legend(looks: Mapping[str, Look]) -> list[Line2D]:
    handles = [Line2D([], [], color=_PAPER.color, marker="*", mfc="white", ls=":", ms=9,
                      label="the paper")]  # fmt: skip
    handles += [
        Line2D([], [], color=look.color, marker=look.marker, lw=1.2, ms=5, label=method)
        for method, look in looks.items()
    ]
    handles.append(Line2D([], [], color="0.3", marker="|", ls="none", ms=9, mew=1.2,
                          label="standard error of a mean"))  # fmt: skip
    handles.append(Line2D([], [], color=_MARK_COLOR, ls="--", lw=1.0, label="mark for tangency"))
    return handles
