"""Results in, tables as HTML out: beside the paper's, all methods, runs without an estimate."""

from collections.abc import Iterable, Mapping
from html import escape
from typing import Any

import numpy as np
import pandas as pd

from experiments.paper.comparison import RULE
from experiments.paper.published import PUBLISHED_RUNS
from experiments.paper.quantities import ERRORS, split_quantity
from experiments.report.data import Results

VERDICTS = {"better": "&lt;", "agrees": "&asymp;", "differs": "&ne;"}
"""Of a cell, and the sign that stands for it where colours are not seen."""

_SHOWN_REASONS = 12


def number(value: float) -> str:
    """Show an error as the paper does, with two decimals, fewer of large ones."""
    if not np.isfinite(value):
        return "&ndash;"
    return f"{value:.{_decimals(value)}f}"


def mean_and_std(mean: float, std: float) -> tuple[str, str]:
    """Show a mean as `number` does, and its deviation to the same decimal."""
    if not (np.isfinite(mean) and np.isfinite(std)):
        return number(mean), number(std)
    return number(mean), f"{std:.{_decimals(mean)}f}"


def comparison_html(results: Results) -> str:
    """One table for each duration: our number over the paper's, in the colour of the verdict."""
    parts = []
    for duration_s, part in results.comparison.groupby("duration_s"):
        quantities = list(dict.fromkeys(part["quantity"]))
        heads = [_quantity_head(quantity) for quantity in quantities]
        lines: dict[tuple[float, float], dict[str, Mapping[Any, Any]]] = {}
        for cell in part.to_dict("records"):
            lines.setdefault((cell["angle_deg"], cell["t_d_ms"]), {})[cell["quantity"]] = cell
        rows = [
            "".join(
                _compared(cells[quantity]) if quantity in cells else "<td></td>"
                for quantity in quantities
            )
            for cells in lines.values()
        ]
        table = _cells_table(heads, lines, rows, "cells even")
        parts.append(f"<h3>Flights of {duration_s:g} s</h3>{table}")
    counts = results.comparison["verdict"].value_counts()
    legend = " ".join(
        f'<span class="{word}"><i>{sign}</i> {word}: {counts.get(word, 0)}</span>'
        for word, sign in VERDICTS.items()
    )
    return (
        f'<p class="legend">In each cell ours, below it the paper&rsquo;s: mean &plusmn; standard '
        f"deviation. {legend}</p>{''.join(parts)}{_notes_html(results.comparison)}"
        f'<p class="small">The rule. {escape(RULE[0].upper() + RULE[1:])}. The paper&rsquo;s means '
        f"are taken to be of {PUBLISHED_RUNS} runs.</p>"
    )


def methods_html(results: Results) -> str:
    """All methods: a table for each duration and kind of error, a bar behind each mean."""
    parts = []
    for error, quantity in ERRORS.items():
        methods = results.methods_with(error)
        if not methods:
            continue
        low, high = _range(results, methods, error)
        for duration_s, table in results.tables.items():
            lines = list(zip(table["angle_deg"], table["t_d_ms"], strict=True))
            rows = [
                "".join(_mean_cell(row, method, error, low, high) for method in methods)
                for row in table.to_dict("records")
            ]
            heads = [f'<th scope="col"><code>{escape(method)}</code></th>' for method in methods]
            parts.append(
                f"<details><summary>{quantity.title}, flights of {duration_s:g} s</summary>"
                f"{_cells_table(heads, lines, rows)}</details>"
            )
    return "".join(parts)


def failures_html(results: Results) -> str:
    """Say how many runs gave no estimate, of which method, where and why."""
    runs = results.runs
    failed = runs[runs["status"] != "ok"]
    if failed.empty:
        return f"<p>All {len(runs)} runs gave an estimate.</p>"
    rows = []
    for (method, status), group in failed.groupby(["method", "status"], sort=False):
        total = int((runs["method"] == method).sum())
        reasons = group["reason"].value_counts(sort=False)
        items = [
            f"<li>{escape(str(reason)) or 'no reason given'} ({count})</li>"
            for reason, count in list(reasons.items())[:_SHOWN_REASONS]
        ]
        if len(reasons) > _SHOWN_REASONS:
            items.append(f"<li>and {len(reasons) - _SHOWN_REASONS} more in runs.csv</li>")
        angles = ", ".join(f"{angle:g}&deg;" for angle in sorted(group["angle_deg"].unique()))
        rows.append(
            f'<tr><th scope="row"><code>{escape(str(method))}</code></th>'
            f"<td>{escape(str(status))}</td><td>{len(group)} of {total}</td><td>{angles}</td>"
            f'<td class="text"><details><summary>{len(reasons)} '
            f"reason{'s' if len(reasons) > 1 else ''}</summary>"
            f"<ul>{''.join(items)}</ul></details></td></tr>"
        )
    heads = "".join(
        f'<th scope="col">{head}</th>' for head in ("Method", "Status", "Runs", "Angles", "Why")
    )
    return (
        f"<p>{len(failed)} of {len(runs)} runs gave no estimate. They do not enter the means; "
        "every one is a row of <code>results/runs.csv</code>.</p>"
        f'<div class="wide"><table><thead><tr>{heads}</tr></thead>'
        f"<tbody>{''.join(rows)}</tbody></table></div>"
    )


