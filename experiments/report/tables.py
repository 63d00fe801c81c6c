"""The numbers of the report in the order in which the template `results.html` lays them out."""

from collections import Counter
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from experiments.drawing.style import method_looks
from experiments.paper.grids import table_axes
from experiments.paper.quantities import ERRORS, split_quantity
from experiments.report.data import Results
from ssac.pipeline.registry import METHODS

VERDICTS = {"better": "<", "agrees": "≈", "differs": "≠"}
"""Of a cell, and the sign that stands for it where colours are not seen."""

NONE = "\N{EN DASH}"
_SHOWN_REASONS = 12


def number(value: float) -> str:
    """Show an error as the paper does, with two decimals, fewer of large ones."""
    return f"{value:.{_decimals(value)}f}" if np.isfinite(value) else NONE


def mean_and_std(mean: float, std: float) -> tuple[str, str]:
    """Show a mean as `number` does, and its deviation to the same decimal."""
    if not (np.isfinite(mean) and np.isfinite(std)):
        return number(mean), number(std)
    return number(mean), f"{std:.{_decimals(mean)}f}"


def _decimals(value: float) -> int:
    return 3 if abs(value) < 0.1 else 2 if abs(value) < 10.0 else 1 if abs(value) < 100.0 else 0


class Row(NamedTuple):
    """The cells of one angle and offset."""

    angle_deg: float
    span: int  # rows that share the angle; 0 where it stands above
    t_d_ms: float
    cells: list[Any]


class Table(NamedTuple):
    """Cells by angle and offset, a column for each method or published quantity."""

    title: str
    heads: list[tuple[str, str]]  # method, and which of its errors
    rows: list[Row]


class Compared(NamedTuple):
    """Our mean beside the paper's."""

    verdict: str
    ours: str
    theirs: str
    title: str


def compared_tables(results: Results) -> list[Table]:
    """Lay out one table for each duration: our number over the paper's."""
    tables = []
    for duration_s, part in results.comparison.groupby("duration_s"):
        quantities = list(dict.fromkeys(part["quantity"]))
        lines: dict[tuple[float, float], dict[str, Compared]] = {}
        for cell in part.to_dict("records"):
            line = lines.setdefault((cell["angle_deg"], cell["t_d_ms"]), {})
            line[cell["quantity"]] = _compared(cell)
        split = [split_quantity(quantity) for quantity in quantities]
        heads = [(method, ERRORS[e].title if e in ERRORS else "") for method, e in split]
        cells = {key: [line.get(q) for q in quantities] for key, line in lines.items()}
        tables.append(Table(f"Flights of {duration_s:g} s", heads, _rows(cells)))
    return tables


def _compared(cell: Mapping[Any, Any]) -> Compared:
    ours, theirs = (
        " ± ".join(mean_and_std(cell[f"{side}_mean"], cell[f"{side}_std"]))
        for side in ("ours", "published")
    )
    note = str(cell.get("note") or "")
    title = f"{cell['verdict']}, {cell['n_ours']} of our runs{f': {note}' if note else ''}"
    return Compared(str(cell["verdict"]), ours, theirs, title)


def notes(comparison: pd.DataFrame) -> list[tuple[str, int, str]]:
    """List why cells do not agree, as far as that was found: why, how many, and which."""
    if "note" not in comparison:
        return []
    return [
        (str(note), len(cells), ", ".join(cells.unique()))
        for note, cells in comparison.groupby("note", sort=False)["quantity"]
        if note
    ]


class Mean(NamedTuple):
    """One method's mean in a cell."""

    mean: str
    std: str
    percent: float | None  # of its bar, on a logarithmic scale; None: there is no mean
    failed: int
    n_runs: int


def method_tables(results: Results) -> list[Table]:
    """Lay out all methods: a table for each kind of error and duration."""
    tables = []
    for error, quantity in ERRORS.items():
        methods = results.methods_with(error)
        if not methods:
            continue
        low, high = _range(results, methods, error)
        for duration_s, table in results.tables.items():
            cells = {
                (row["angle_deg"], row["t_d_ms"]): [
                    _mean(row, method, error, low, high) for method in methods
                ]
                for row in table.to_dict("records")
            }
            title = f"{quantity.title}, flights of {duration_s:g} s"
            tables.append(Table(title, [(method, "") for method in methods], _rows(cells)))
    return tables


def _mean(row: Mapping[Any, Any], method: str, error: str, low: float, high: float) -> Mean:
    mean, std = (row.get(f"{method}_{error}_{part}", np.nan) for part in ("mean", "std"))
    percent = None
    if np.isfinite(mean):
        percent = 100.0 * float(np.clip(np.log(max(mean, low) / low) / np.log(high / low), 0.02, 1))
    shown = mean_and_std(mean, std)
    return Mean(*shown, percent, int(row.get(f"{method}_failed", 0)), int(row["n_runs"]))


def _range(results: Results, methods: list[str], error: str) -> tuple[float, float]:
    """Return the ends of the bars' scale: a little below the least mean, and the largest."""
    columns = [f"{method}_{error}_mean" for method in methods]
    values = pd.concat([table.filter(columns).stack() for table in results.tables.values()])
    values = values[values > 0.0]
    if values.empty:
        return 0.1, 1.0
    low = 0.8 * float(values.min())
    return low, max(float(values.max()), 3.0 * low)


