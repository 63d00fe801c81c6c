"""The page `results/README.md`, which shows our numbers beside the paper's for people to read.

Its tables are made here, for the HTML report too; the page's text stands in the template
`page.md.jinja`. Every mean also stands in one of the CSV files.
"""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd
from jinja2 import Environment, FileSystemLoader, StrictUndefined

from experiments.lab.summary import (
    UNKNOWN,
    markdown_table,
    means_with_stds,
    number,
    paragraph,
    shown,
)
from experiments.paper.comparison import (
    PUBLISHED_ERRORS,
    PUBLISHED_RUNS,
    RULE,
    VERDICTS,
    summary_table,
)
from experiments.paper.esim import ERRORS, POSE_ERRORS, T_D_ERROR, method_order, pose_methods

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
    """Render the page of the runs, their tables and the comparison; `provenance` is of the runs."""
    return _PAGES.get_template("page.md.jinja").render(
        page_content(runs, tables, comparison),
        flights=" and ".join(
            f"{of_duration['flight'].nunique()} of {duration_s:g} s"
            for duration_s, of_duration in runs.groupby("duration_s")
        ),
        n_recordings=len(runs[["duration_s", "angle_deg", "flight"]].drop_duplicates()),
        has_further=int(runs["flight"].max()) >= PUBLISHED_RUNS,
        files=" and ".join(f"`esim_{duration_s:g}.csv`" for duration_s in tables),
        made=provenance,
        gl=provenance["gl"] or {},
        versions=", ".join(f"{name} {v}" for name, v in provenance["versions"].items()),
    )


def page_content(
    runs: pd.DataFrame, tables: Mapping[float, pd.DataFrame], comparison: pd.DataFrame
) -> dict[str, Any]:
    """Return the page's tables and counts, independent of its markup."""
    summary = summary_table(comparison)
    differing = comparison[comparison["verdict"] == "differs"]
    return {
        "rule": RULE,
        "n_published": PUBLISHED_RUNS,
        "against": _shown(
            summary.assign(
                low=summary["ratio"] / summary["factor"],
                high=summary["ratio"] * summary["factor"],
                percent=100 * summary["visible"],
            ),
            _AGAINST,
        ),
        "further": _shown(summary, _FURTHER),
        "changes": _changed_verdicts(comparison),
        "growth": _growth(comparison),
        "durations": [
            _flights(runs, duration_s, table, comparison) for duration_s, table in tables.items()
        ],
        "differing": _shown(differing.replace({"note": {"": "not known"}}), _DIFFERENCES),
        "failed": shown(_failures(runs), _FAILED),
        "n_failed": int((runs["status"] != "ok").sum()),
        "n_runs": len(runs),
    }


def label(method: str, error: str) -> str:
    """Return the heading of a column of mean errors."""
    return f"`{method}` {ERRORS[error].heading}"


_LABELS = {one.name: label(one.method, one.error) for one in PUBLISHED_ERRORS}
_WHICH = {"mean error": "{error}", "flights": "{duration_s:g} s"}

_AGAINST = {
    **_WHICH,
    **{name: f"{{{name}}}" for name in ("cells", *VERDICTS)},
    "ours / paper": "{ratio:.2f}",
    "95 %": "{low:.2f} to {high:.2f}",
    "in single cells": "{ratio_min:.2f} to {ratio_max:.2f}",
    "visible from": "{percent:.0f} %",
}
_FURTHER = {
    **_WHICH,
    **{word: f"{{first_{word}}} -> {{{word}}}" for word in VERDICTS},
    "changed": "{changed}",
    "ours / paper": "{first_ratio:.2f} -> {ratio:.2f}",
    f"to a factor of: first {PUBLISHED_RUNS}": "{first_factor:.2f}",
    "all": "{factor:.2f}",
    f"paper's {PUBLISHED_RUNS} alone": "{factor_paper:.2f}",
}
_DIFFERENCES = {
    **_WHICH,
    "angle [deg]": "{angle_deg:g}",
    "t_d [ms]": "{t_d_ms:g}",
    "ours": "{ours_mean:.3f}",
    "paper": "{published_mean:.2f}",
    "95 % interval of the difference": "{difference_low:.3f} to {difference_high:.3f}",
    "reason": "{note}",
}
_FAILED = {
    "method": "`{method}`",
    "flights": "{duration_s:g} s",
    "status": "{status}",
    "runs": "{runs}",
    "reason of the first": "{reason}",
}
"""_AGAINST, _FURTHER, _DIFFERENCES and _FAILED: formats of a row's values, by column's heading."""


def _shown(rows: pd.DataFrame, columns: Mapping[str, str]) -> pd.DataFrame:
    texts = shown(rows.assign(error=rows["quantity"].map(_LABELS)), columns)
    return texts.replace(r"\bnan\b", UNKNOWN, regex=True)


