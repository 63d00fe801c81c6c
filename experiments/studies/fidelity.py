"""How true the default recordings are: the same flights against another rendering.

`fidelity` compares with a far denser one: the flights 200, 201, ... of each duration at 90 deg.
`renderers` compares the tables by either renderer: their first flights of each duration and angle.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd
from numba import njit
from numpy.typing import NDArray

from experiments.lab.cache import Cache
from experiments.lab.cell import Flight, FlightCell, Measure
from experiments.lab.markdown import markdown_table
from experiments.lab.recorded import Pair, recorded_pair
from experiments.lab.results import Results
from experiments.lab.study import Made, Runs, Study
from experiments.paper.grids import ANGLES_DEG, DURATIONS_S, drawn
from sim.recording import SimConfig
from sim.render.config import RenderConfig, SamplingConfig
from sim.render.lattice import Lattice
from sim.sensor.frames import FrameConfig
from ssac.pipeline.chain import Chain

SHARES = ("median_us", "p95_us", "spurious", "missing")  # of EventFidelity
METHOD_NAMES = ("ssac", "ssac-known", "joint", "tangency")
DENSER = 8  # times as many instants in the reference
REFERENCE_LATTICE = Lattice(31, 1)  # 962 samples per pixel, none of them where ours are
MATCH_WINDOW_US = 5000  # events of one pixel and polarity further apart are not the same: 1 px here


@dataclass(frozen=True)
class FidelityCell(FlightCell):
    """A flight with an offset, which is simulated twice."""

    reference: SimConfig  # of the same scene, rendered otherwise

    @property
    def recordings(self) -> tuple[Flight, ...]:
        """The recording, and its reference."""
        return ((self.sim, self.seed), (self.reference, self.seed))

    @property
    def columns(self) -> dict[str, Any]:
        """Columns that say which run it is."""
        return self.flown

    @property
    def inputs(self) -> float:
        """The offset, which the recordings do not know."""
        return self.sim.t_d_s


@dataclass(frozen=True)
class EventFidelity:
    """Events compared with those of the reference, by pixel and polarity."""

    n_reference: int
    median_us: float  # of the distance in time between an event and its counterpart
    p95_us: float
    spurious: float  # share of the events that have no counterpart in the reference
    missing: float  # share of the reference's events that have no counterpart


@dataclass(frozen=True)
class FidelityRow:
    """`EventFidelity`, the mean of both cameras, and how far the methods' offsets lie apart."""

    status: str
    reason: str = ""
    n_reference: int = 0
    median_us: float = np.nan
    p95_us: float = np.nan
    spurious: float = np.nan
    missing: float = np.nan
    ssac_t_d_difference_ms: float = np.nan
    ssac_known_t_d_difference_ms: float = np.nan
    joint_t_d_difference_ms: float = np.nan
    tangency_t_d_difference_ms: float = np.nan


def opengl_config(config: SimConfig) -> SimConfig:
    """Return the same scene, drawn with OpenGL at the same instants and samples."""
    return replace(config, render=replace(config.render, renderer="pyrender"))


def reference_config(config: SimConfig) -> SimConfig:
    """Return the same scene, rendered 8 times more densely in time with 962 samples per pixel.

    OpenGL cannot draw as many, so nothing is checked against it.
    """
    sampling = SamplingConfig(
        max_step_px=config.sampling.max_step_px / DENSER,
        min_rate_hz=config.sampling.min_rate_hz * DENSER,
    )
    render: RenderConfig = replace(config.render, lattice=REFERENCE_LATTICE, check=False)
    return replace(config, sampling=sampling, render=render)


def load_both(cells: Sequence[FidelityCell], cache: Cache) -> tuple[Pair, Pair]:
    """Load a recording and its reference."""
    first, second = (recorded_pair(cache, *flight) for flight in cells[0].recordings)
    return first, second


def fidelity_row(_: FidelityCell, both: tuple[Pair, Pair]) -> FidelityRow:
    """Compare a recording with its reference."""
    each = [
        compare_events(ours.events, theirs.events)
        for ours, theirs in zip(both[0][:2], both[1][:2], strict=True)
    ]
    offsets_ms = [_offsets_ms(pair) for pair in both]
    differences_ms = [offsets_ms[0][name] - offsets_ms[1][name] for name in METHOD_NAMES]
    return FidelityRow(
        "ok",
        "",
        round(float(np.mean([camera.n_reference for camera in each]))),
        *(float(np.mean([getattr(camera, name) for camera in each])) for name in SHARES),
        *differences_ms,
    )


