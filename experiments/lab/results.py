"""The folder of results in; its rows and numbers out, or one line that says what is missing."""

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from ssac.errors import SsacError

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Committed:
    """The CSVs and provenances of one folder, each read once."""

    folder: Path
    _tables: dict[str, pd.DataFrame] = field(default_factory=dict, repr=False)

    def has(self, name: str) -> bool:
        """Return whether there is `<name>.csv`."""
        return (self.folder / f"{name}.csv").is_file()

    def table(self, name: str) -> pd.DataFrame:
        """Read `<name>.csv`.

        Raises
        ------
        SsacError
            When there is no such file.
        """
        if name not in self._tables:
            path = self.folder / f"{name}.csv"
            if not path.is_file():
                raise SsacError(
                    f"{path}: no such file: a page quotes it, so make it, or change the page"
                )
            self._tables[name] = pd.read_csv(path)
        return self._tables[name]

    def rows(self, name: str, /, **where: Any) -> pd.DataFrame:
        """Return the rows of a table whose columns have the given values; at least one.

        A keyword's double underscore stands for a dot of the column's name.
        """
        rows = self.table(name)
        for keyword, value in where.items():
            column = keyword.replace("__", ".")
            rows = rows[self._column(rows, name, column) == value]
        if rows.empty:
            wanted = ", ".join(f"{column} = {value}" for column, value in where.items())
            raise SsacError(f"{self.folder / name}.csv: no row with {wanted}")
        return rows

    def column(self, name: str, column: str, /, **where: Any) -> FloatArray:
        """Return a column's numbers in these rows, NaN where a cell is empty."""
        values = self._column(self.rows(name, **where), name, column)
        return values.to_numpy(np.float64)

    def texts(self, name: str, column: str, /, **where: Any) -> list[str]:
        """Return a column's cells in these rows as words, numbers as short as they can be."""
        values = self._column(self.rows(name, **where), name, column)
        return [f"{v:g}" if isinstance(v, float | int) else str(v) for v in values]

    def value(self, name: str, column: str, /, **where: Any) -> float:
        """Return the number of the one row that these values single out."""
        values = self.column(name, column, **where)
        if len(values) != 1:
            raise SsacError(f"{self.folder / name}.csv: {len(values)} rows with {where}, not one")
        return float(values[0])

    def minutes(self, name: str) -> float:
        """Return the wall time of the command that wrote `<name>.csv`, by its provenance."""
        path = self.folder / f"{name}.provenance.json"
        try:
            provenance = json.loads(path.read_text(encoding="utf-8"))
            return float(provenance["wall_time_s"]) / 60.0
        except (OSError, ValueError, KeyError) as error:
            raise SsacError(f"{path}: does not tell the wall time: {error!r}") from error

    def _column(self, rows: pd.DataFrame, name: str, column: str) -> "pd.Series[Any]":
        if column not in rows:
            raise SsacError(f"{self.folder / name}.csv: no column {column}")
        return rows[column]
