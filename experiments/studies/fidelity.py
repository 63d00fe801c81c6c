"""How true the default recordings are: the same flights against another rendering.

`fidelity` compares with a far denser one: the flights 200, 201, ... of each duration at 90 deg.
`renderers` compares the native renderer with OpenGL: the tables' first flight of each duration and
angle.
"""

from dataclasses import replace

import pandas as pd

from experiments.measures.fidelity import (
    FIDELITY,
    FidelityCell,
    FidelityRow,
    opengl_config,
    reference_config,
)
from experiments.studies.flights import ANGLES_DEG, drawn
from experiments.studies.study import Study
from sim.recording import SimConfig
from sim.sensor.frames import FrameConfig

FIRST_FLIGHT = 200
N_FLIGHTS = {10.0: 2, 20.0: 1}
"""Flights of each duration [s]."""

T_D_S = 0.05

_MEASURED = [name for name in vars(FidelityRow("")) if name not in ("status", "reason")]


def fidelity_cells(n_flights: dict[float, int] = N_FLIGHTS) -> list[FidelityCell]:
    """List the flights."""
    cells = []
    for duration_s, n in n_flights.items():
        spline = replace(SimConfig().spline, duration_s=duration_s)
        sim = SimConfig(spline=spline, frames=FrameConfig(rate_hz=0.0), t_d_s=T_D_S)
        flights = range(FIRST_FLIGHT, FIRST_FLIGHT + n)
        dense = reference_config(sim)
        cells += [FidelityCell(sim, flight, seed, dense) for flight, seed in drawn(sim, flights)]
    return cells


def renderer_cells() -> list[FidelityCell]:
    """List the tables' first flights, of each duration and angle."""
    cells = []
    for duration_s in N_FLIGHTS:
        for angle_deg in ANGLES_DEG:
            sim = SimConfig(
                angle_deg=angle_deg,
                spline=replace(SimConfig().spline, duration_s=duration_s),
                t_d_s=T_D_S,
            )
            by_opengl = opengl_config(sim)
            cells += [FidelityCell(sim, k, seed, by_opengl) for k, seed in drawn(sim, range(1))]
    return cells


def fidelity_table(runs: pd.DataFrame) -> pd.DataFrame:
    """Sum up the flights of each duration.

    Returns
    -------
    pd.DataFrame
        One row for each duration: flights, `failed`, the means of how the events differ, and the
        means of the methods' differences without their signs.
    """
    rows = []
    for duration_s, group in runs.groupby("duration_s", sort=False):
        ok = group[group["status"] == "ok"]
        means = ok[_MEASURED].abs().mean()
        row = {"duration_s": duration_s, "n_runs": len(group), "failed": len(group) - len(ok)}
        rows.append({**row, **means, "n_reference": round(means["n_reference"])})
    table: pd.DataFrame = pd.DataFrame(rows)
    return table


FIDELITY_STUDY = Study(
    "fidelity",
    "Events and offsets against a reference 16 times denser in time, 257 samples per pixel",
    fidelity_cells,
    FIDELITY,
    fidelity_table,
    keys=("duration_s", "flight"),
    config={"n_flights": {f"{key:g} s": n for key, n in N_FLIGHTS.items()},
            "first_flight": FIRST_FLIGHT},
)  # fmt: skip

RENDERERS_STUDY = Study(
    "renderers",
    "Events and offsets by the native renderer against those by OpenGL",
    renderer_cells,
    FIDELITY,
    fidelity_table,
    keys=("duration_s", "angle_deg", "flight"),
    config={"flights": 1, "durations_s": list(N_FLIGHTS), "angles_deg": ANGLES_DEG},
)
