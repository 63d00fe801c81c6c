"""What the runs of a study say together: tables with a row for each group of runs."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import pandas as pd

from experiments.lab.markdown import markdown_table
from experiments.lab.results import Results
from experiments.lab.study import Made
from ssac.fit.covariance import NORMAL_95

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


def made_of(file: str, make: Callable[[pd.DataFrame], Any], table: str, **more: Any) -> Made:
    """Declare a file that is made of one table of results alone."""
    return Made(file, lambda results: make(results.table(table)), **more)


def quoted(table: str, form: str, **where: Any) -> Callable[[Results], str]:
    """Declare a number of a page: columns of the one row of a table, as "{runs:.0f}" shows them."""
    return lambda results: form.format(**results.one(table, **where))


def shown_table(rows: pd.DataFrame, columns: Mapping[str, str]) -> str:
    """Lay rows out as Markdown: under each heading their columns, as "{runs:.0f}" shows them."""
    return markdown_table(list(columns), shown_cells(rows, columns))


def shown_cells(rows: pd.DataFrame, columns: Mapping[str, str]) -> list[list[str]]:
    """Give the cells of `shown_table`, row by row."""
    return [[form.format(**row) for form in columns.values()] for row in records(rows)]


def records(rows: pd.DataFrame) -> list[dict[str, Any]]:
    """Give rows as dictionaries; each column keeps its own type."""
    return [{str(name): value for name, value in row.items()} for row in rows.to_dict("records")]
