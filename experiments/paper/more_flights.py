"""A comparison in; what our further flights tell beside as many as the paper's, for the page, out.

Also how the page names a quantity.
"""

from typing import Any

import pandas as pd

from experiments.lab.markdown import markdown_table, number, paragraph
from experiments.paper.published import PUBLISHED_RUNS
from experiments.paper.quantities import ERRORS, split_quantity
from experiments.paper.summary import VERDICTS

Record = dict[str, Any]


def flights_section(
    runs: pd.DataFrame, comparison: pd.DataFrame, summary: pd.DataFrame
) -> list[str]:
    """Show which verdicts and intervals the further flights changed.

    Parameters
    ----------
    runs
        As of `esim.ordered_runs`.
    comparison
        As of `comparison.comparison_table`.
    summary
        As of `summary.summary_table`.

    Returns
    -------
    list of str
        The section; nothing where there are no further flights.
    """
    if int(runs["flight"].max()) < PUBLISHED_RUNS:
        return []
    rows = [
        [
            label(row["quantity"]), f"{row['duration_s']:g} s",
            *(f"{row[f'first_{word}']} -> {row[word]}" for word in VERDICTS), str(row["changed"]),
            f"{number(row['first_ratio'], 2)} -> {number(row['ratio'], 2)}",
            *(number(row[name], 2) for name in ("first_factor", "factor", "factor_paper")),
        ]
        for row in records(summary)
    ]  # fmt: skip
    header = ["mean error", "flights", *VERDICTS, "changed", "ours / paper",
              f"to a factor of: first {PUBLISHED_RUNS}", "all",
              f"paper's {PUBLISHED_RUNS} alone"]  # fmt: skip
    pieces = [
        "## What our further flights tell",
        paragraph(
            f"""The paper has {PUBLISHED_RUNS} flights per cell. Each pair of numbers is by our
            first {PUBLISHED_RUNS} flights alone and by all of them (`first_verdict` and `verdict`
            of `comparison.csv`); *changed* counts the cells whose verdict differs between the two.
            The 95 % interval of the ratio to the paper's means reaches from the ratio divided by
            the factor given to the ratio multiplied by it. The last column is the factor that the
            paper's own flights would leave however many ours were."""
        ),
        markdown_table(header, rows),
        paragraph("Verdicts that changed (angle [deg]: offsets [ms]):"),
    ]
    changes = _changes(comparison)
    header = ["mean error", "flights", f"first {PUBLISHED_RUNS}", "all", "cells"]
    return ["\n\n".join([*pieces, markdown_table(header, changes) if changes else "None."])]


def label(name: str) -> str:
    """Name a mean error, `<method>_<error>`, for the head of a column."""
    method, error = split_quantity(name)
    return f"`{method}` {ERRORS[error].heading}"


def records(table: pd.DataFrame) -> list[Record]:
    """Rows as dictionaries; each column keeps its own type."""
    return [{str(key): value for key, value in row.items()} for row in table.to_dict("records")]


def _changes(comparison: pd.DataFrame) -> list[list[str]]:
    """List the cells whose verdict changed, those that changed alike in one row."""
    changed = comparison[comparison["verdict"] != comparison["first_verdict"]]
    keys = ["quantity", "duration_s", "first_verdict", "verdict"]
    rows = []
    for (quantity, duration_s, before, after), part in changed.groupby(keys):
        cells = [
            f"{angle_deg:g}: {', '.join(f'{t_d_ms:g}' for t_d_ms in at_angle['t_d_ms'])}"
            for angle_deg, at_angle in part.groupby("angle_deg")
        ]
        start = [label(str(quantity)), f"{duration_s:g} s", str(before), str(after)]
        rows.append([*start, "; ".join(cells)])
    return rows
