"""`results/README.md`: the numbers beside the paper's, for people to read.

The words stand in `page.md.jinja`, what its tables show is laid out here. Every mean in it also
stands in one of the CSV files.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd
from jinja2 import Environment, FileSystemLoader, StrictUndefined

from experiments.lab.markdown import markdown_table, means_with_stds, number, paragraph
from experiments.lab.summary import records
from experiments.paper.comparison import (
    PUBLISHED_ERRORS,
    PUBLISHED_RUNS,
    RULE,
    SIZE_RULE,
    VERDICTS,
    summary_table,
)
from experiments.paper.esim import method_order, pose_methods
from experiments.paper.quantities import ERRORS, POSE_ERRORS, T_D_ERROR, split_quantity

_RATIO_GOAL = 1.0
"""The ratio of ours to the paper's is to be at most this, of each error of `ssac` in each table."""

Rows = list[list[str]]
Table = tuple[list[str], Rows]
"""Header and rows."""

_PAGES = Environment(
    loader=FileSystemLoader(Path(__file__).parent),
    undefined=StrictUndefined,
    keep_trailing_newline=True,
    autoescape=False,  # Markdown, of our own numbers
)
_PAGES.globals["table"] = markdown_table
_PAGES.filters["paragraph"] = paragraph


def results_page(
    runs: pd.DataFrame,
    tables: Mapping[float, pd.DataFrame],
    comparison: pd.DataFrame,
    provenance: Mapping[str, Any],
) -> str:
    """Write the page of the runs, their tables and the comparison; the provenance is the runs'."""
    summary = summary_table(comparison)
    ssac = comparison[comparison["quantity"] == "ssac_t_d_error_ms"]
    has_further = int(runs["flight"].max()) >= PUBLISHED_RUNS
    return _PAGES.get_template("page.md.jinja").render(
        flights=" and ".join(
            f"{of_duration['flight'].nunique()} of {duration_s:g} s"
            for duration_s, of_duration in runs.groupby("duration_s")
        ),
        n_recordings=len(runs[["duration_s", "angle_deg", "flight"]].drop_duplicates()),
        files=" and ".join(f"`esim_{duration_s:g}.csv`" for duration_s in tables),
        verdicts=list(VERDICTS),
        rule=RULE,
        size_rule=SIZE_RULE,
        n_published=PUBLISHED_RUNS,
        against=_against_the_paper(summary),
        further=_further_flights(summary) if has_further else [],
        changes=_changed_verdicts(comparison),
        goals=_goals(tables, comparison, summary),
        n_lower=int((ssac["mean_at_most_published"] == "yes").sum()),
        angles=[f"{angle:g} deg" for angle in sorted(comparison["angle_deg"].unique())],
        growth=_growth_rows(comparison),
        durations=[
            _flights(runs, duration_s, table, comparison) for duration_s, table in tables.items()
        ],
        differing=_differences(comparison),
        failed=_failures(runs),
        n_failed=int((runs["status"] != "ok").sum()),
        n_runs=len(runs),
        made=provenance,
        gl=provenance.get("gl") or {},
        versions=", ".join(f"{name} {v}" for name, v in provenance.get("versions", {}).items()),
    )


def label(name: str) -> str:
    """Name a mean error, `<method>_<error>`, for the head of a column."""
    method, error = split_quantity(name)
    return f"`{method}` {ERRORS[error].heading}"


def _place(row: Mapping[str, Any]) -> list[str]:
    return [label(row["quantity"]), f"{row['duration_s']:g} s"]


def _from_to(low: float, high: float, decimals: int) -> str:
    return f"{number(low, decimals)} to {number(high, decimals)}"


def _against_the_paper(summary: pd.DataFrame) -> Rows:
    return [
        [
            *_place(row), *(str(row[word]) for word in ("cells", *VERDICTS)),
            number(row["ratio"], 2),
            _from_to(row["ratio"] / row["factor"], row["ratio"] * row["factor"], 2),
            _from_to(row["ratio_min"], row["ratio_max"], 2),
            f"{number(100 * row['visible'], 0)} %",
        ]
        for row in records(summary)
    ]  # fmt: skip


