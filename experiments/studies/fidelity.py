"""How true the default recordings are: the same flights against another rendering.

`fidelity` compares with a far denser one, on the flights 200, 201, ... of each duration at 90 deg.
`renderers` compares both renderers, on the tables' first flights of each duration and angle; its
`tangency` is without a body.
"""

from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np
import pandas as pd
from numba import njit
from numpy.typing import NDArray

from experiments.lab.cache import Cache
from experiments.lab.cell import Flight, FlightCell, Measure, RunRow, load_nothing
from experiments.lab.recorded import recorded_pair
from experiments.lab.results import Results
from experiments.lab.study import Runs, Study
from experiments.lab.summary import answered, by_group, made_of, markdown_table, shown
from experiments.lab.verify import no_row
from experiments.paper.esim import ANGLES_DEG, DURATIONS_S, drawn
from sim.recording import SimConfig
from sim.render.config import SamplingConfig
from sim.render.lattice import Lattice
from sim.scene.trajectory import SplineConfig
from sim.sensor.frames import FrameConfig
from ssac.arrays import IntArray
from ssac.config import Config
from ssac.rules import DEFAULT_RULES, TangencyRules

SHARES = ("median_us", "p95_us", "spurious", "missing")
METHOD_NAMES = ("ssac", "ssac-known", "joint", "tangency")
DIFFERENCES = tuple(f"{name.replace('-', '_')}_t_d_difference_ms" for name in METHOD_NAMES)
"""Columns of the methods' differences of t_d; means are of their absolute values."""

DENSER = 8  # times as many instants in the reference
REFERENCE_LATTICE = Lattice(31, 1)  # 962 samples per pixel, none of them where ours are
MATCH_WINDOW_US = 5000  # events of a pixel and polarity further apart do not match: 1 px here

FIRST_FLIGHT = 200
N_FLIGHTS = {10.0: 10, 20.0: 10}  # flights of each duration [s]
RENDERER_FLIGHTS = 1  # of each duration and angle
MARKS = {
    "median_us": 100.0, "p95_us": 1000.0, "spurious": 0.05, "ssac_t_d_difference_ms": 0.02,
    "joint_t_d_difference_ms": 0.02, "tangency_t_d_difference_ms": 0.015,
}  # fmt: skip
"""The means, of differences those of absolute values, are to be at most this; by column."""

RENDERER_TOLERANCE_MS = 0.005
"""Most that t_d may differ by between renderers: half a last digit of the paper's t_d."""

TANGENTS_ALONE = Config(rules=replace(DEFAULT_RULES, tangency=TangencyRules(joins_body=False)))
"""With a rigid body a few events more or less move the offset by more than renderers do."""

T_D_S = 0.05


@dataclass(frozen=True)
class FidelityCell(FlightCell):
    """A flight with an offset, which is simulated twice."""

    reference: SimConfig  # of the same scene, rendered otherwise
    estimator: Config | None = None

    @property
    def recordings(self) -> tuple[Flight, ...]:
        """The recording, and its reference."""
        return ((self.sim, self.seed), (self.reference, self.seed))


@dataclass(frozen=True)
class FidelityRow(RunRow):
    """How events, matched by pixel and polarity, and offsets differ from the reference's.

    Numbers and shares are the mean of both cameras.
    """

    n_reference: int = 0
    median_us: float = np.nan  # of the distance in time between an event and its counterpart
    p95_us: float = np.nan
    spurious: float = np.nan  # share of the events that have no counterpart in the reference
    missing: float = np.nan  # share of the reference's events that have no counterpart
    ssac_t_d_difference_ms: float = np.nan
    ssac_known_t_d_difference_ms: float = np.nan
    joint_t_d_difference_ms: float = np.nan
    tangency_t_d_difference_ms: float = np.nan


