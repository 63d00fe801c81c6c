"""Results in, a chart of every cell of every method as HTML out.

A row for each method, a dot for each cell of the tables at its mean error on a logarithmic axis;
the dots of a row go down from 30 to 150 deg, so that a method that suffers from the angle slants.
A stroke marks the paper's mean. HTML, not a picture: its text stays legible on any screen.
"""

from dataclasses import dataclass
from html import escape

import numpy as np
import pandas as pd

from experiments.figures.style import Look, method_looks
from experiments.paper.grids import table_axes
from experiments.paper.quantities import ERRORS, split_quantity
from experiments.report.data import Results
from experiments.report.tables import number
from ssac.pipeline.registry import METHODS


@dataclass(frozen=True)
class _Axis:
    """A logarithmic axis from one power of ten to another."""

    low: int
    high: int

    def percent(self, value: float) -> float:
        """Place of a value along the axis, 0 to 100."""
        share = (np.log10(max(value, 10.0**self.low)) - self.low) / (self.high - self.low)
        return float(100.0 * np.clip(share, 0.0, 1.0))

    @property
    def ticks(self) -> list[float]:
        """The powers of ten, and 2 and 5 times these where there are few."""
        steps = (1, 2, 5) if self.high - self.low <= 2 else (1,)
        below = [step * 10.0**power for power in range(self.low, self.high) for step in steps]
        return [*below, 10.0**self.high]


def chart_html(results: Results) -> str:
    """Draw one panel for each kind of error that any method gives."""
    parts = []
    for error, quantity in ERRORS.items():
        methods = results.methods_with(error)
        cells = {method: _cells(results, method, error) for method in methods}
        values = [mean for means in cells.values() for mean in means["mean"]]
        axis = _axis(values)
        if axis is None:
            continue
        looks = method_looks(results.methods)
        ticks = "".join(
            f'<span style="left:{axis.percent(tick):.2f}%">{tick:g}</span>' for tick in axis.ticks
        )
        rows = [
            _row(results, method, error, cells[method], axis, looks[method]) for method in methods
        ]
        parts.append(
            f'<figure class="chart"><figcaption>Mean error: {quantity.title}</figcaption>'
            f'{"".join(rows)}<div class="lane axis">{ticks}</div></figure>'
        )
    return "".join(parts)


def _cells(results: Results, method: str, error: str) -> pd.DataFrame:
    """Duration, angle, offset and mean of each cell in which the method gave an estimate."""
    parts = [
        table.assign(mean=table[f"{method}_{error}_mean"], duration_s=duration_s)
        for duration_s, table in results.tables.items()
        if f"{method}_{error}_mean" in table
    ]
    cells: pd.DataFrame = pd.concat(parts)[["duration_s", "angle_deg", "t_d_ms", "mean"]].dropna()
    return cells


def _axis(values: list[float]) -> _Axis | None:
    """Cover all values with whole decades; None when there are none."""
    logs = np.log10([value for value in values if value > 0.0])
    if len(logs) == 0:
        return None
    low, high = int(np.floor(logs.min())), int(np.ceil(logs.max()))
    return _Axis(low, max(high, low + 1))


def _row(
    results: Results, method: str, error: str, cells: pd.DataFrame, axis: _Axis, look: Look
) -> str:
    """One method: name, dots, and the mean of its cells."""
    angles = sorted(cells["angle_deg"].unique())
    hollow = " hollow" if look.hollow else ""
    dots = []
    for cell in cells.to_dict("records"):
        short = " short" if cell["duration_s"] == min(table_axes().durations_s) else ""
        title = (
            f"{cell['angle_deg']:g}&deg;, t_d {cell['t_d_ms']:g} ms, {cell['duration_s']:g} s: "
            f"{number(cell['mean'])}"
        )
        place = _place(axis, cell["mean"], angles, cell["angle_deg"])
        dots.append(f'<i class="dot{hollow}{short}" {place} title="{title}"></i>')
    strokes = [
        f'<i class="paper" {_place(axis, mean, angles, angle)}></i>'
        for angle, mean in _published(results, method, error)
    ]
    ticks = "".join(f'<u style="left:{axis.percent(tick):.2f}%"></u>' for tick in axis.ticks)
    summary = METHODS[method].summary if method in METHODS else ""
    color = "currentColor" if look.color == "#000000" else look.color
    mean = number(float(cells["mean"].mean()))
    return (
        f'<div class="row" style="--look:{color}"><div class="name"><code>{escape(method)}</code>'
        f'<small>{escape(summary)}</small></div><div class="lane">{ticks}{"".join(strokes)}'
        f'{"".join(dots)}</div><div class="mean" title="mean of all cells">{mean}</div></div>'
    )


def _published(results: Results, method: str, error: str) -> list[tuple[float, float]]:
    """Angle and mean of each cell that the paper has of this method."""
    of_method = [
        split_quantity(str(quantity)) == (method, error)
        for quantity in results.comparison["quantity"]
    ]
    rows = results.comparison[of_method]
    return list(zip(rows["angle_deg"], rows["published_mean"], strict=True))


def _place(axis: _Axis, mean: float, angles: list[float], angle: float) -> str:
    """Where a mean stands in its row: the angles from top to bottom."""
    top = 50.0
    if angle in angles and len(angles) > 1:
        top = 15.0 + 70.0 * angles.index(angle) / (len(angles) - 1)
    return f'style="left:{axis.percent(mean):.2f}%;top:{top:.0f}%"'