def _further_flights(summary: pd.DataFrame) -> Rows:
    """Show which verdicts and intervals our further flights changed."""
    return [
        [
            *_place(row), *(f"{row[f'first_{word}']} -> {row[word]}" for word in VERDICTS),
            str(row["changed"]), f"{number(row['first_ratio'], 2)} -> {number(row['ratio'], 2)}",
            *(number(row[name], 2) for name in ("first_factor", "factor", "factor_paper")),
        ]
        for row in records(summary)
    ]  # fmt: skip


def _changed_verdicts(comparison: pd.DataFrame) -> Rows:
    """List the cells whose verdict changed, those that changed alike in one row."""
    changed = comparison[comparison["verdict"] != comparison["first_verdict"]]
    rows = []
    for _, part in changed.groupby(["quantity", "duration_s", "first_verdict", "verdict"]):
        cells = [
            f"{angle_deg:g}: {', '.join(f'{t_d_ms:g}' for t_d_ms in at_angle['t_d_ms'])}"
            for angle_deg, at_angle in part.groupby("angle_deg")
        ]
        first = records(part)[0]
        rows.append([*_place(first), first["first_verdict"], first["verdict"], "; ".join(cells)])
    return rows


def _goals(
    tables: Mapping[float, pd.DataFrame], comparison: pd.DataFrame, summary: pd.DataFrame
) -> Rows:
    """Say of each goal whether it is met, and what was reached."""

    def goal(words: str, n_met: int, n: int, what: str, more: str = "") -> list[str]:
        return [words, "met" if n_met == n else "**not met**", f"in {n_met} of {n} {what}{more}"]

    rows = []
    ssac = comparison[comparison["quantity"] == "ssac_t_d_error_ms"]
    if len(ssac):
        sized = ssac["paper_size_or_better"] == "yes"
        missed = "; ".join(
            f"{row['duration_s']:g} s, {row['angle_deg']:g} deg, {row['t_d_ms']:g} ms"
            for row in records(ssac[~sized])
        )
        words = "`ssac`: mean t_d of the paper's size or better in every cell"
        more = f", not in {missed}" if missed else ""
        rows.append(goal(words, int(sized.sum()), len(ssac), "cells", more))
    of_ssac = summary[summary["quantity"].str.startswith("ssac_")]
    if len(of_ssac):
        ratios = ", ".join(
            f"{ERRORS[split_quantity(row['quantity'])[1]].symbol} {number(row['ratio'], 2)} "
            f"over {row['duration_s']:g} s"
            for row in records(of_ssac)
        )
        words = f"`ssac`: ours / paper at most {_RATIO_GOAL:g} over the cells of each table"
        n_met = int((of_ssac["ratio"] <= _RATIO_GOAL).sum())
        rows.append(goal(words, n_met, len(of_ssac), "ratios", f": {ratios}"))
    for name, error in ERRORS.items():
        column = f"tangency_{name}_mean"
        values = [table[column] for table in tables.values() if column in table]
        if values:
            means = pd.concat(values)
            words = f"`tangency`: mean {error.heading} at most {error.mark:g} in every cell"
            more = f", the largest is {number(means.max(), 3)}"
            rows.append(goal(words, int((means <= error.mark).sum()), len(means), "cells", more))
    growth = [row[-1] for row in _growth_rows(comparison) if row[-1]]
    if growth:
        words = "`zncc_e`, `zncc_f`: mean t_d from tens of ms at 30 deg to hundreds at 150 deg"
        rows.append(goal(words, growth.count("yes"), len(growth), "rows below"))
    return rows


def _growth_rows(comparison: pd.DataFrame) -> Rows:
    """Mean errors of the correlation methods by angle, ours and the paper's."""
    rows = []
    chosen = comparison[comparison["quantity"].str.startswith("zncc")]
    for (name, duration_s), part in chosen.groupby(["quantity", "duration_s"]):
        means = part.groupby("angle_deg")[["ours_mean", "published_mean"]].mean()
        first, last = means["ours_mean"].iloc[0], means["ours_mean"].iloc[-1]
        met = "yes" if 10 <= first < 100 <= last < 1000 else "no"
        method = f"`{split_quantity(str(name))[0]}`"
        for who, column, verdict in (("ours", "ours_mean", met), ("paper", "published_mean", "")):
            values = [number(value, 0) for value in means[column]]
            rows.append([method, f"{duration_s:g} s", who, *values, verdict])
    return rows


