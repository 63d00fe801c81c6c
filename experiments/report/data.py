"""All files of results that the report shows, read at once; a missing one is an error.

The error names the command that makes the file.
"""

import json
from collections.abc import Callable
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any, TypeVar

import pandas as pd

from experiments.lab.grid import config_names, named_config
from experiments.paper.esim import RUN_COLUMNS, runs_from_csv
from experiments.paper.grids import table_axes
from experiments.paper.quantities import T_D_ERROR
from ssac.errors import SsacError

_PNG = b"\x89PNG\r\n\x1a\n"
_COMPARED = ("duration_s", "angle_deg", "t_d_ms", "quantity", "ours_mean", "ours_std", "n_ours",
             "published_mean", "published_std", "verdict")  # fmt: skip
_ABLATION = "Mean errors of {flights} flights at each value and angle."
_FIGURES = {
    "error_vs_angle": (
        "Error against the angle between the cameras",
        "Every method, with the paper's values where it gives them.",
    ),
    "beyond_paper": (
        "What is gained beyond the paper",
        "The paper, its method as built here, the joint refinement, and epipolar tangency.",
    ),
    "efficiency": (
        "Errors and their Cramer-Rao bound",
        "Root mean square errors, and the least that the true tracks and the noise of each "
        "method's own samples allow.",
    ),
    "fig3_preprocessing": (
        "From events to a trajectory",
        "Raw events, the events that denoising leaves, and the drone's path in x, y and t: the "
        "paper's Fig. 3 from a recording of ours.",
    ),
    "fig4_epipolar": (
        "The epipolar distance",
        "The drone's position, its epipolar line and the distance between them on event images: "
        "the paper's Fig. 4.",
    ),
    "fig5_d_avg": (
        "The mean distance over the offset",
        "d_avg over a second on each side, and over 3 ms around its minimum: the paper's Fig. 5.",
    ),
}

Content = TypeVar("Content")


@dataclass(frozen=True)
class ReportFigure:
    """One picture with its words."""

    title: str
    caption: str
    png: bytes

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
        end = f"_{T_D_ERROR.column}_mean"
        columns = [str(column) for table in self.tables.values() for column in table]
        return list(dict.fromkeys(c.removesuffix(end) for c in columns if c.endswith(end)))

    def methods_with(self, error: str) -> list[str]:
        """Methods that give this error."""
        return [
            method
            for method in self.methods
            if any(f"{method}_{error}_mean" in table for table in self.tables.values())
        ]


def load_results(folder: Path) -> Results:
    """Read all that the report shows, as `make tables ablations figures` writes it.

    SsacError, which names the command that makes it, if a file is missing or is not as it should.
    """
    tables = {
        duration_s: _read(folder / f"esim_{duration_s:g}.csv", "make tables", _table)
        for duration_s in table_axes().durations_s
    }
    figures = []
    for name, (title, caption) in _FIGURES.items():
        command = "make studies" if name == "efficiency" else "make figures"
        png = _read(folder / f"{name}.png", command, _png)
        figures.append(ReportFigure(title, caption, png))
    for name in config_names("ablation_"):
        config = named_config(name)
        caption = _ABLATION.format(flights=config.flights)
        png = _read(folder / f"{name}.png", "make ablations", _png)
        figures.append(ReportFigure(config.title, caption, png))
    paths = {folder / "esim_20.provenance.json", *folder.glob("*.provenance.json")}
    provenance = {
        path.name.removesuffix(".provenance.json"): _read(path, "make tables", _provenance)
        for path in sorted(paths)
    }
    return Results(
        tables,
        _read(folder / "runs.csv", "make tables", _runs),
        _read(folder / "comparison.csv", "make tables", _comparison),
        tuple(figures),
        provenance,
    )


def _read(path: Path, command: str, parse: Callable[[bytes], Content]) -> Content:
    """Parse a file; SsacError that names it and the command that makes it, when it cannot be."""
    try:
        return parse(path.read_bytes())
    except FileNotFoundError:
        raise SsacError(f"{path} is missing: run `{command}` first") from None
    except (OSError, ValueError, SsacError) as error:
        raise SsacError(f"{path} cannot be used ({error}): run `{command}` again") from error


def _runs(content: bytes) -> pd.DataFrame:
    runs = runs_from_csv(content.decode("utf-8"))
    _check_columns(runs, RUN_COLUMNS)
    return runs


def _table(content: bytes) -> pd.DataFrame:
    table = pd.read_csv(BytesIO(content))
    _check_columns(table, ("angle_deg", "t_d_ms", "n_runs"))
    return table


def _comparison(content: bytes) -> pd.DataFrame:
    comparison = pd.read_csv(
        BytesIO(content), keep_default_na=False, na_values={"ours_mean": [""], "ours_std": [""]}
    )
    _check_columns(comparison, _COMPARED)
    return comparison


def _provenance(content: bytes) -> dict[str, Any]:
    provenance = json.loads(content)
    if not isinstance(provenance, dict):
        raise ValueError("not a JSON object")
    return provenance


def _png(content: bytes) -> bytes:
    if not content.startswith(_PNG):
        raise ValueError("not a PNG")
    return content


def _check_columns(table: pd.DataFrame, expected: tuple[str, ...]) -> None:
    absent = [column for column in expected if column not in table]
    if absent:
        raise ValueError(f"it lacks the columns {', '.join(absent)}")
