"""The grids of the paper's tables, their cells, and the axes of both."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cache

from experiments.lab.grid import Cell, GridConfig, flight_seed, named_config
from sim.recording import SimConfig

TABLES = ("esim_10", "esim_20")
"""Configurations of the paper's simulation tables: one for each duration."""


@dataclass(frozen=True)
class TableAxes:
    """What the tables' cells lie at, each in rising order."""

    durations_s: tuple[float, ...]
    angles_deg: tuple[float, ...]  # between the lines of sight
    t_ds_ms: tuple[float, ...]  # offsets


@cache
def table_grids() -> tuple[GridConfig, ...]:
    """Read the grids of the tables."""
    return tuple(named_config(name) for name in TABLES)


@cache
def table_cells() -> tuple[Cell, ...]:
    """List every run of the tables."""
    return tuple(cell for grid in table_grids() for cell in grid.cells())


@cache
def n_recordings() -> int:
    """Count the recordings of the tables; a flight's offsets share one."""
    return len({(cell.sim, cell.seed) for cell in table_cells()})


@cache
def table_axes() -> TableAxes:
    """Give the durations, angles and offsets of the tables."""
    cells = table_cells()
    return TableAxes(
        tuple(sorted({cell.sim.spline.duration_s for cell in cells})),
        tuple(sorted({cell.sim.angle_deg for cell in cells})),
        tuple(sorted({offset_ms(cell) for cell in cells})),
    )


def offset_ms(cell: Cell) -> float:
    """Offset of a cell [ms], as it is read from `runs.csv`: of six digits."""
    return round(1e3 * cell.t_d_s, 6)


def drawn(sim: SimConfig, flights: Iterable[int]) -> Iterator[tuple[int, int]]:
    """Yield (number, seed) of flights of the duration and angle of a configuration."""
    for flight in flights:
        yield flight, flight_seed(sim.spline.duration_s, sim.angle_deg, flight)


ANGLES_DEG = table_axes().angles_deg
"""Those of the tables: the studies fly at the same."""

DURATIONS_S = table_axes().durations_s
"""Of the tables."""