def _notes_html(comparison: pd.DataFrame) -> str:
    """List why cells do not agree, as far as that was found."""
    if "note" not in comparison:
        return ""
    items = [
        f"<li>{escape(str(note))} ({len(cells)} cells: {escape(', '.join(cells.unique()))})</li>"
        for note, cells in comparison.groupby("note", sort=False)["quantity"]
        if note
    ]
    return f"<h3>Why cells do not agree</h3><ul>{''.join(items)}</ul>" if items else ""


def _decimals(value: float) -> int:
    return 3 if abs(value) < 0.1 else 2 if abs(value) < 10.0 else 1 if abs(value) < 100.0 else 0


def _cells_table(
    heads: list[str], keys: Iterable[tuple[float, float]], rows: list[str], style: str = "cells"
) -> str:
    """Lay out rows of the table's cells beside their angle, once for its offsets, and offset."""
    keys = list(keys)
    angles = [angle for angle, _ in keys]
    body, last = [], None
    for (angle, t_d_ms), row in zip(keys, rows, strict=True):
        first = angle != last
        head = f'<th scope="rowgroup" rowspan="{angles.count(angle)}">{angle:g}&deg;</th>'
        body.append(
            f"<tr{' class=first' if first else ''}>{head if first else ''}"
            f'<th scope="row">{t_d_ms:g} ms</th>{row}</tr>'
        )
        last = angle
    return (
        f'<div class="wide"><table class="{style}"><thead><tr><th scope="col">Angle</th>'
        f'<th scope="col"><var>t</var><sub>d</sub></th>{"".join(heads)}</tr></thead>'
        f"<tbody>{''.join(body)}</tbody></table></div>"
    )


def _quantity_head(quantity: str) -> str:
    method, error = split_quantity(quantity)
    known = ERRORS.get(error)
    name = known.title if known else ""
    return f'<th scope="col"><code>{escape(method)}</code><br><small>{name}</small></th>'


def _compared(cell: Mapping[Any, Any]) -> str:
    """One cell beside the paper's."""
    verdict = str(cell["verdict"])
    sign = VERDICTS.get(verdict, escape(verdict))
    ours, theirs = (
        " &plusmn; ".join(mean_and_std(cell[f"{side}_mean"], cell[f"{side}_std"]))
        for side in ("ours", "published")
    )
    note = str(cell.get("note") or "")
    title = escape(f"{verdict}, {cell['n_ours']} of our runs{f': {note}' if note else ''}")
    return (
        f'<td class="{escape(verdict)}" title="{title}"><b>{ours}</b><i>{sign}</i>'
        f"<small>{theirs}</small></td>"
    )


def _mean_cell(row: Mapping[Any, Any], method: str, error: str, low: float, high: float) -> str:
    """One method's mean in a cell, with a bar on a logarithmic scale."""
    mean, std = (row.get(f"{method}_{error}_{part}", np.nan) for part in ("mean", "std"))
    failed = row.get(f"{method}_failed", 0)
    lost = f"<small>{failed:g} of {row['n_runs']:g} failed</small>" if failed else ""
    if not np.isfinite(mean):
        return f"<td>&ndash;{lost}</td>"
    shown_mean, shown_std = mean_and_std(mean, std)
    share = float(np.clip(np.log(max(mean, low) / low) / np.log(high / low), 0.02, 1.0))
    return (
        f'<td class="bar" style="--share:{100.0 * share:.0f}%"><b>{shown_mean}</b> '
        f"&plusmn; {shown_std}{lost}</td>"
    )


def _range(results: Results, methods: list[str], error: str) -> tuple[float, float]:
    """Return the ends of the bars' scale: a little below the least mean, and the largest."""
    columns = [
        table[f"{method}_{error}_mean"]
        for table in results.tables.values()
        for method in methods
        if f"{method}_{error}_mean" in table
    ]
    values = pd.concat(columns)
    values = values[values > 0.0]
    if values.empty:
        return 0.1, 1.0
    low = 0.8 * float(values.min())
    return low, max(float(values.max()), 3.0 * low)
