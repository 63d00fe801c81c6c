"""What the runs of a study say together, and how pages show it: tables, numbers and words.

Markdown is aligned so that it reads well as plain text too.
"""

import re
import textwrap
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from experiments.lab.results import Results
from experiments.lab.study import Made
from ssac.fit.covariance import NORMAL_95

UNKNOWN = "none"
"""Shown in place of a number that there is not."""

_WIDTH = 100
_NUMBER = re.compile(r"-?\d.*|none|")

_STATISTICS: Mapping[str, Callable[["pd.Series[Any]"], float]] = {
    "mean": lambda values: values.mean(),
    "std": lambda values: values.std(ddof=0),
    "median": lambda values: values.median(),
    "most": lambda values: values.max(),
}


def by_group(
    runs: pd.DataFrame,
    keys: Sequence[str],
    row: Callable[[pd.DataFrame], Mapping[str, Any]],
    dropna: bool = True,
) -> pd.DataFrame:
    """Make a row of each group of runs, in their order: the keys, then what `row` gives."""
    groups = runs.groupby(list(keys), sort=False, dropna=dropna)
    return pd.DataFrame([{**dict(zip(keys, key, strict=True)), **row(of)} for key, of in groups])


def answered(runs: pd.DataFrame) -> pd.DataFrame:
    """Give the runs that are "ok"."""
    return runs[runs["status"] == "ok"]


def held(runs: pd.DataFrame, name: str, unit: str) -> "pd.Series[bool]":
    """Whether the stated interval of 95 % of a quantity holds the truth."""
    return runs[f"{name}_error_{unit}"] <= NORMAL_95 * runs[f"{name}_std_{unit}"]


def statistics(runs: pd.DataFrame, columns: Sequence[str], *names: str) -> dict[str, float]:
    """Give some statistics of each column, such as "mean", as <column>_<statistic>."""
    return {f"{one}_{name}": _STATISTICS[name](runs[one]) for one in columns for name in names}


def made_of(file: str, make: Callable[[pd.DataFrame], Any], table: str) -> Made:
    """Declare a file that is made of one table of results alone."""
    return Made(file, lambda results: make(results.table(table)))


def quoted(table: str, form: str, **where: Any) -> Callable[[Results], str]:
    """Declare a number of a page: columns of the one row of a table, as "{runs:.0f}" shows them."""
    return lambda results: form.format(**results.one(table, **where))


def quoted_of(
    table: str, column: str, form: str, scale: float = 1.0, **where: Any
) -> Callable[[Results], str]:
    """Declare a number of a page: {low}, {high}, {most} and {total} of the numbers of a column."""

    def text(results: Results) -> str:
        of = scale * results.column(table, column, **where)
        ends = {"low": np.nanmin(of), "high": np.nanmax(of), "most": np.nanmax(np.abs(of))}
        return form.format(**ends, total=np.nansum(of))

    return text


def shown_table(rows: pd.DataFrame, columns: Mapping[str, str]) -> str:
    """Lay rows out as Markdown: under each heading their columns, as "{runs:.0f}" shows them."""
    return markdown_table(list(columns), shown_cells(rows, columns))


def shown_cells(rows: pd.DataFrame, columns: Mapping[str, str]) -> list[list[str]]:
    """Give the cells of `shown_table`, row by row."""
    return [[form.format(**row) for form in columns.values()] for row in records(rows)]


def records(rows: pd.DataFrame) -> list[dict[str, Any]]:
    """Give rows as dictionaries; each column keeps its own type."""
    return [{str(name): value for name, value in row.items()} for row in rows.to_dict("records")]


def markdown_table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Lay out a table; columns of numbers to the right, those with a word to the left."""
    rows = [[cell.replace("|", "\\|") for cell in row] for row in rows]
    columns = list(zip(header, *rows, strict=True))
    widths = [max(3, *map(len, column)) for column in columns]
    right = [all(_NUMBER.fullmatch(cell) for cell in column[1:]) for column in columns]
    rule = ["-:".rjust(width, "-") if to_right else "-" * width
            for width, to_right in zip(widths, right, strict=True)]  # fmt: skip

    def line(row: Sequence[str]) -> str:
        cells = zip(row, widths, right, strict=True)
        return " | ".join(one.rjust(n) if to_right else one.ljust(n) for one, n, to_right in cells)

    return "\n".join(f"| {line(row)} |" for row in (header, rule, *rows))


def paragraph(text: str) -> str:
    """Break a text into lines; a line that starts with "- " is an item of a list."""
    indent = "  " if text.startswith("- ") else ""
    return textwrap.fill(
        " ".join(text.split()), _WIDTH, subsequent_indent=indent,
        break_on_hyphens=False, break_long_words=False,
    )  # fmt: skip


def number(value: float, decimals: int) -> str:
    """Show a number, or that there is none."""
    return f"{value:.{decimals}f}" if np.isfinite(value) else UNKNOWN


def means_with_stds(means: pd.Series, stds: pd.Series, decimals: int) -> list[str]:
    """Show means and deviations, their decimal points below each other."""
    shown = [number(std, decimals) for std in stds]
    wide = max(map(len, shown))
    return [
        f"{number(mean, decimals)} ± {std.rjust(wide)}" if np.isfinite(mean) else UNKNOWN
        for mean, std in zip(means, shown, strict=True)
    ]


def digits(value: float) -> str:
    """Show two significant digits, without an exponent."""
    if not np.isfinite(value):
        return UNKNOWN
    rounded = f"{value:.1e}"
    return f"{float(rounded):.{max(1 - int(rounded.split('e')[1]), 0)}f}"


def listed(texts: Iterable[str]) -> str:
    """Join as in a sentence: "a, b and c"."""
    *first, last = texts
    return f"{', '.join(first)} and {last}" if first else last
