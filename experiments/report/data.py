"""All files of results that the report shows; the error of a missing one names what makes it."""

import json
from collections.abc import Callable
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any, TypeVar

import pandas as pd

from experiments.lab.grid import config_names, named_config
from experiments.lab.results import PROVENANCE
from experiments.paper.esim import RUN_COLUMNS, runs_from_csv
from experiments.paper.grids import DURATIONS_S
from experiments.paper.quantities import T_D_ERROR
from ssac.errors import SsacError

_COMPARED = ("duration_s", "angle_deg", "t_d_ms", "quantity", "ours_mean", "ours_std", "n_ours",
             "published_mean", "published_std", "verdict")  # fmt: skip
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
        return self.methods_with(T_D_ERROR.column)

    def methods_with(self, error: str) -> list[str]:
        """Methods that give this error."""
        end = f"_{error}_mean"
        columns = dict.fromkeys(str(one) for table in self.tables.values() for one in table)
        return [column.removesuffix(end) for column in columns if column.endswith(end)]


def load_results(folder: Path) -> Results:
    """Read all that the report shows, as `make tables ablations figures` writes it.

    SsacError, which names the command that makes it, if a file is missing or is not as it should.
    """

    def read(file: str, command: str, parse: Callable[[bytes], Content]) -> Content:
        path = folder / file
        try:
            return parse(path.read_bytes())
        except FileNotFoundError:
            raise SsacError(f"{path} is missing: run `{command}` first") from None
        except (OSError, ValueError, SsacError) as error:
            raise SsacError(f"{path} cannot be used ({error}): run `{command}` again") from error

    drawn = [
        (name, "make studies" if name == "efficiency" else "make figures", *words)
        for name, words in _FIGURES.items()
    ]
    for name in config_names("ablation_"):
        config = named_config(name)
        caption = f"Mean errors of {config.flights} flights at each value and angle."
        drawn.append((name, "make ablations", config.title, caption))
    made = {f"esim_20{PROVENANCE}", *(path.name for path in folder.glob(f"*{PROVENANCE}"))}
    return Results(
        {
            duration_s: read(f"esim_{duration_s:g}.csv", "make tables", _table)
            for duration_s in DURATIONS_S
        },
        read("runs.csv", "make tables", _runs),
        read("comparison.csv", "make tables", _comparison),
        tuple(
            ReportFigure(title, caption, read(f"{name}.png", command, _png))
            for name, command, title, caption in drawn
        ),
        {
            file.removesuffix(PROVENANCE): read(file, "make tables", _provenance)
            for file in sorted(made)
        },
    )


def _runs(content: bytes) -> pd.DataFrame:
    return _with_columns(runs_from_csv(content.decode("utf-8")), RUN_COLUMNS)


def _table(content: bytes) -> pd.DataFrame:
    return _with_columns(pd.read_csv(BytesIO(content)), ("angle_deg", "t_d_ms", "n_runs"))


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
