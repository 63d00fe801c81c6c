"""Runs and the paper's tables in, what the refinements beyond the paper gain over it out.

The paper, its method as built here, and the two refinements of it: mean errors by angle, beside the
marks that `tangency` was built to reach. A marker is the mean over flights and offsets.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from experiments.drawing.errors import Means, flight_means, published_means
from experiments.drawing.style import WIDTH_IN, Look, error_axes, label_grid, method_looks
from experiments.paper.published import PUBLISHED_ERRORS
from experiments.paper.quantities import ERRORS
from ssac.errors import SsacError

METHODS = ("ssac", "joint", "tangency")
"""Those without the extrinsics, from the paper's on; a refinement starts from the one before."""

_PAPER = Look("#555555", "*", hollow=True)
_MARK_COLOR = "#D55E00"
_SPREAD_DEG = 2.0  # between the columns of neighbouring methods, so that bars do not cover
_STYLE: dict[str, Any] = {"lw": 1.2, "elinewidth": 1.0, "zorder": 3}


def beyond_figure(runs: pd.DataFrame, published: Mapping[float, pd.DataFrame]) -> Figure:
    """Draw mean errors against the angle, one column of axes for each duration.

    Parameters
    ----------
    runs
        As `experiments.paper.esim.runs_from_csv` reads them. A method without runs is left out.
    published
        The paper's table of each duration [s].

    Raises
    ------
    SsacError
        If no run is of one of METHODS.
    """
    there = set(runs["method"])
    methods = [method for method in METHODS if method in there]
    if not methods:
        raise SsacError(f"expected runs of {', '.join(METHODS)}, got none of these")
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
                paper = published_means(table, _published_column(error))
                ends += _draw(axes, paper, _PAPER, 0, ":")
            of_duration = runs[runs["duration_s"] == duration_s]
            for place, method in enumerate(methods, start=1):
                own = of_duration[of_duration["method"] == method]
                ends += _draw(axes, flight_means(own, error), looks[method], place, "-")
        row[0].set_ylim(0.9 * min(ends), 1.1 * max(ends))
        row[0].set_ylabel(quantity.label)
    label_grid(figure, grid, durations_s, _legend(looks))
    return figure


def _published_column(error: str) -> str:
    return next(q.published for q in PUBLISHED_ERRORS if (q.method, q.error) == ("ssac", error))


def _x(angles_deg: Any, place: int) -> Any:
    """Beside the angle: the paper first, then the methods in order."""
    return np.asarray(angles_deg, np.float64) + _SPREAD_DEG * (place - 0.5 * len(METHODS))


def _draw(axes: Axes, means: Means, look: Look, place: int, line: str) -> list[float]:
    """Draw means; return the ends of their bars, but none below half its mean."""
    axes.errorbar(
        _x(means.angles_deg, place), means.means, means.standard_errors, ls=line,
        color=look.color, marker=look.marker, ms=9 if look is _PAPER else 5, mfc=look.face,
        mec=look.color, **_STYLE,
    )  # fmt: skip
    middles, reach = np.array(means.means), np.array(means.standard_errors)
    return [*np.maximum(middles - reach, 0.5 * middles).tolist(), *(middles + reach).tolist()]


def _legend(looks: Mapping[str, Look]) -> list[Line2D]:
    handles = [Line2D([], [], color=_PAPER.color, marker="*", mfc="white", ls=":", ms=9,
                      label="the paper")]  # fmt: skip
    for method, look in looks.items():
        handles.append(Line2D([], [], color=look.color, marker=look.marker, lw=1.2, ms=5,
                              label=method))  # fmt: skip
    handles.append(Line2D([], [], color="0.3", marker="|", ls="none", ms=9, mew=1.2,
                          label="standard error of a mean"))  # fmt: skip
    handles.append(Line2D([], [], color=_MARK_COLOR, ls="--", lw=1.0, label="mark for tangency"))
    return handles
