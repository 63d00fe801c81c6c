"""The paper's physical tables: ten recordings of each angle and duration, and the comparison.

All recordings of an angle are of one set-up with one calibration, as in the paper: what the
calibration errs by, all cells of the angle share.
"""

from collections.abc import Mapping
from functools import partial
from pathlib import Path

import pandas as pd
from matplotlib.figure import Figure

from experiments.drawing.errors import error_figure
from experiments.lab.files import csv_text, read_table
from experiments.lab.study import Study, summed_study
from experiments.paper.comparison import PUBLISHED_ERRORS, comparison_table, load_published
from experiments.paper.esim import esim_table
from experiments.physical.cells import cells_of, setup_seed
from experiments.physical.imperfections import ALL, ANGLES_DEG, IMPERFECTIONS, bench_of
from experiments.physical.measure import PHYSICAL, PhysicalCell
from ssac.errors import SsacError
from ssac.pipeline.registry import OURS

N_RECORDINGS = 10
"""Of each angle and duration, as in the paper."""

DURATIONS_S = (10.0, 20.0)
T_DS_MS = (5.0, 50.0, 500.0)
COMMAND = "ssac physical"
COMPARISON_FILE = "mini_comparison.csv"

PUBLISHED = Path(__file__).parent / "published"
_ERRORS = tuple(one for one in PUBLISHED_ERRORS if one.method == "ssac")
_METHODS = tuple(method.name for method in OURS)


def mini_cells(duration_s: float, n_recordings: int = N_RECORDINGS) -> list[PhysicalCell]:
    """List every method on every recording of a duration, with each offset."""
    return [
        cell
        for angle_deg in ANGLES_DEG
        for flight in range(n_recordings)
        for cell in cells_of(
            bench_of(ALL, angle_deg, duration_s, setup_seed(angle_deg, 0)),
            {},
            flight,
            T_DS_MS,
            _METHODS,
        )
    ]


def published_tables() -> dict[float, pd.DataFrame]:
    """Read the paper's physical tables, by duration [s]."""
    return load_published(PUBLISHED, "mini", DURATIONS_S, _ERRORS)


def mini_figure(_: pd.DataFrame, runs: pd.DataFrame) -> Figure:
    """Draw the errors of all methods beside the paper's."""
    return error_figure(runs, published_tables())


def mini_study(
    duration_s: float, n_recordings: int = N_RECORDINGS, command: str = COMMAND
) -> Study:
    """Give the table of a duration."""
    return summed_study(
        f"mini_{duration_s:g}",
        f"The paper's physical experiments of {duration_s:g} s, by their twin",
        partial(mini_cells, duration_s, n_recordings),
        PHYSICAL,
        partial(esim_table, duration_s=duration_s),
        keys=("angle_deg", "t_d_ms", "flight", "method"),
        draw=mini_figure,
        config={"n_recordings": n_recordings, "duration_s": duration_s, "angles_deg": ANGLES_DEG,
                "t_ds_ms": T_DS_MS, "imperfections": list(IMPERFECTIONS),
                "bench": bench_of(ALL, ANGLES_DEG[0], duration_s, setup_seed(ANGLES_DEG[0], 0))},
        command=command,
    )  # fmt: skip


MINI = {study.name: study for study in map(mini_study, DURATIONS_S)}
"""By the names of the paper's tables."""


def mini_config() -> Mapping[str, object]:
    """Give what both tables are made with, for the provenance of their comparison."""
    return {name: study.config for name, study in MINI.items()}


def comparison_text(results: Path) -> str:
    """Compare the tables in a folder with the paper's, cell by cell, as text.

    Raises
    ------
    SsacError
        When a table is not there.
    """
    tables: Mapping[float, pd.DataFrame] = {
        duration_s: _read(results / f"mini_{duration_s:g}.csv") for duration_s in DURATIONS_S
    }
    table = comparison_table(tables, published_tables(), reasons=(), errors=_ERRORS)
    return csv_text(table)


def _read(path: Path) -> pd.DataFrame:
    try:
        return read_table(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise SsacError(f"{path} cannot be read: {error}: run `{COMMAND}`") from error
