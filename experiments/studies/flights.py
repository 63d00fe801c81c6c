"""A simulator configuration and numbers of flights in; the flights with their seeds out."""

from collections.abc import Iterable, Iterator

from experiments.run.grid import flight_seed
from sim.recording import SimConfig


def drawn(sim: SimConfig, flights: Iterable[int]) -> Iterator[tuple[int, int]]:
    """Yield (number, seed) of flights of the duration and angle of a configuration."""
    for flight in flights:
        yield flight, flight_seed(sim.spline.duration_s, sim.angle_deg, flight)
