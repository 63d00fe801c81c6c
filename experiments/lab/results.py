"""The files of a folder of results, each read once; what is missing is one line that says so."""

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pandas as pd

from experiments.lab.files import read_table
from ssac.arrays import Array
from ssac.errors import SsacError

PROVENANCE = ".provenance.json"

MERGED = "ssac merge"
"""Command of what was joined from shards: it has the provenance of each."""


@dataclass(frozen=True)
class Results:
    """The CSVs, provenances and pages of one folder.

    Its rows are those whose columns have the given values, of which there is one at least; a
    keyword's double underscore stands for a dot of the column's name.
    """

    folder: Path
    _texts: dict[str, str] = field(default_factory=dict, repr=False)
    _tables: dict[str, pd.DataFrame] = field(default_factory=dict, repr=False)

    def text(self, file: str) -> str:
        """Read a file; SsacError when it cannot be read."""
        if file not in self._texts:
            path = self.folder / file
            try:
                self._texts[file] = path.read_bytes().decode("utf-8")
            except FileNotFoundError as error:
                raise SsacError(f"{path}: no such file: make it first") from error
            except (OSError, UnicodeDecodeError) as error:
                raise SsacError(f"{path} cannot be read: {error}") from error
        return self._texts[file]

    def table(self, name: str) -> pd.DataFrame:
        """Read `<name>.csv`; an empty cell is NaN."""
        if name not in self._tables:
            self._tables[name] = read_table(self.text(f"{name}.csv"))
        return self._tables[name]

    def rows(self, name: str, /, **where: Any) -> pd.DataFrame:
        """Return rows of a table."""
        rows = self.table(name)
        for keyword, value in where.items():
            column = keyword.replace("__", ".")
            rows = rows[self._column(rows, name, column) == value]
        if rows.empty:
            wanted = ", ".join(f"{column} = {value}" for column, value in where.items())
            raise SsacError(f"{self.folder / name}.csv: no row with {wanted}")
        return rows

    def one(self, name: str, /, **where: Any) -> "pd.Series[Any]":
        """Return the one row that these values single out."""
        rows = self.rows(name, **where)
        if len(rows) != 1:
            raise SsacError(f"{self.folder / name}.csv: {len(rows)} rows with {where}, not one")
        return rows.iloc[0]

    def value(self, name: str, column: str, /, **where: Any) -> float:
        """Return the number of the one row that these values single out."""
        return float(self._column(self.one(name, **where), name, column))

    def column(self, name: str, column: str, /, **where: Any) -> Array:
        """Return a column's numbers in these rows, NaN where a cell is empty."""
        values: Array = self._column(self.rows(name, **where), name, column).to_numpy(float)
        return values

    def provenances(self, name: str) -> list[dict[str, Any]]:
        """Read what `<name>` was made with: once, or once for each shard that was merged."""
        file = f"{name}{PROVENANCE}"
        try:
            content = json.loads(self.text(file))
        except ValueError as error:
            raise SsacError(f"{self.folder / file} is no JSON: {error}") from error
        if not isinstance(content, dict):
            raise SsacError(f"{self.folder / file} holds no provenance")
        return content["shards"] if content.get("command") == MERGED else [content]

    def minutes(self, name: str) -> float:
        """Return the wall time of the command that wrote `<name>.csv`, by its provenance."""
        try:
            return float(self.provenances(name)[0]["wall_time_s"]) / 60.0
        except (ValueError, TypeError, KeyError) as error:
            path = self.folder / f"{name}{PROVENANCE}"
            raise SsacError(f"{path}: does not tell the wall time: {error!r}") from error

    def _column(self, rows: Any, name: str, column: str) -> Any:
        """Take a column of a table, or a cell of a row."""
        if column not in rows:
            raise SsacError(f"{self.folder / name}.csv: no column {column}")
        return rows[column]
