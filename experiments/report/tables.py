"""The numbers of the report in the order in which the template `results.html` lays them out."""

from collections import Counter
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from experiments.drawing.style import method_looks
from experiments.paper.grids import DURATIONS_S
from experiments.paper.quantities import ERRORS, split_quantity
from experiments.report.data import Results
from ssac.pipeline.registry import METHODS

VERDICTS = {"better": "<", "agrees": "≈", "differs": "≠"}
"""Of a cell, and the sign that stands for it where colours are not seen."""

_SOUND_SHARE = 0.9  # of a method's runs give an estimate, or it cannot be called the best


def number(value: float, like: float | None = None) -> str:
    """Show an error as the paper does, with two decimals, fewer of large ones; or with another's.

    `like` is the mean, where the value is its deviation.
    """
    if not np.isfinite(value):
        return "\N{EN DASH}"
    size = abs(value if like is None or not np.isfinite(like) else like)
    return f"{value:.{3 if size < 0.1 else 2 if size < 10.0 else 1 if size < 100.0 else 0}f}"


class Table(NamedTuple):
    """Cells by angle and offset, a column for each method or published quantity."""

    title: str
    heads: list[tuple[str, str]]  # method, and which of its errors
    rows: list[tuple[float, int, float, list[Any]]]  # angle, as many rows share it (0 where it
    # stands above), offset, cells


def _table(
    title: str, heads: list[tuple[str, str]], cells: Mapping[tuple[float, float], list[Any]]
) -> Table:
    spans = Counter(angle_deg for angle_deg, _ in cells)
    rows = [(angle, spans.pop(angle, 0), t_d, line) for (angle, t_d), line in cells.items()]
    return Table(title, heads, rows)


def compared_tables(comparison: pd.DataFrame) -> list[Table]:
    """Lay out one table for each duration; a cell is a row of the comparison, or none."""
    tables = []
    for duration_s, part in comparison.groupby("duration_s"):
        quantities = list(part["quantity"].unique())
        lines: dict[tuple[float, float], dict[str, Any]] = {}
        for cell in part.to_dict("records"):
            lines.setdefault((cell["angle_deg"], cell["t_d_ms"]), {})[cell["quantity"]] = cell
        split = map(split_quantity, quantities)
        heads = [(method, ERRORS[e].title if e in ERRORS else "") for method, e in split]
        cells = {place: [line.get(q) for q in quantities] for place, line in lines.items()}
        tables.append(_table(f"Flights of {duration_s:g} s", heads, cells))
    return tables


def notes(comparison: pd.DataFrame) -> list[tuple[str, int, str]]:
    """List why cells do not agree, as far as that was found: why, how many, and which."""
    if "note" not in comparison:
        return []
    return [
        (str(note), len(cells), ", ".join(cells.unique()))
        for note, cells in comparison.groupby("note", sort=False)["quantity"]
        if note
    ]


def method_tables(results: Results) -> list[Table]:
    """Lay out all methods: a table for each kind of error and duration.

    A cell is mean, deviation, length of its bar on a logarithmic scale [%] or none, failed runs and
    runs.
    """
    tables = []
    for error, quantity in ERRORS.items():
        methods = results.methods_with(error)
        if not methods:
            continue
        low, high = _range(results, [f"{method}_{error}_mean" for method in methods])
        for duration_s, table in results.tables.items():
            cells = {
                (row["angle_deg"], row["t_d_ms"]): [
                    _mean(row, method, error, low, high) for method in methods
                ]
                for row in table.to_dict("records")
            }
            title = f"{quantity.title}, flights of {duration_s:g} s"
            tables.append(_table(title, [(method, "") for method in methods], cells))
    return tables


def _mean(
    row: Mapping[Any, Any], method: str, error: str, low: float, high: float
) -> tuple[Any, ...]:
    mean, std = (row.get(f"{method}_{error}_{part}", np.nan) for part in ("mean", "std"))
    percent = None
    if np.isfinite(mean):
        percent = 100.0 * float(np.clip(np.log(max(mean, low) / low) / np.log(high / low), 0.02, 1))
    return mean, std, percent, int(row.get(f"{method}_failed", 0)), int(row["n_runs"])


