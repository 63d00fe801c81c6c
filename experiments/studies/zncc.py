"""Scenes and angles in, what the signals of two views share out: why ZNCC errs (docs/zncc.md).

Flights 300, 301, ... of each duration and angle, the same ones in all scenes and in the model; they
are of no table.
"""

from collections.abc import Iterator
from dataclasses import replace

import pandas as pd

from experiments.lab.study import summed_study
from experiments.measures.zncc import (
    MODELLED,
    MODELLED_SIGNALS,
    RATE,
    RENDERED,
    RENDERED_SIGNALS,
    SIGNALS,
    SignalCell,
)
from experiments.paper.grids import ANGLES_DEG, drawn
from sim.recording import SimConfig
from sim.render.config import SamplingConfig
from sim.scene.trajectory import SplineConfig

DEFAULT = "default"

_DEFAULT = SplineConfig()
SCENES = {
    DEFAULT: _DEFAULT,
    "flatter": replace(_DEFAULT, multiplier_xyz_m=(3.4, 3.4, 3.0)),
    "no turning": replace(_DEFAULT, multiplier_rot_rad=(0.0, 0.0, 0.0)),
    **{
        f"vertical {metres:g} m": replace(_DEFAULT, multiplier_xyz_m=(3.2, 3.2, metres))
        for metres in (3.0, 2.4, 1.8, 1.2)
    },
}
RENDERED_AT = {DEFAULT: ANGLES_DEG, "flatter": ANGLES_DEG, "no turning": (90.0,)}
"""Angles at which a scene is rendered."""

MODELLED_SCENES = [scene for scene in SCENES if scene != "no turning"]
"""The model does not turn either."""

RENDERED_S, MODELLED_S = 20.0, (10.0, 20.0)
FIRST_FLIGHT = 300
N_RENDERED, N_MODELLED = 10, 100
"""Flights at each scene, duration and angle."""

N_MORE = {(DEFAULT, 90.0): 20}
"""Rendered flights where ten tell too little."""

GROSS_MS = 100.0  # a larger error is another peak of the correlation, not the true one read badly
MAX_STEP_PX = 1.0  # four times the default: a third of the time, correlations within 0.02 the same


def signal_cells() -> list[SignalCell]:
    """List every signal of the rendered flights, then of the modelled ones."""
    return [*_rendered(), *_modelled()]


def _rendered() -> Iterator[SignalCell]:
    for scene, angles_deg in RENDERED_AT.items():
        for angle_deg in angles_deg:
            sim = SimConfig(
                angle_deg=angle_deg,
                spline=replace(SCENES[scene], duration_s=RENDERED_S),
                sampling=SamplingConfig(max_step_px=MAX_STEP_PX),
            )
            n_flights = N_MORE.get((scene, angle_deg), N_RENDERED)
            for flight, seed in drawn(sim, range(FIRST_FLIGHT, FIRST_FLIGHT + n_flights)):
                for signal in RENDERED_SIGNALS:
                    yield SignalCell(sim, flight, seed, RENDERED, scene, signal)


def _modelled() -> Iterator[SignalCell]:
    """Yield modelled signals: the factors of the event rate in the default scene alone."""
    for scene in MODELLED_SCENES:
        for duration_s in MODELLED_S:
            for angle_deg in ANGLES_DEG:
                spline = replace(SCENES[scene], duration_s=duration_s)
                sim = SimConfig(angle_deg=angle_deg, spline=spline)
                for flight, seed in drawn(sim, range(FIRST_FLIGHT, FIRST_FLIGHT + N_MODELLED)):
                    for signal in MODELLED_SIGNALS if scene == DEFAULT else (RATE,):
                        yield SignalCell(sim, flight, seed, MODELLED, scene, signal)


def signal_means(runs: pd.DataFrame) -> pd.DataFrame:
    """Mean over the flights; `gross_share` is that of errors above GROSS_MS."""
    runs = runs[runs["status"] == "ok"]
    measured = runs.drop(columns=["cell", "status", "reason", "flight", "seed"], errors="ignore")
    measured["gross_share"] = (runs["error_ms"] > GROSS_MS).astype(float)
    groups = measured.groupby(["source", "scene", "duration_s", "signal", "angle_deg"], sort=False)
    table = groups.mean(numeric_only=True)
    table.insert(0, "flights", groups.size())
    table.insert(2, "error_ms_std", groups["error_ms"].std(ddof=0))
    result: pd.DataFrame = table.rename(columns={"error_ms": "error_ms_mean"}).reset_index()
    return result


ZNCC = summed_study(
    "zncc",
    "What the signals of two views share",
    signal_cells,
    SIGNALS,
    signal_means,
    keys=("source", "scene", "duration_s", "angle_deg", "flight", "signal"),
    config={"scenes": SCENES, "first_flight": FIRST_FLIGHT, "n_rendered": N_RENDERED,
            "n_modelled": N_MODELLED},
)  # fmt: skip

STUDIES = (ZNCC,)
