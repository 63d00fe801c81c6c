"""A simulator configuration and numbers of flights in; the flights with their seeds out."""

from collections.abc import Iterable, Iterator

from experiments.paper.grids import table_axes
from experiments.run.grid import flight_seed
from sim.recording import SimConfig

ANGLES_DEG = table_axes().angles_deg
"""Those of the tables: the studies fly at the same."""

DURATIONS_S = table_axes().durations_s
"""Of the tables."""


def drawn(sim: SimConfig, flights: Iterable[int]) -> Iterator[tuple[int, int]]:
    """Yield (number, seed) of flights of the duration and angle of a configuration."""
    for flight in flights:
        yield flight, flight_seed(sim.spline.duration_s, sim.angle_deg, flight)