def _changed_verdicts(comparison: pd.DataFrame) -> pd.DataFrame:
    """List the cells whose verdict changed; those of a quantity that changed alike share a row."""
    changed = comparison[comparison["verdict"] != comparison["first_verdict"]]
    groups = changed.groupby(["quantity", "duration_s", "first_verdict", "verdict"])
    return pd.DataFrame([
        {
            "mean error": _LABELS[str(name)],
            "flights": f"{duration_s:g} s",
            f"first {PUBLISHED_RUNS}": first,
            "all": now,
            "cells": "; ".join(
                f"{angle_deg:g}: {', '.join(f'{t_d_ms:g}' for t_d_ms in at_angle['t_d_ms'])}"
                for angle_deg, at_angle in part.groupby("angle_deg")
            ),
        }
        for (name, duration_s, first, now), part in groups
    ])  # fmt: skip


def _growth(comparison: pd.DataFrame) -> pd.DataFrame:
    """Tabulate the correlation methods' mean errors by angle, ours and the paper's."""
    rows = []
    chosen = comparison[comparison["quantity"].str.startswith("zncc")]
    for (name, duration_s), part in chosen.groupby(["quantity", "duration_s"]):
        method = f"`{str(name).removesuffix(f'_{T_D_ERROR.column}')}`"
        for who, column in (("ours", "ours_mean"), ("paper", "published_mean")):
            means = part.groupby("angle_deg")[column].mean()
            values = {f"{angle_deg:g} deg": number(mean, 0) for angle_deg, mean in means.items()}
            rows.append({"method": method, "flights": f"{duration_s:g} s", "whose": who, **values})
    return pd.DataFrame(rows)


def _flights(
    runs: pd.DataFrame, duration_s: float, table: pd.DataFrame, comparison: pd.DataFrame
) -> dict[str, Any]:
    """Return the tables of one duration: of the paper's methods, and of all others."""
    part = comparison[comparison["duration_s"] == duration_s]
    published = {quantity.method for quantity in PUBLISHED_ERRORS}
    methods = method_order(runs.loc[runs["duration_s"] == duration_s, "method"])
    others = [name for name in methods if name not in published]
    posed = [name for name in pose_methods(runs) if name in others]
    return {
        "duration": f"{duration_s:g}",
        "ours": _beside_the_paper(part, is_ssac=True, decimals=2),
        "correlated": _beside_the_paper(part, is_ssac=False, decimals=1),
        "others": _others(table, [(m, T_D_ERROR.column) for m in others]),
        "posed": _others(table, [(m, e) for m in posed for e in POSE_ERRORS]),
    }


def _beside_the_paper(part: pd.DataFrame, is_ssac: bool, decimals: int) -> pd.DataFrame:
    """Tabulate our mean, the paper's and the verdict, one row for each angle and offset."""
    columns: list[pd.Series] = []
    for quantity in PUBLISHED_ERRORS:
        chosen = part[part["quantity"] == quantity.name].reset_index()
        if len(chosen) and (quantity.method == "ssac") == is_ssac:
            columns = columns or [*_places(chosen)]
            for head, whose in ((_LABELS[quantity.name], "ours"), ("paper", "published")):
                mean, std = chosen[f"{whose}_mean"], chosen[f"{whose}_std"]
                columns.append(pd.Series(means_with_stds(mean, std, decimals), name=head))
            columns.append(chosen["verdict"])
    return pd.concat(columns, axis=1) if columns else pd.DataFrame()


def _others(table: pd.DataFrame, errors: Sequence[tuple[str, str]]) -> pd.DataFrame | None:
    """Tabulate errors (method, error), one row for each angle and offset; None without errors."""
    columns = {}
    for method, error in errors:
        means, stds = (table[f"{method}_{error}_{part}"] for part in ("mean", "std"))
        decimals = 1 if means.max() >= 10 else 3 if error == T_D_ERROR.column else 2
        n_ok = table["n_runs"] - table[f"{method}_failed"]
        columns[label(method, error)] = [
            cell if n == n_runs or not n else f"{cell} ({n} runs)"
            for cell, n, n_runs in zip(
                means_with_stds(means, stds, decimals), n_ok, table["n_runs"], strict=True
            )
        ]
    return pd.concat([*_places(table), pd.DataFrame(columns)], axis=1) if errors else None


def _places(rows: pd.DataFrame) -> Iterator[pd.Series]:
    for name, head in (("angle_deg", "angle [deg]"), ("t_d_ms", "t_d [ms]")):
        yield rows[name].map("{:g}".format).rename(head)


def _failures(runs: pd.DataFrame) -> pd.DataFrame:
    """Count the runs that gave no estimate, with one reason of each kind."""
    groups = runs[runs["status"] != "ok"].groupby(["method", "duration_s", "status"])
    return groups["reason"].agg(runs="size", reason="first").reset_index()
