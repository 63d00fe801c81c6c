"""The form of the figures of studies: quiet axes side by side, and one legend below them.

Matplotlib is imported when a figure is drawn: studies are listed without it.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from numpy.typing import NDArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
else:
    Axes = Figure = Any

__all__ = ["Axes", "Figure", "legend_below", "panels"]


def panels(
    height_in: float, rows: int = 1, columns: int = 1, **shared: Any
) -> tuple[Figure, NDArray[Any]]:
    """Make a figure and its axes (rows, columns)."""
    from matplotlib import figure

    from experiments.drawing.style import WIDTH_IN, quiet_axes

    made = figure.Figure(figsize=(WIDTH_IN, height_in), layout="constrained")
    grid = made.subplots(rows, columns, squeeze=False, **shared)
    for axes in grid.flat:
        quiet_axes(axes)
    return made, grid


def legend_below(figure: Figure, ncols: int, handles: Sequence[Any] | None = None) -> None:
    """Name what is drawn: some handles, or all of the first axes."""
    if handles is None:
        handles = figure.axes[0].get_legend_handles_labels()[0]
    labels = [str(one.get_label()) for one in handles]
    figure.legend(
        handles, labels, loc="outside lower center", ncols=ncols, fontsize=8, frameon=False
    )
