"""Results in, the table of the study of imperfect recordings out as Markdown."""

import numpy as np
import pandas as pd

from experiments.paper.markdown import markdown_table
from experiments.report.committed import Committed
from experiments.studies.coverage import sampling_bounds
from experiments.studies.imperfect import ALL, HELD, IMPERFECT

SHOWN = ("joint", "tangency")
"""Methods of the rows of single kinds; all of them have one over all kinds."""


def imperfect_table(results: Committed) -> str:
    """How many were answered and why others were not, and how many of the answers held.

    Empty where the study was not run.
    """
    if not results.has(IMPERFECT.name):
        return ""
    table = results.table(IMPERFECT.name)
    rows = []
    for _, row in table.iterrows():
        if row["kind"] != ALL and row["method"] not in SHOWN:
            continue
        refused = "" if pd.isna(row["refused"]) else str(row["refused"]).replace(":", " ")
        shares = (_share(row, name, with_bounds=row["kind"] == ALL) for name in HELD)
        rows.append(
            [
                str(row["kind"]),
                f"`{row['method']}`",
                f"{row['answered']:.0f} of {row['runs']:.0f}",
                refused.replace("_", " "),
                *shares,
                f"{row['confident_wrong']:.0f}",
            ]
        )
    quantities = (f"{name} [%]" for name in HELD)
    header = ["kind", "method", "answered", "refused", *quantities, "confident wrong"]
    return markdown_table(header, rows)


def _share(row: "pd.Series[float]", name: str, with_bounds: bool) -> str:
    """Share of the answers that held; with what the number of runs leaves open, where asked for."""
    n_given, share = int(row[f"{name}_given"]), float(row[f"{name}_held"])
    if not np.isfinite(share):
        return ""
    if not with_bounds:
        return f"{100 * share:.0f}"
    low, high = sampling_bounds(round(share * n_given), n_given)
    return f"{100 * share:.1f} ({100 * low:.1f} to {100 * high:.1f})"
