"""All files of results that the report shows; the error of a missing one names what makes it."""

import json
from collections.abc import Callable
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import pandas as pd

from experiments.lab.files import read_table
from experiments.lab.grid import config_names, named_config
from experiments.lab.results import PROVENANCE
from experiments.paper.esim import RUN_COLUMNS
from experiments.paper.grids import DURATIONS_S
from experiments.paper.quantities import T_D_ERROR
from ssac.errors import SsacError

_COMPARED = ("duration_s", "angle_deg", "t_d_ms", "quantity", "ours_mean", "ours_std", "n_ours",
             "published_mean", "published_std", "verdict")  # fmt: skip
_FIGURES = {
    "error_vs_angle": "make figures",
    "beyond_paper": "make figures",
    "success": "make figures",
    "efficiency": "make studies",
    "fig3_preprocessing": "make figures",
    "fig4_epipolar": "make figures",
    "fig5_d_avg": "make figures",
}
"""What makes them; the page has their words."""

Content = TypeVar("Content")


class ReportFigure(NamedTuple):
    """One picture, and what it varies if it is of an ablation."""

    name: str
    png: bytes
    varied: str = ""
    flights: int = 0

    @property
    def size_px(self) -> tuple[int, int]:
        """Width and height, off the PNG's header."""
        return int.from_bytes(self.png[16:20], "big"), int.from_bytes(self.png[20:24], "big")


@dataclass(frozen=True)
class Results:
    """What `make tables ablations figures` left."""

    tables: dict[float, pd.DataFrame]  # by duration [s], as `esim.esim_table` makes them
    runs: pd.DataFrame  # esim.RUN_COLUMNS
    comparison: pd.DataFrame  # as `comparison.comparison_table` makes it
    figures: tuple[ReportFigure, ...]
    provenance: dict[str, dict[str, Any]]  # by the name of the result

    @property
    def methods(self) -> list[str]:
        """Every method that any table has, in the order of its columns."""
        return self.methods_with(T_D_ERROR.column)

    def methods_with(self, error: str) -> list[str]:
        """Methods that give this error."""
        end = f"_{error}_mean"
        columns = dict.fromkeys(str(one) for table in self.tables.values() for one in table)
        return [column.removesuffix(end) for column in columns if column.endswith(end)]


def load_results(folder: Path) -> Results:
    """Read all that the report shows, as `make tables ablations figures` writes it."""

    def read(file: str, command: str, parse: Callable[[bytes], Content]) -> Content:
        path = folder / file
        try:
            return parse(path.read_bytes())
        except FileNotFoundError:
            raise SsacError(f"{path} is missing: run `{command}` first") from None
        except (OSError, ValueError, SsacError) as error:
            raise SsacError(f"{path} cannot be used ({error}): run `{command}` again") from error

    tables = {d: read(f"esim_{d:g}.csv", "make tables", _table) for d in DURATIONS_S}
    runs = read("runs.csv", "make tables", _runs)
    comparison = read("comparison.csv", "make tables", _comparison)
    made = {f"esim_20{PROVENANCE}", *(path.name for path in folder.glob(f"*{PROVENANCE}"))}
    provenance = {
        file.removesuffix(PROVENANCE): read(file, "make tables", _provenance)
        for file in sorted(made)
    }
    figures = [ReportFigure(name, read(f"{name}.png", made_by, _png))
               for name, made_by in _FIGURES.items()]  # fmt: skip
    for name in config_names("ablation_"):
        png, config = read(f"{name}.png", "make ablations", _png), named_config(name)
        figures.append(ReportFigure(name, png, config.title, config.flights))
    return Results(tables, runs, comparison, tuple(figures), provenance)


def _runs(content: bytes) -> pd.DataFrame:
    return _with_columns(read_table(content.decode("utf-8")), RUN_COLUMNS)


def _table(content: bytes) -> pd.DataFrame:
    return _with_columns(read_table(content.decode("utf-8")), ("angle_deg", "t_d_ms", "n_runs"))


def _comparison(content: bytes) -> pd.DataFrame:
    unknown = {"ours_mean": [""], "ours_std": [""]}
    table = pd.read_csv(BytesIO(content), keep_default_na=False, na_values=unknown)
    return _with_columns(table, _COMPARED)


def _provenance(content: bytes) -> dict[str, Any]:
    provenance = json.loads(content)
    if not isinstance(provenance, dict):
        raise ValueError("not a JSON object")
    return provenance


def _png(content: bytes) -> bytes:
    if not content.startswith(b"\x89PNG\r\n\x1a\n"):
        raise ValueError("not a PNG")
    return content


def _with_columns(table: pd.DataFrame, expected: tuple[str, ...]) -> pd.DataFrame:
    absent = [column for column in expected if column not in table]
    if absent:
        raise ValueError(f"it lacks the columns {', '.join(absent)}")
    return table