def _rows(cells: Mapping[tuple[float, float], list[Any]]) -> list[Row]:
    spans = Counter(angle_deg for angle_deg, _ in cells)
    return [
        Row(angle_deg, spans.pop(angle_deg, 0), t_d_ms, row)
        for (angle_deg, t_d_ms), row in cells.items()
    ]


class Failed(NamedTuple):
    """The runs of one method that gave no estimate for one status."""

    method: str
    status: str
    n_failed: int
    n_runs: int
    angles: str
    reasons: list[tuple[str, int]]  # the first ones, each with how often it came
    n_reasons: int


def failures(runs: pd.DataFrame) -> list[Failed]:
    """List which runs gave no estimate: of which method, where and why."""
    rows = []
    failed = runs[runs["status"] != "ok"]
    for (method, status), group in failed.groupby(["method", "status"], sort=False):
        counted = group["reason"].value_counts(sort=False)
        reasons = [(str(reason), int(count)) for reason, count in counted.items()]
        angles = ", ".join(f"{angle:g}°" for angle in sorted(group["angle_deg"].unique()))
        n_runs = int((runs["method"] == method).sum())
        shown = reasons[:_SHOWN_REASONS]
        rows.append(
            Failed(str(method), str(status), len(group), n_runs, angles, shown, len(reasons))
        )
    return rows


class Dot(NamedTuple):
    """A mean in a row of the chart: where it stands, in percent, and what it says."""

    left: float
    top: float
    is_short: bool = False  # of a short flight
    title: str = ""


class ChartRow(NamedTuple):
    """One method: a dot for each cell, a stroke for each mean of the paper."""

    method: str
    summary: str
    color: str
    hollow: bool
    dots: list[Dot]
    strokes: list[Dot]
    mean: str  # of its cells


class Chart(NamedTuple):
    """Every cell of every method at its mean error, on a logarithmic axis."""

    title: str
    ticks: list[tuple[float, float]]  # place [%] and value
    rows: list[ChartRow]


class Axis(NamedTuple):
    """A logarithmic axis from one power of ten to another."""

    low: int
    high: int

    def percent(self, value: float) -> float:
        """Place of a value along the axis, 0 to 100."""
        share = (np.log10(max(value, 10.0**self.low)) - self.low) / (self.high - self.low)
        return float(100.0 * np.clip(share, 0.0, 1.0))

    @property
    def ticks(self) -> list[tuple[float, float]]:
        """The powers of ten, and 2 and 5 times these where there are few."""
        steps = (1, 2, 5) if self.high - self.low <= 2 else (1,)
        below = [step * 10.0**power for power in range(self.low, self.high) for step in steps]
        return [(self.percent(tick), tick) for tick in (*below, 10.0**self.high)]


def charts(results: Results) -> list[Chart]:
    """Draw one chart for each kind of error that any method gives.

    The dots of a row go down from 30 to 150 deg, so that a method that suffers from the angle
    slants.
    """
    drawn = []
    for error, quantity in ERRORS.items():
        cells = {method: _cells(results, method, error) for method in results.methods_with(error)}
        values = [mean for means in cells.values() for mean in means["mean"] if mean > 0.0]
        if not values:
            continue
        logs = np.log10(values)
        low, high = int(np.floor(logs.min())), int(np.ceil(logs.max()))
        axis = Axis(low, max(high, low + 1))
        rows = [_chart_row(results, method, error, cells[method], axis) for method in cells]
        drawn.append(Chart(quantity.title, axis.ticks, rows))
    return drawn


def _cells(results: Results, method: str, error: str) -> pd.DataFrame:
    """Duration, angle, offset and mean of each cell in which the method gave an estimate."""
    parts = [
        table.assign(mean=table[f"{method}_{error}_mean"], duration_s=duration_s)
        for duration_s, table in results.tables.items()
        if f"{method}_{error}_mean" in table
    ]
    cells: pd.DataFrame = pd.concat(parts)[["duration_s", "angle_deg", "t_d_ms", "mean"]].dropna()
    return cells


def _chart_row(
    results: Results, method: str, error: str, cells: pd.DataFrame, axis: Axis
) -> ChartRow:
    angles = sorted(cells["angle_deg"].unique())
    shortest_s = min(table_axes().durations_s)

    def dot(mean: float, angle: float, is_short: bool = False, title: str = "") -> Dot:
        spread = angle in angles and len(angles) > 1
        top = 15.0 + 70.0 * angles.index(angle) / (len(angles) - 1) if spread else 50.0
        return Dot(axis.percent(mean), top, is_short, title)

    dots = []
    for cell in cells.to_dict("records"):
        where = f"{cell['angle_deg']:g}°, t_d {cell['t_d_ms']:g} ms, {cell['duration_s']:g} s"
        title = f"{where}: {number(cell['mean'])}"
        is_short = cell["duration_s"] == shortest_s
        dots.append(dot(cell["mean"], cell["angle_deg"], is_short, title))
    of_paper = results.comparison["quantity"].map(split_quantity) == (method, error)
    published = results.comparison[of_paper]
    strokes = list(map(dot, published["published_mean"], published["angle_deg"]))
    look = method_looks(results.methods)[method]
    summary = METHODS[method].summary if method in METHODS else ""
    color = "currentColor" if look.color == "#000000" else look.color
    mean = number(float(cells["mean"].mean()))
    return ChartRow(method, summary, color, look.hollow, dots, strokes, mean)