def reference_config(config: SimConfig) -> SimConfig:
    """Return the same scene, far denser in time and samples; OpenGL cannot check as many."""
    step_px, rate_hz = config.sampling.max_step_px, config.sampling.min_rate_hz
    sampling = SamplingConfig(max_step_px=step_px / DENSER, min_rate_hz=rate_hz * DENSER)
    render = replace(config.render, lattice=REFERENCE_LATTICE, check=False)
    return replace(config, sampling=sampling, render=render)


def fidelity_row(cell: FidelityCell, cache: Cache) -> FidelityRow:
    """Compare a recording with its reference."""
    both = [recorded_pair(cache, *flight) for flight in cell.recordings]
    cameras = zip(both[0][:2], both[1][:2], strict=True)
    each = [compare_events(ours.events, theirs.events) for ours, theirs in cameras]
    # Only a method that needs the true pose is given it.
    ours, theirs = (pair.chain(cell.estimator) for pair in both)
    n_reference, *shares = (
        float(np.mean([getattr(camera, name) for camera in each]))
        for name in ("n_reference", *SHARES)
    )
    differences_ms = [
        1e3 * ours.estimate(name).t_d_s - 1e3 * theirs.estimate(name).t_d_s for name in METHOD_NAMES
    ]
    return FidelityRow("ok", "", round(n_reference), *shares, *differences_ms)


def compare_events(events: NDArray[Any], reference: NDArray[Any]) -> FidelityRow:
    """Match events (n,) of EVENT_DTYPE with those of the reference, and sum up how they differ."""
    keys = [_sort_by_pixel(e) for e in (events, reference)]
    difference_us = _match(*keys[0], *keys[1], MATCH_WINDOW_US)
    n_matched = len(difference_us)
    return FidelityRow(
        "ok",
        n_reference=len(reference),
        median_us=float(np.median(difference_us)),
        p95_us=float(np.percentile(difference_us, 95)),
        spurious=1.0 - n_matched / len(events),
        missing=1.0 - n_matched / len(reference),
    )


def _sort_by_pixel(events: NDArray[Any]) -> tuple[IntArray, IntArray]:
    """Return (pixel and polarity as one number, time [us]), sorted by both."""
    pixel = (events["y"].astype(np.int64) << 17) | (events["x"].astype(np.int64) << 1) | events["p"]
    order = np.lexsort((events["t"], pixel))
    return pixel[order], events["t"][order]


@njit(cache=True)
def _match(
    pixel_a: IntArray, t_a: IntArray, pixel_b: IntArray, t_b: IntArray, window_us: int
) -> IntArray:
    """Match two sorted lists by pixel and time; return the time differences of matches [us]."""
    differences = np.empty(min(t_a.size, t_b.size), np.int64)
    i = j = n = 0
    while i < t_a.size and j < t_b.size:
        is_same = pixel_a[i] == pixel_b[j]
        if is_same and abs(t_a[i] - t_b[j]) <= window_us:
            differences[n] = abs(t_a[i] - t_b[j])
            n += 1
            i += 1
            j += 1
        elif pixel_a[i] < pixel_b[j] or (is_same and t_a[i] < t_b[j]):
            i += 1
        else:
            j += 1
    return differences[:n]


def fidelity_cells() -> list[FidelityCell]:
    """List the flights."""
    cells = []
    for duration_s, n in N_FLIGHTS.items():
        frames = FrameConfig(rate_hz=0.0)
        sim = SimConfig(spline=SplineConfig(duration_s), frames=frames, t_d_s=T_D_S)
        cells += _beside(sim, FIRST_FLIGHT, n, reference_config(sim))
    return cells


def renderer_cells() -> list[FidelityCell]:
    """List the tables' first flights of each duration and angle, RENDERER_FLIGHTS of them."""
    cells = []
    for duration_s, angle_deg in product(DURATIONS_S, ANGLES_DEG):
        sim = SimConfig(angle_deg=angle_deg, spline=SplineConfig(duration_s), t_d_s=T_D_S)
        by_opengl = replace(sim, render=replace(sim.render, renderer="pyrender"))
        cells += _beside(sim, 0, RENDERER_FLIGHTS, by_opengl)
    return [replace(cell, estimator=TANGENTS_ALONE) for cell in cells]


