"""Summaries of a study's runs, and their form in pages: aligned tables, numbers and sentences."""

import re
import textwrap
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import wraps
from typing import Any

import numpy as np
import pandas as pd

from experiments.lab.results import Results
from experiments.lab.study import Made
from ssac.fit.covariance import NORMAL_95

GroupRow = Callable[[pd.DataFrame], Mapping[str, Any]]

UNKNOWN = "none"  # shown in place of an unknown number
_WIDTH = 100
_NUMBER = re.compile(r"-?\d.*|none|")

_STATISTICS: Mapping[str, Callable[["pd.Series[Any]"], float]] = {
    "mean": lambda values: values.mean(),
    "std": lambda values: values.std(ddof=0),
    "median": lambda values: values.median(),
    "most": lambda values: values.max(),
}


def by_group(
    *keys: str, of_all: str = ""
) -> Callable[[GroupRow], Callable[[pd.DataFrame], pd.DataFrame]]:
    """Turn a function that makes the row of a group of runs into one that makes the whole table.

    The groups have equal `keys`, which come first in their row, and are in order of appearance;
    `of_all` names a group of all runs, which is before them.
    """

    def table_of(row: GroupRow) -> Callable[[pd.DataFrame], pd.DataFrame]:
        @wraps(row)
        def table(runs: pd.DataFrame) -> pd.DataFrame:
            if of_all:
                runs = pd.concat([runs.assign(**{keys[0]: of_all}), runs])
            groups = runs.groupby(list(keys), sort=False, dropna=False)
            rows = [{**dict(zip(keys, key, strict=True)), **row(of)} for key, of in groups]
            return pd.DataFrame(rows)

        return table

    return table_of


def answered(runs: pd.DataFrame) -> pd.DataFrame:
    """Return the runs whose status is "ok"."""
    return runs[runs["status"] == "ok"]


def held(runs: pd.DataFrame, name: str, unit: str) -> "pd.Series[bool]":
    """Return for each run whether the stated 95 % interval of a quantity contains the truth."""
    return runs[f"{name}_error_{unit}"] <= NORMAL_95 * runs[f"{name}_std_{unit}"]


def statistics(runs: pd.DataFrame, columns: Sequence[str], *names: str) -> dict[str, float]:
    """Return statistics of each column, such as "mean", under the names <column>_<statistic>."""
    return {f"{one}_{name}": _STATISTICS[name](runs[one]) for one in columns for name in names}


def made_of(file: str, make: Callable[[pd.DataFrame], Any], table: str) -> Made:
    """Declare a file that is made from one table of the results alone."""
    return Made(file, lambda results: make(results.table(table)))


def quoted(table: str, form: str, **where: Any) -> Callable[[Results], str]:
    """Declare a quoted number: a format, such as "{runs:.0f}", of the columns of a table's row."""
    return lambda results: form.format(**results.one(table, **where))


def quoted_of(
    table: str, column: str, form: str, scale: float = 1.0, **where: Any
) -> Callable[[Results], str]:
    """Declare a quoted number: {low}, {high}, {total} or {most} (largest |x|) of a column."""

    def text(results: Results) -> str:
        of = scale * results.column(table, column, **where)
        ends = {"low": np.nanmin(of), "high": np.nanmax(of), "most": np.nanmax(np.abs(of))}
        return form.format(**ends, total=np.nansum(of))

    return text


def shown_table(rows: pd.DataFrame, columns: Mapping[str, str]) -> str:
    """Format rows as a Markdown table; `columns` maps headings to formats such as "{runs:.0f}"."""
    return markdown_table(shown(rows, columns))


def shown(rows: pd.DataFrame, columns: Mapping[str, str]) -> pd.DataFrame:
    """Return the texts of `shown_table`."""
    cells = [[form.format(**row) for form in columns.values()] for row in records(rows)]
    return pd.DataFrame(cells, columns=list(columns))


def records(rows: pd.DataFrame) -> list[dict[str, Any]]:
    """Return rows as dictionaries; each column keeps its own type."""
    return [{str(name): value for name, value in row.items()} for row in rows.to_dict("records")]


def markdown_table(texts: pd.DataFrame) -> str:
    """Format texts as a Markdown table; columns of numbers are aligned to the right."""
    header, *rows = [
        [cell.replace("|", "\\|") for cell in row] for row in (texts.columns, *texts.to_numpy())
    ]
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
    """Format a number; UNKNOWN where it is not finite."""
    return f"{value:.{decimals}f}" if np.isfinite(value) else UNKNOWN


def means_with_stds(means: pd.Series, stds: pd.Series, decimals: int) -> list[str]:
    """Format means and deviations, with the decimal points of the deviations aligned."""
    shown = [number(std, decimals) for std in stds]
    wide = max(map(len, shown))
    return [
        f"{number(mean, decimals)} ± {std.rjust(wide)}" if np.isfinite(mean) else UNKNOWN
        for mean, std in zip(means, shown, strict=True)
    ]


def digits(value: float) -> str:
    """Format a number to two significant digits without exponent; UNKNOWN if it is not finite."""
    if not np.isfinite(value):
        return UNKNOWN
    rounded = f"{value:.1e}"
    return f"{float(rounded):.{max(1 - int(rounded.split('e')[1]), 0)}f}"


def listed(texts: Iterable[str]) -> str:
    """Join texts as in a sentence: "a, b and c"."""
    *first, last = texts
    return f"{', '.join(first)} and {last}" if first else last
