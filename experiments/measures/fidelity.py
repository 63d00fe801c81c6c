"""Flights in; how their recordings and those of another rendering differ, out.

The other is far denser in time and space, or it is drawn with OpenGL.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from experiments.lab.cache import Cache
from experiments.lab.cell import Flight, FlightCell, Measure
from experiments.lab.recorded import Pair, recorded_pair
from sim.recording import SimConfig
from sim.render.config import RenderConfig, SamplingConfig
from sim.render.lattice import Lattice
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


FIDELITY = Measure(load_both, fidelity_row, FidelityRow)


def compare_events(events: NDArray[Any], reference: NDArray[Any]) -> EventFidelity:
    """Match events with those of the reference and sum up how they differ.

    Parameters
    ----------
    events, reference
        EVENT_DTYPE, of the same scene.
    """
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
