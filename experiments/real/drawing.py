"""Tables of the real pairs in; what shutters and frame rates do to their offsets, drawn, out."""

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from experiments.drawing.style import WIDTH_IN, quiet_axes
from ssac.fit.covariance import NORMAL_95

OFFSETS_FIGURE = "real_offsets.png"

_COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#000000", "#777777")


def real_figure(pairs: pd.DataFrame, strays: pd.DataFrame) -> Figure:
    """Draw how far readouts move the offsets, and how far the clocks of frames wander.

    Parameters
    ----------
    pairs, strays
        As `experiments.real.pairs.pair_tables` gives them.
    """
    figure = Figure(figsize=(WIDTH_IN, 3.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    _draw_readouts(left, pairs[pairs["by_readouts_ms"].notna()])
    _draw_strays(right, strays)
    return figure


def _draw_readouts(axes: Axes, pairs: pd.DataFrame) -> None:
    quiet_axes(axes)
    places = np.arange(len(pairs))
    moved_ms = pairs["by_readouts_ms"].to_numpy()
    for shift, offset_ms, column, label in (
        (-0.15, 0.0 * moved_ms, "global_std_ms", "shutters taken for global ones"),
        (0.15, moved_ms, "t_d_std_ms", "readouts estimated"),
    ):
        error_ms = NORMAL_95 * pairs[column].to_numpy()
        color = _COLORS[int(shift < 0.0)]
        axes.errorbar(
            places + shift, offset_ms, error_ms, fmt="o", ms=3, lw=1.0, color=color, label=label
        )
    names = [f"{one.data_set}: {one.camera_1}-{one.camera_2}" for one in pairs.itertuples()]
    axes.set_xticks(places, names, rotation=90, fontsize=6)
    axes.set_ylabel("offset, moved by readouts [ms]")
    axes.legend(fontsize=7, frameon=False)


def _draw_strays(axes: Axes, strays: pd.DataFrame) -> None:
    quiet_axes(axes)
    for k, (name, knots) in enumerate(strays.groupby(["data_set", "camera_1", "camera_2"])):
        number, one, other = name
        color, style = _COLORS[k % len(_COLORS)], ("-", "--")[k // len(_COLORS) % 2]
        axes.plot(
            knots["t_s"], knots["stray_ms"], color=color, ls=style, lw=1.0,
            label=f"{number}: {one}-{other}",
        )  # fmt: skip
    axes.set(
        xlabel="time of the first camera's clock [s]", ylabel="stray from an affine clock [ms]"
    )
    if len(strays):
        axes.legend(fontsize=6, frameon=False, ncols=2)
