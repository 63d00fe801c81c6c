"""Kinds, angles and numbers of recordings in; the cells of the twin's studies, with seeds, out."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

from experiments.lab.grid import flight_seed
from experiments.physical.imperfections import SetUp
from experiments.physical.measure import PhysicalCell
from ssac.config import Config

SEARCH_AROUND_TRUTH_S = (-1.0, 1.0)
"""As of the simulation tables."""

_MOTION_SEEDS, _SETUP_SEEDS = 14, 15  # sets of seeds, beside that of the simulation tables


def motion_seed(duration_s: float, angle_deg: float, flight: int) -> int:
    """Seed of a recording."""
    return flight_seed(duration_s, angle_deg, flight, _MOTION_SEEDS)


def setup_seed(angle_deg: float, number: int) -> int:
    """Seed of a set-up, number 0 of which is that of the tables at an angle."""
    return flight_seed(0.0, angle_deg, number, _SETUP_SEEDS)


def cells_of(
    bench: SetUp,
    named: dict[str, object],
    flight: int,
    t_ds_ms: Sequence[float],
    methods: Sequence[str],
) -> Iterator[PhysicalCell]:
    """Yield every method at every offset on one recording.

    Parameters
    ----------
    bench
    named
        First columns of the rows.
    flight
        Number of the recording.
    t_ds_ms, methods
    """
    sim = bench.sim
    duration_s, angle_deg = sim.spline.duration_s, sim.angle_deg
    for t_d_ms in t_ds_ms:
        t_d_s = 1e-3 * t_d_ms
        low, high = SEARCH_AROUND_TRUTH_S
        estimator = replace(Config(), interval_s=(t_d_s + low, t_d_s + high))
        columns = {**named, "duration_s": duration_s, "angle_deg": angle_deg, "t_d_ms": t_d_ms}
        seed = motion_seed(duration_s, angle_deg, flight)
        for method in methods:
            yield PhysicalCell(sim, flight, seed, t_d_s, estimator, method, columns, bench)
