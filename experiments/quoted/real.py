"""What the pages say of imperfect recordings."""

from collections.abc import Callable, Hashable, Mapping
from functools import partial
from typing import Any

import numpy as np
import pandas as pd

from experiments.lab.markdown import markdown_table
from experiments.lab.results import Results
from experiments.studies.coverage import sampling_bounds
from experiments.studies.imperfect import ALL, HELD, IMPERFECT

SHOWN = ("joint", "tangency")
"""Methods of the rows of single kinds; over all kinds all of them have one."""


def imperfect_table(results: Results) -> str:
    """Say of all kinds together how many were answered, and how many of the answers held."""
    table = results.table(IMPERFECT.name)
    rows = []
    for row in table[table["kind"] == ALL].to_dict("records"):
        shares = (_share(row, name, with_bounds=True) for name in HELD)
        rows.append(
            [f"`{row['method']}`", _answered(row), *shares, f"{row['confident_wrong']:.0f}"]
        )
    quantities = (f"{name} [%]" for name in HELD)
    return markdown_table(["method", "answered", *quantities, "confident wrong"], rows)


def kinds_table(results: Results) -> str:
    """Say of each kind how many were answered and why others were not, and how many held."""
    table = results.table(IMPERFECT.name)
    rows = []
    for row in table[(table["kind"] != ALL) & table["method"].isin(SHOWN)].to_dict("records"):
        refused = "" if pd.isna(row["refused"]) else str(row["refused"]).replace(":", " ")
        shares = (_share(row, name, with_bounds=False) for name in HELD)
        refused = refused.replace("_", " ")
        wrong = f"{row['confident_wrong']:.0f}"
        rows.append([row["kind"], f"`{row['method']}`", _answered(row), refused, *shares, wrong])
    return markdown_table(["kind", "method", "answered", "refused", *HELD, "wrong"], rows)


def _answered(row: Mapping[Hashable, Any]) -> str:
    return f"{row['answered']:.0f} of {row['runs']:.0f}"


def _share(row: Mapping[Hashable, Any], name: str, with_bounds: bool) -> str:
    """Share of the answers that held; with what the number of runs leaves open, where asked for."""
    n_given, share = int(row[f"{name}_given"]), float(row[f"{name}_held"])
    if not np.isfinite(share):
        return ""
    if not with_bounds:
        return f"{100 * share:.0f}"
    low, high = sampling_bounds(round(share * n_given), n_given)
    return f"{100 * share:.0f} ({100 * low:.0f} to {100 * high:.0f})"


def of_imperfect(results: Results, column: str, method: str) -> str:
    """Count the imperfect recordings, those answered, or those whose truth an interval holds."""
    of = {"kind": ALL, "method": method}
    value = results.value(IMPERFECT.name, column, **of)
    if column.endswith("_held"):
        value *= results.value(IMPERFECT.name, column.replace("_held", "_given"), **of)
    return f"{value:.0f}"


def kinds_not_answered(results: Results) -> str:
    """List the kinds of imperfect recordings that `tangency` does not answer throughout."""
    table = results.rows(IMPERFECT.name, method="tangency")
    rows = table[(table["kind"] != ALL) & (table["answered"] < table["runs"])]
    return "; ".join(
        f"{row['kind']}: {row['runs'] - row['answered']:.0f} of {row['runs']:.0f}"
        for row in rows.to_dict("records")
    )


def kinds_wrong(results: Results) -> str:
    """List the kinds of imperfect recordings of which `tangency` gives confident wrong answers."""
    table = results.rows(IMPERFECT.name, method="tangency")
    rows = table[(table["kind"] != ALL) & (table["confident_wrong"] > 0)]
    return "; ".join(
        f"{row['kind']}: {row['confident_wrong']:.0f} of {row['runs']:.0f}"
        for row in rows.to_dict("records")
    )


REAL_NUMBERS: Mapping[str, Callable[[Results], str]] = {
    "imperfect.runs": partial(of_imperfect, column="runs", method="tangency"),
    "imperfect.kinds_not_answered": kinds_not_answered,
    "imperfect.kinds_wrong": kinds_wrong,
    **{
        f"imperfect.{name}.{method}": partial(of_imperfect, column=column, method=method)
        for method in SHOWN
        for name, column in {
            "answered": "answered",
            "wrong": "confident_wrong",
            **{f"held.{quantity}": f"{quantity}_held" for quantity in HELD},
        }.items()
    },
}

REAL_TABLES: Mapping[str, Callable[[Results], str]] = {
    "table.imperfect": imperfect_table,
    "table.imperfect.kinds": kinds_table,
}
