"""Looks that figures share.

Colours are of Okabe and Ito's set, which stays apart for colour-blind people, beside those of
`ssac.pipeline.plots`. A method that is given the extrinsics has its sibling's colour and a hollow
marker. Matplotlib is imported when a figure is drawn: studies are listed without it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from numpy.typing import NDArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from ssac.network.comparison import Comparison
else:
    Axes = Figure = Comparison = Any

__all__ = [  # Axes and Figure too, for studies that only name these types
    "WIDTH_IN",
    "Axes",
    "Figure",
    "Look",
    "comparison_png",
    "legend_below",
    "method_looks",
    "panels",
    "quiet_axes",
]

WIDTH_IN = 9.0
"""Of every figure; at DPI it is as wide as a README shows."""


@dataclass(frozen=True)
class Look:
    """How a method is drawn wherever it appears."""

    color: str
    marker: str
    hollow: bool = False

    @property
    def face(self) -> str:
        """Colour inside the marker."""
        return "white" if self.hollow else self.color


_LOOKS = {
    "ssac": Look("#0072B2", "o"),
    "ssac-known": Look("#0072B2", "o", hollow=True),
    "joint": Look("#009E73", "s"),
    "joint-known": Look("#009E73", "s", hollow=True),
    "tangency": Look("#000000", "D"),
    "tangency-known": Look("#000000", "D", hollow=True),
    "albl": Look("#CC79A7", "^"),
    "zncc_e": Look("#D55E00", "v"),
    "zncc_f": Look("#E69F00", "P"),
    "event_rate": Look("#777777", "X"),
}
_OTHERS = (Look("#882255", "<"), Look("#44AA99", ">"), Look("#999933", "p"), Look("#332288", "h"))


def method_looks(methods: list[str]) -> dict[str, Look]:
    """Give each method its look; methods from outside take the spare ones in turn."""
    others = [method for method in methods if method not in _LOOKS]
    spare = {method: _OTHERS[i % len(_OTHERS)] for i, method in enumerate(others)}
    return {method: _LOOKS.get(method) or spare[method] for method in methods}


def quiet_axes(axes: Axes) -> None:
    """Leave only what is read: light horizontal lines, and no frame above and on the right."""
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(axis="y", color="0.9", lw=0.6)
    axes.set_axisbelow(True)
    axes.tick_params(labelsize=8)


def panels(
    height_in: float, rows: int = 1, columns: int = 1, **shared: Any
) -> tuple[Figure, NDArray[Any]]:
    """Make a figure and its axes (rows, columns)."""
    from matplotlib import figure

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


def comparison_png(comparison: Comparison) -> bytes:
    """Draw a path beside the truth as `ssac compare` does it."""
    from ssac.pipeline.plots import save_comparison

    with TemporaryDirectory() as folder:
        file = Path(folder) / "comparison.png"
        save_comparison(file, comparison)
        return file.read_bytes()
