"""The benchmark's growth in, time and peak memory over the number of events out."""

from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from experiments.drawing.style import WIDTH_IN, Look

_LOOKS = {"simulate": Look("#0072B2", "o"), "synchronise": Look("#000000", "D")}
_WHAT = {"wall_s": "time [s]", "peak_mb": "peak memory [MB]"}
_GUIDE: dict[str, Any] = {"color": "0.7", "lw": 1.0, "ls": ":", "zorder": 1}


def growth_figure(table: pd.DataFrame) -> Figure:
    """Draw `results/bench_growth.csv` on logarithmic axes: the smaller sensor's points are hollow.

    Parameters
    ----------
    table
        As of `experiments.bench.growth.measure_growth`. What could not be measured is left out.
    """
    figure = Figure(figsize=(WIDTH_IN, 4.2), layout="constrained")
    measured = table[table["wall_s"].notna()]
    sensors = list(dict.fromkeys(measured["sensor"]))
    for axes, (column, label) in zip(figure.subplots(1, 2), _WHAT.items(), strict=True):
        axes.set(xscale="log", yscale="log", xlabel="events of a camera", ylabel=label)
        axes.grid(color="0.92", lw=0.6)
        axes.spines[["top", "right"]].set_visible(False)
        axes.tick_params(labelsize=8)
        for step, look in _LOOKS.items():
            for sensor in sensors:
                here = (measured["step"] == step) & (measured["sensor"] == sensor)
                is_largest = sensor == sensors[-1]
                axes.plot(
                    measured.loc[here, "events_per_camera"],
                    measured.loc[here, column],
                    color=look.color,
                    marker=look.marker,
                    mfc=look.color if is_largest else "white",
                    ms=5,
                    lw=1.2,
                    zorder=3,
                )
        if len(measured):
            _draw_guide(axes, measured, column)
    handles = [
        Line2D([], [], color=look.color, marker=look.marker, ms=5, lw=1.2, label=step)
        for step, look in _LOOKS.items()
    ]
    handles += [
        Line2D([], [], color="0.3", marker="o", ms=5, lw=0, label=sensor,
               mfc="0.3" if sensor == sensors[-1] else "white")
        for sensor in sensors
    ]  # fmt: skip
    handles.append(Line2D([], [], label="linear in the events", **_GUIDE))
    figure.legend(handles=handles, loc="outside lower center", ncols=5, fontsize=8, frameon=False)
    return figure


def _draw_guide(axes: Axes, measured: pd.DataFrame, column: str) -> None:
    """Draw a line of slope one through the largest value."""
    top = measured.loc[measured[column].idxmax()]
    events = np.array([measured["events_per_camera"].min(), top["events_per_camera"]])
    bottom, highest = axes.get_ylim()
    axes.plot(events, float(top[column]) * events / events[1], **_GUIDE)
    axes.set_ylim(bottom, highest)