def _range(results: Results, columns: list[str]) -> tuple[float, float]:
    """Return the ends of the bars' scale: a little below the least mean, and the largest."""
    values = pd.concat([table.filter(columns).stack() for table in results.tables.values()])
    values = values[values > 0.0]
    if values.empty:
        return 0.1, 1.0
    low = 0.8 * float(values.min())
    return low, max(float(values.max()), 3.0 * low)


def failures(runs: pd.DataFrame) -> list[dict[str, Any]]:
    """List which runs gave no estimate: of which method, where and why."""
    n_runs = runs["method"].value_counts().to_dict()
    failed = runs[runs["status"] != "ok"]
    return [
        {
            "method": method,
            "status": status,
            "n_failed": len(group),
            "n_runs": n_runs[method],
            "angles": ", ".join(f"{angle:g}°" for angle in sorted(group["angle_deg"].unique())),
            "reasons": list(group["reason"].value_counts(sort=False).items()),
        }
        for (method, status), group in failed.groupby(["method", "status"], sort=False)
    ]


def headline(results: Results) -> dict[str, Any]:
    """Sum up all runs: the best method that is not given the pose, if any is good enough."""
    runs, comparison = results.runs, results.comparison
    ok = runs[runs["status"] == "ok"]
    means = ok.groupby("method")[list(ERRORS)].mean()
    # With a pose, and reliable: the mean of a few lucky runs says nothing.
    shares = ok["method"].value_counts() / runs["method"].value_counts()
    sound = means[shares.reindex(means.index) >= _SOUND_SHARE].dropna()
    best = "" if sound.empty else str(sound["t_d_error_ms"].idxmin())
    of_ssac = comparison[comparison["quantity"] == "ssac_t_d_error_ms"]
    has_ssac = "ssac" in means.index and not of_ssac.empty
    return {
        "best": best,
        "best_errors": np.asarray(sound.loc[best]) if best else (),
        "ours": means["t_d_error_ms"].to_dict()["ssac"] if has_ssac else None,
        "published": of_ssac["published_mean"].mean(),
        "n_good": int(comparison["verdict"].isin(["agrees", "better"]).sum()),
        "n_failed": len(runs) - len(ok),
    }


def charts(results: Results) -> list[dict[str, Any]]:
    """Place each cell of each method at its mean error, on a logarithmic axis for each error.

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
        low = int(np.floor(logs.min()))
        high = max(int(np.ceil(logs.max())), low + 1)

        def percent(value: float, low: int = low, high: int = high) -> float:
            share = (np.log10(max(value, 10.0**low)) - low) / (high - low)
            return float(100.0 * np.clip(share, 0.0, 1.0))

        steps = (1, 2, 5) if high - low <= 2 else (1,)
        ticks = [step * 10.0**power for power in range(low, high) for step in steps]
        drawn.append(
            {
                "title": quantity.title,
                "ticks": [(percent(tick), tick) for tick in (*ticks, 10.0**high)],
                "rows": [
                    _chart_row(results, method, error, cells[method], percent) for method in cells
                ],
            }
        )
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
    results: Results,
    method: str,
    error: str,
    cells: pd.DataFrame,
    percent: Callable[[float], float],
) -> dict[str, Any]:
    """Lay out one method: a dot for each cell, a stroke for each mean of the paper."""
    angles = sorted(cells["angle_deg"].unique())

    def place(mean: float, angle: float) -> tuple[float, float]:
        spread = angle in angles and len(angles) > 1
        top = 15.0 + 70.0 * angles.index(angle) / (len(angles) - 1) if spread else 50.0
        return percent(mean), top

    of_paper = results.comparison["quantity"].map(split_quantity) == (method, error)
    published = results.comparison[of_paper]
    look = method_looks(results.methods)[method]
    return {
        "method": method,
        "summary": METHODS[method].summary if method in METHODS else "",
        "color": "currentColor" if look.color == "#000000" else look.color,
        "hollow": look.is_known,
        "shortest_s": min(DURATIONS_S),
        "dots": [(*place(cell["mean"], cell["angle_deg"]), cell)
                 for cell in cells.to_dict("records")],
        "strokes": list(map(place, published["published_mean"], published["angle_deg"])),
        "mean": cells["mean"].mean(),
    }  # fmt: skip
