"""The grids of the paper's tables, their cells, and the axes of both."""

from collections.abc import Iterable, Iterator
from functools import cache

from experiments.lab.grid import Cell, GridConfig, flight_seed, named_config
from sim.recording import SimConfig

TABLES = ("esim_10", "esim_20")
"""Configurations of the paper's simulation tables: one for each duration."""


@cache
def table_grids() -> tuple[GridConfig, ...]:
    """Read the grids of the tables."""
    return tuple(named_config(name) for name in TABLES)


@cache
def table_cells() -> tuple[Cell, ...]:
    """List every run of the tables."""
    return tuple(cell for grid in table_grids() for cell in grid.cells())


def n_recordings() -> int:
    """Count the recordings of the tables; a flight's offsets share one."""
    return len({(cell.sim, cell.seed) for cell in table_cells()})


def offset_ms(cell: Cell) -> float:
    """Offset of a cell [ms], as it is read from `runs.csv`: of six digits."""
    return round(1e3 * cell.t_d_s, 6)


def drawn(sim: SimConfig, flights: Iterable[int]) -> Iterator[tuple[int, int]]:
    """Yield (number, seed) of flights of the duration and angle of a configuration."""
    for flight in flights:
        yield flight, flight_seed(sim.spline.duration_s, sim.angle_deg, flight)


ANGLES_DEG = tuple(sorted({cell.sim.angle_deg for cell in table_cells()}))
"""Those of the tables, in rising order: the studies fly at the same."""

DURATIONS_S = tuple(sorted({cell.sim.spline.duration_s for cell in table_cells()}))
"""Of the tables, in rising order."""