def _flights(
    runs: pd.DataFrame, duration_s: float, table: pd.DataFrame, comparison: pd.DataFrame
) -> dict[str, Any]:
    """Lay out one of the paper's tables, and the methods that it does not have."""
    part = comparison[comparison["duration_s"] == duration_s]
    published = {quantity.method for quantity in PUBLISHED_ERRORS} if len(part) else set()
    methods = method_order(runs.loc[runs["duration_s"] == duration_s, "method"])
    others = [name for name in methods if name not in published]
    posed = [name for name in pose_methods(runs) if name in others]
    ours = [quantity.name for quantity in PUBLISHED_ERRORS if quantity.method == "ssac"]
    correlated = [quantity.name for quantity in PUBLISHED_ERRORS if quantity.method != "ssac"]
    return {
        "duration": f"{duration_s:g}",
        "ours": _beside_the_paper(part, ours, 2) if len(part) else None,
        "correlated": _beside_the_paper(part, correlated, 1) if len(part) else None,
        "others": _others(table, [(m, T_D_ERROR.column) for m in others]) if others else None,
        "posed": _others(table, [(m, e) for m in posed for e in POSE_ERRORS]) if posed else None,
    }


def _beside_the_paper(part: pd.DataFrame, names: Sequence[str], decimals: int) -> Table:
    """Ours, the paper's and the verdict for some quantities, one row for each angle and offset."""
    columns: list[tuple[str, list[str]]] = []
    for name in names:
        chosen = part[part["quantity"] == name]
        if len(chosen):
            columns = columns or _places(chosen)
            columns += [
                (head, means_with_stds(chosen[f"{whose}_mean"], chosen[f"{whose}_std"], decimals))
                for head, whose in ((label(name), "ours"), ("paper", "published"))
            ]
            columns.append(("verdict", list(chosen["verdict"])))
    return _table(columns)


def _others(table: pd.DataFrame, errors: Sequence[tuple[str, str]]) -> Table:
    """Errors (method, error) of the table, one row for each angle and offset."""
    columns = _places(table)
    for method, error in errors:
        means, stds = (table[f"{method}_{error}_{part}"] for part in ("mean", "std"))
        decimals = 1 if means.max() >= 10 else 3 if error == T_D_ERROR.column else 2
        n_ok = table["n_runs"] - table[f"{method}_failed"]
        cells = [
            cell if n == n_runs or not n else f"{cell} ({n} runs)"
            for cell, n, n_runs in zip(
                means_with_stds(means, stds, decimals), n_ok, table["n_runs"], strict=True
            )
        ]
        columns.append((label(f"{method}_{error}"), cells))
    return _table(columns)


def _places(rows: pd.DataFrame) -> list[tuple[str, list[str]]]:
    heads = {"angle_deg": "angle [deg]", "t_d_ms": "t_d [ms]"}
    return [(head, [f"{value:g}" for value in rows[name]]) for name, head in heads.items()]


def _table(columns: Sequence[tuple[str, list[str]]]) -> Table:
    rows = zip(*(cells for _, cells in columns), strict=True)
    return [head for head, _ in columns], [list(row) for row in rows]


def _differences(comparison: pd.DataFrame) -> Rows:
    """List the cells that differ, with the reasons known."""
    return [
        [
            *_place(row), f"{row['angle_deg']:g}", f"{row['t_d_ms']:g}",
            number(row["ours_mean"], 3), number(row["published_mean"], 2),
            _from_to(row["difference_low"], row["difference_high"], 3), row["note"] or "not known",
        ]
        for row in records(comparison[comparison["verdict"] == "differs"])
    ]  # fmt: skip


def _failures(runs: pd.DataFrame) -> Rows:
    """Count the runs that gave no estimate, with one reason of each kind."""
    groups = runs[runs["status"] != "ok"].groupby(["method", "duration_s", "status"])
    return [
        [f"`{method}`", f"{duration_s:g} s", str(status), str(len(group)), group["reason"].iloc[0]]
        for (method, duration_s, status), group in groups
    ]