def _beside(sim: SimConfig, first: int, n: int, other: SimConfig) -> list[FidelityCell]:
    flights = drawn(sim, range(first, first + n))
    return [FidelityCell(sim, flight, seed, other) for flight, seed in flights]


@by_group("duration_s")
def fidelity_table(group: pd.DataFrame) -> dict[str, Any]:
    """Sum up the flights of each duration: means of how events differ, and |differences| of t_d."""
    ok = answered(group)
    row: dict[str, Any] = {"n_runs": len(group), "failed": len(group) - len(ok)}
    row |= {"n_reference": round(ok["n_reference"].mean()) if len(ok) else 0}
    row |= {name: ok[name].mean() for name in SHARES}
    for name in DIFFERENCES:
        sizes, start = ok[name].abs(), name.removesuffix("_ms")
        row |= {name: sizes.mean(), f"{start}_se_ms": sizes.sem()}
        row[f"{start}_max_ms"] = sizes.max()
    return row


def page_table(results: Results) -> str:
    """Say how far events and offsets are from those of the reference, by duration [s]."""
    table = results.table("fidelity")
    lines = {
        "flights": "{answered}",
        "event times, median [us]": "{median_us:.0f}",
        "event times, 95th percentile [us]": "{p95_us:.0f}",
        "spurious events [%]": "{spurious:.1f}",
        "missing events [%]": "{missing:.1f}",
    }
    for method, column in zip(METHOD_NAMES, DIFFERENCES, strict=True):
        mark = f", mark {MARKS[column]:g}" if column in MARKS else ""
        se, most = (column.replace("_ms", f"_{name}_ms") for name in ("se", "max"))
        heading = f"t_d by `{method}`: mean difference (largest){mark} [ms]"
        lines[heading] = f"{{{column}:.3f}} ± {{{se}:.3f}} ({{{most}:.3f}})"
    percent = {name: 100 * table[name] for name in ("spurious", "missing")}
    texts = shown(table.assign(answered=table["n_runs"] - table["failed"], **percent), lines)
    texts.index = table["duration_s"].map("{:g} s".format)
    return markdown_table(texts.T.reset_index(names="quantity"))


def verdict(results: Results) -> str:
    """Say whether all marks are met at all durations, or which columns are not."""
    table = results.table("fidelity")
    missed = [column for column, most in MARKS.items() if not (table[column] <= most).all()]
    return f"**not met** ({', '.join(missed)})" if missed else "met"


_MEASURE = Measure(load_nothing, fidelity_row, FidelityRow)
_APART = " or ".join(f"not {one} <= {RENDERER_TOLERANCE_MS}" for one in DIFFERENCES)
_ALIKE = f"offsets differ by {RENDERER_TOLERANCE_MS:g} ms at most", no_row("renderers", _APART)

STUDIES = (
    Study(
        "fidelity",
        "Events and offsets against a reference 8 times denser in time, 962 samples per pixel",
        fidelity_cells,
        _MEASURE,
        Runs("fidelity_runs.csv", ("duration_s", "flight")),
        (made_of("fidelity.csv", fidelity_table, "fidelity_runs"),),
        numbers={"table.fidelity": page_table, "fidelity.verdict": verdict},
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
        _MEASURE,
        Runs("renderers_runs.csv", ("duration_s", "angle_deg", "flight")),
        (made_of("renderers.csv", fidelity_table, "renderers_runs"),),
        checks=(_ALIKE,),
        config={
            "flights": RENDERER_FLIGHTS,
            "durations_s": DURATIONS_S,
            "angles_deg": ANGLES_DEG,
            "joins_body": False,
        },
    ),
)