def compare_events(events: NDArray[Any], reference: NDArray[Any]) -> EventFidelity:
    """Match events (n,) of EVENT_DTYPE with those of the reference, and sum up how they differ."""
    keys = [_sort_by_pixel(e) for e in (events, reference)]
    difference_us = _match(*keys[0], *keys[1], MATCH_WINDOW_US)
    n_matched = len(difference_us)
    return EventFidelity(
        n_reference=len(reference),
        median_us=float(np.median(difference_us)),
        p95_us=float(np.percentile(difference_us, 95)),
        spurious=1.0 - n_matched / len(events),
        missing=1.0 - n_matched / len(reference),
    )


def _offsets_ms(pair: Pair) -> dict[str, float]:
    """Offset [ms] that each method finds; only a method that needs the true pose is given it."""
    chain = Chain((pair.cam1, pair.cam2), pair.rig)
    return {name: 1e3 * chain.estimate(name).t_d_s for name in METHOD_NAMES}


def _sort_by_pixel(events: NDArray[Any]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return (pixel and polarity as one number, time [us]), sorted by both."""
    pixel = (events["y"].astype(np.int64) << 17) | (events["x"].astype(np.int64) << 1) | events["p"]
    order = np.lexsort((events["t"], pixel))
    return pixel[order], events["t"][order]


@njit(cache=True)
def _match(
    pixel_a: NDArray[np.int64],
    t_a: NDArray[np.int64],
    pixel_b: NDArray[np.int64],
    t_b: NDArray[np.int64],
    window_us: int,
) -> NDArray[np.int64]:
    """Walk along both, pixel by pixel and in order of time; return distances of pairs [us]."""
    differences = np.empty(min(t_a.size, t_b.size), np.int64)
    i = j = n = 0
    while i < t_a.size and j < t_b.size:
        if pixel_a[i] != pixel_b[j]:
            if pixel_a[i] < pixel_b[j]:
                i += 1
            else:
                j += 1
        elif abs(t_a[i] - t_b[j]) <= window_us:
            differences[n] = abs(t_a[i] - t_b[j])
            n += 1
            i += 1
            j += 1
        elif t_a[i] < t_b[j]:
            i += 1
        else:
            j += 1
    return differences[:n]


FIDELITY = Measure(load_both, fidelity_row, FidelityRow)

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


def page_table(results: Results) -> str:
    """Say how far events and offsets are from those of the reference, by duration [s]."""
    table = results.table("fidelity")
    by_duration = results.rows("fidelity_runs", status="ok").groupby("duration_s")

    def row(words: str, column: str, scale: float = 1.0, places: int = 0) -> list[str]:
        return [words, *(f"{scale * mean:.{places}f}" for mean in by_duration[column].mean())]

    rows = [
        ["flights", *map(str, by_duration.size())],
        row("event times, median [us]", "median_us"),
        row("event times, 95th percentile [us]", "p95_us"),
        row("spurious events [%]", "spurious", 100, 1),
        row("missing events [%]", "missing", 100, 1),
    ]
    for method, column in zip(METHOD_NAMES, DIFFERENCES, strict=True):
        mark = f", mark {MARKS_MS[method]:g}" if method in MARKS_MS else ""
        start = column.removesuffix("_ms")
        cells = [
            f"{one[column]:.3f} ± {one[f'{start}_se_ms']:.3f} ({one[f'{start}_max_ms']:.3f})"
            for _, one in table.iterrows()
        ]
        rows.append([f"t_d by `{method}`: mean difference (largest){mark} [ms]", *cells])
    return markdown_table(["quantity", *(f"{d:g} s" for d in table["duration_s"])], rows)


def renderer_faults(results: Results) -> list[str]:
    """List the methods whose offsets the renderer moves by more than it may."""
    table = results.table("renderers")
    return [
        f"{column}: {size:g} ms"
        for column in DIFFERENCES
        for size in table[column]
        if not size <= RENDERER_TOLERANCE_MS
    ]


STUDIES = (
    Study(
        "fidelity",
        "Events and offsets against a reference 8 times denser in time, 962 samples per pixel",
        fidelity_cells,
        FIDELITY,
        Runs("fidelity_runs.csv", ("duration_s", "flight")),
        (Made("fidelity.csv", lambda results: fidelity_table(results.table("fidelity_runs"))),),
        numbers={"table.fidelity": page_table},
        config={
            "n_flights": {f"{key:g} s": n for key, n in N_FLIGHTS.items()},
            "first_flight": FIRST_FLIGHT,
        },
        again=False,  # minutes a recording
    ),
    Study(
        "renderers",
        "The tables' events and offsets by the native renderer against those by OpenGL",
        renderer_cells,
        FIDELITY,
        Runs("renderers_runs.csv", ("duration_s", "angle_deg", "flight")),
        (Made("renderers.csv", lambda results: fidelity_table(results.table("renderers_runs"))),),
        checks=((f"offsets differ by {RENDERER_TOLERANCE_MS:g} ms at most", renderer_faults),),
        config={"flights": RENDERER_FLIGHTS, "durations_s": DURATIONS_S, "angles_deg": ANGLES_DEG},
    ),
)
