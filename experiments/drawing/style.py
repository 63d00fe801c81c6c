"""Colours, markers and layout that figures share.

A colour stands for one thing. Methods have those of Okabe and Ito's set, which colour-blind people
can tell apart; those of polarities are in `ssac.pipeline.plots`; all else is grey, or has one of
the colours below. A method that is given the extrinsics has the colour of the one that is not, and
a half-filled marker; a hollow marker is a mean that leaves refused runs out. Matplotlib is imported
only when a figure is drawn: studies are listed without it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import cycle
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes as Axes  # for studies that only name these types
    from matplotlib.figure import Figure as Figure
else:
    Axes = Figure = Any

WIDTH_IN = 8.0  # of every figure; at DPI it is twice as wide as a README shows

ACCENT = "#6F4C9B"
"""Colour of a line or marker that is of no method; what it is compared with is grey."""

FILLS = ("#77AADD", "#EE8866", "#EEDD88", "#DDDDDD")
"""Colours of bars that are of no method: P. Tol's light set."""

_DURATIONS = {10.0: "#AA3377", 20.0: "#CCBB44"}
_ANGLES_DEG = 30.0, 150.0  # of the tables: the darkest and the lightest

Named = tuple[str, dict[str, Any]]  # text and look of an entry of a legend

PAPER: dict[str, Any] = {"marker": "*", "ls": ":", "ms": 9}
"""Look of the paper's mean, in the colour of its method."""

STANDARD_ERROR: Named = (
    "bar: standard error of the mean",
    {"marker": "|", "ls": "none", "ms": 9, "mew": 1},
)
SURVIVORS: Named = (
    "hollow: mean of so many runs, others refused",
    {"marker": "o", "ls": "none", "ms": 5, "mfc": "white"},
)


@dataclass(frozen=True)
class Look:
    """How a method is drawn wherever it appears."""

    color: str
    marker: str
    is_known: bool = False  # the extrinsics are given

    @property
    def style(self) -> dict[str, Any]:
        """Colour and marker, as Matplotlib takes them."""
        fill = {"fillstyle": "left" if self.is_known else "full", "markerfacecoloralt": "white"}
        return {"color": self.color, "marker": self.marker, **fill}


_LOOKS = {
    "ssac": Look("#0072B2", "o"),
    "ssac-known": Look("#0072B2", "o", is_known=True),
    "joint": Look("#009E73", "s"),
    "joint-known": Look("#009E73", "s", is_known=True),
    "tangency": Look("#000000", "D"),
    "tangency-known": Look("#000000", "D", is_known=True),
    "albl": Look("#CC79A7", "^"),
    "zncc_e": Look("#D55E00", "v"),
    "zncc_f": Look("#E69F00", "P"),
    "event_rate": Look("#777777", "X"),
}
_OTHERS = (Look("#882255", "<"), Look("#44AA99", ">"), Look("#999933", "p"), Look("#332288", "h"))


def method_looks(methods: list[str]) -> dict[str, Look]:
    """Give each method its look; methods from outside take the spare ones in turn."""
    spare = cycle(_OTHERS)
    return {method: _LOOKS.get(method) or next(spare) for method in methods}


def value_color(name: str, value: Any, place: float) -> Any:
    """Return the colour of a parameter's value; angles and durations have fixed ones.

    The colour of any other value depends on its place, from 0 to 1, among those that are shown.
    """
    from matplotlib import colormaps

    if name == "sim.spline.duration_s" and value in _DURATIONS:
        return _DURATIONS[value]
    if name == "sim.angle_deg":  # the lightest of a map would be too light on white
        return colormaps["viridis"](np.interp(value, _ANGLES_DEG, (0.0, 0.82)))
    return colormaps["YlOrBr"](1.0 - 0.6 * place)


def mark_survivors(
    axes: Axes,
    x: ArrayLike,
    means: ArrayLike,
    answered: ArrayLike,
    runs: ArrayLike,
    side: int = 1,
    **look: Any,
) -> None:
    """Draw means that leave runs out hollow, with their number of runs left (-1) or right (1)."""
    from matplotlib.patheffects import withStroke

    for place, mean, n, of in np.broadcast(x, means, answered, runs):
        if n < of and np.isfinite(mean):
            axes.plot(place, mean, **{**look, "mfc": "white", "ls": "none", "zorder": 5})
            at: dict[str, Any] = {"xytext": (2.0 * side, 4.0), "textcoords": "offset points"}
            at |= {"ha": "left" if side > 0 else "right", "zorder": 9}
            halo = withStroke(linewidth=2.0, foreground="white")  # sets it off from what lies below
            axes.annotate(f"{n:.0f}", (place, mean), fontsize=7, path_effects=[halo], **at)


def label_log_axis(axis: Any, least: int = 3) -> None:
    """Label a logarithmic axis with plain numbers, if possible at least `least` in view."""
    from matplotlib.ticker import LogLocator, NullLocator

    low, high = axis.get_view_interval()
    for subs in ((1.0,), (1.0, 2.0, 5.0), (1.0, 1.5, 2.0, 3.0, 5.0, 7.0)):
        locator = LogLocator(subs=subs)
        ticks = locator.tick_values(low, high)
        if np.count_nonzero((low <= ticks) & (ticks <= high)) >= least:
            break
    axis.set_major_locator(locator)
    axis.set_major_formatter("{x:g}")
    axis.set_minor_formatter("")
    if len(subs) > 1:
        axis.set_minor_locator(NullLocator())


def quiet_axes(axes: Axes) -> None:
    """Draw light horizontal grid lines, and no frame above and on the right."""
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(axis="y", color="0.9", lw=0.6)
    axes.set_axisbelow(True)
    axes.tick_params(labelsize=8)


def panels(
    title: str, height_in: float, rows: int = 1, columns: int = 1, **shared: Any
) -> tuple[Figure, NDArray[Any]]:
    """Make a figure with a title, and its axes (rows, columns)."""
    from matplotlib import figure

    made = figure.Figure(figsize=(WIDTH_IN, height_in), layout="constrained")
    made.suptitle(title, fontsize=12)
    grid = made.subplots(rows, columns, squeeze=False, **shared)
    for axes in grid.flat:
        quiet_axes(axes)
    return made, grid


def legend_outside(figure: Figure, ncols: int, marks: Sequence[Named] = (), **more: Any) -> None:
    """Put a legend below all axes, of `marks`, or else of what the first axes have."""
    from matplotlib.lines import Line2D

    looks = ((text, {"color": "0.3", **look}) for text, look in marks)
    handles: list[Any] = [Line2D([], [], label=text, **look) for text, look in looks]
    handles = handles or figure.axes[0].get_legend_handles_labels()[0]
    place = {"loc": "outside lower center", "fontsize": 8, "frameon": False, **more}
    figure.legend(handles=handles, ncols=ncols, **place)
