"""The paper's tables in; what numbers they have, of which methods, and how exactly, out."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from experiments.paper.grids import table_axes
from experiments.paper.quantities import R_ERROR, T_D_ERROR, T_ERROR
from ssac.errors import SsacError

PUBLISHED = Path(__file__).resolve().parents[2] / "results" / "published"

PUBLISHED_RUNS = 10
"""Of each cell. All 30 published means of ZNCC_E are whole tenths of sums of multiples of its unit
of 10 ms, and so are the deviations if they are taken over 10 runs, not over 10 - 1."""


@dataclass(frozen=True)
class PublishedError:
    """One mean error that the paper gives."""

    method: str
    error: str
    published: str  # start of its columns in the published table
    resolution: float  # unit of the last printed digit

    @property
    def name(self) -> str:
        """Start of its columns in our table."""
        return f"{self.method}_{self.error}"


PUBLISHED_ERRORS = (
    PublishedError("ssac", T_D_ERROR.column, "ssac_error_ms", 0.01),
    PublishedError("zncc_e", T_D_ERROR.column, "zncc_e_error_ms", 0.1),
    PublishedError("zncc_f", T_D_ERROR.column, "zncc_f_error_ms", 0.1),
    PublishedError("ssac", R_ERROR.column, "r_error_deg", 0.01),
    PublishedError("ssac", T_ERROR.column, "t_error_deg", 0.01),
)


def load_published(
    folder: Path = PUBLISHED,
    name: str = "esim",
    durations_s: Sequence[float] | None = None,
    errors: tuple[PublishedError, ...] = PUBLISHED_ERRORS,
) -> dict[float, pd.DataFrame]:
    """Read the paper's tables, by duration [s].

    Parameters
    ----------
    folder
    name
        Start of their files' names.
    durations_s
        By default those of the simulation tables.
    errors
        That they must have.

    Raises
    ------
    SsacError
        If a file cannot be read or lacks a column.
    """
    tables = {}
    for duration_s in table_axes().durations_s if durations_s is None else durations_s:
        path = folder / f"{name}_{duration_s:g}.csv"
        try:
            table = pd.read_csv(path)
        except (OSError, ValueError) as error:
            raise SsacError(f"{path}: the published table cannot be read: {error}") from error
        needed = ["angle_deg", "t_d_ms"]
        needed += [f"{q.published}_{part}" for q in errors for part in ("mean", "std")]
        absent = [column for column in needed if column not in table]
        if absent:
            raise SsacError(f"{path}: the published table lacks the columns {', '.join(absent)}")
        tables[duration_s] = table
    return tables
