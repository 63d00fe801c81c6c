"""How true the default recordings are: the same flights against another rendering.

`fidelity` compares with a far denser one: the flights 200, 201, ... of each duration at 90 deg.
`renderers` compares the tables by either renderer: their first flights of each duration and angle.
"""

from dataclasses import replace

import pandas as pd

from experiments.lab.study import summed_study
from experiments.measures.fidelity import (
    FIDELITY,
    METHOD_NAMES,
    SHARES,
    FidelityCell,
    opengl_config,
    reference_config,
)
from experiments.paper.grids import ANGLES_DEG, DURATIONS_S, drawn
from sim.recording import SimConfig
from sim.sensor.frames import FrameConfig

FIRST_FLIGHT = 200
N_FLIGHTS = {10.0: 10, 20.0: 10}
"""Flights of each duration [s]."""

RENDERER_FLIGHTS = 1
"""Of each duration and angle."""

MARKS_MS = {"ssac": 0.02, "joint": 0.02, "tangency": 0.015}
"""The mean absolute difference of t_d from the dense reference is to be at most this."""

RENDERER_TOLERANCE_MS = 0.005
"""The same between the renderers, for every method: half a digit of the paper's tables of t_d."""

T_D_S = 0.05

DIFFERENCES = tuple(f"{name.replace('-', '_')}_t_d_difference_ms" for name in METHOD_NAMES)
"""Columns of the methods' differences of t_d; in the means they have no signs."""


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
    """List the tables' first flights of each duration and angle, RENDERER_FLIGHTS of them."""
    cells = []
    for duration_s in DURATIONS_S:
        for angle_deg in ANGLES_DEG:
            sim = SimConfig(
                angle_deg=angle_deg,
                spline=replace(SimConfig().spline, duration_s=duration_s),
                t_d_s=T_D_S,
            )
            by_opengl = opengl_config(sim)
            flights = drawn(sim, range(RENDERER_FLIGHTS))
            cells += [FidelityCell(sim, flight, seed, by_opengl) for flight, seed in flights]
    return cells


def fidelity_table(runs: pd.DataFrame) -> pd.DataFrame:
    """Sum up the flights of each duration.

    Returns
    -------
    pd.DataFrame
        One row for each duration: flights, `failed`, the means of how the events differ, and for
        each method the mean of its differences of t_d without their signs, the standard error of
        that mean (`_se_ms`; NaN of one flight) and the largest of them (`_max_ms`).
    """
    rows = []
    for duration_s, group in runs.groupby("duration_s", sort=False):
        ok = group[group["status"] == "ok"]
        row = {"duration_s": duration_s, "n_runs": len(group), "failed": len(group) - len(ok)}
        row |= {"n_reference": round(ok["n_reference"].mean()) if len(ok) else 0}
        row |= {name: ok[name].mean() for name in SHARES}
        for name in DIFFERENCES:
            sizes = ok[name].abs()
            start = name.removesuffix("_ms")
            row[name] = sizes.mean()
            row |= {f"{start}_se_ms": sizes.sem(), f"{start}_max_ms": sizes.max()}
        rows.append(row)
    table: pd.DataFrame = pd.DataFrame(rows)
    return table


FIDELITY_STUDY = summed_study(
    "fidelity",
    "Events and offsets against a reference 8 times denser in time, 962 samples per pixel",
    fidelity_cells,
    FIDELITY,
    fidelity_table,
    keys=("duration_s", "flight"),
    config={"n_flights": {f"{key:g} s": n for key, n in N_FLIGHTS.items()},
            "first_flight": FIRST_FLIGHT},
    again=False,
)  # fmt: skip

RENDERERS_STUDY = summed_study(
    "renderers",
    "The tables' events and offsets by the native renderer against those by OpenGL",
    renderer_cells,
    FIDELITY,
    fidelity_table,
    keys=("duration_s", "angle_deg", "flight"),
    config={"flights": RENDERER_FLIGHTS, "durations_s": DURATIONS_S, "angles_deg": ANGLES_DEG},
)

STUDIES = (FIDELITY_STUDY, RENDERERS_STUDY)
