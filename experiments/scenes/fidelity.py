"""How true the default recordings are: the same flights against a far denser rendering."""

import time
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import joblib
import numpy as np
import pandas as pd
import typer
from numba import njit
from numpy.typing import NDArray

from experiments.run.bridge import observations, rig_of
from experiments.run.provenance import save_provenance
from sim.recording import SimConfig, simulate
from sim.render.gl_context import open_context
from sim.render.instants import SamplingConfig
from sim.render.lattice import Lattice
from sim.render.renderer import RenderConfig
from sim.sensor.frames import FrameConfig
from ssac.files.whole_file import whole_file
from ssac.methods.algorithms import ssac, ssac_known
from ssac.methods.joint import joint

METHODS = {"ssac": ssac, "ssac-known": ssac_known, "joint": joint}
DENSER = 16  # times as many instants in the reference
REFERENCE_LATTICE = Lattice(16, 1)  # 257 samples per pixel
MATCH_WINDOW_US = 5000  # events of one pixel and polarity further apart are not the same: 1 px here


@dataclass(frozen=True)
class EventFidelity:
    """Events compared with those of the reference, by pixel and polarity."""

    n_reference: int
    median_us: float  # of the distance in time between an event and its counterpart
    p95_us: float
    spurious: float  # share of the events that have no counterpart in the reference
    missing: float  # share of the reference's events that have no counterpart


def reference_config(config: SimConfig) -> SimConfig:
    """Return the same scene, rendered 16 times more densely in time with 257 samples per pixel."""
    sampling = SamplingConfig(
        max_step_px=config.sampling.max_step_px / DENSER,
        min_rate_hz=config.sampling.min_rate_hz * DENSER,
    )
    render: RenderConfig = replace(config.render, lattice=REFERENCE_LATTICE)
    return replace(config, sampling=sampling, render=render)


def fidelity_command(
    seeds: Annotated[int, typer.Option(help="Flights to compare.")] = 10,
    duration: Annotated[float, typer.Option(help="Of a flight [s].")] = 20.0,
    jobs: Annotated[int, typer.Option(help="Processes.")] = 2,
    out: Annotated[Path, typer.Option(help="CSV to write.")] = Path("results/fidelity.csv"),
) -> None:
    """Compare default recordings with a reference 16 times denser in time, 257 samples per pixel.

    Each row is one flight: how its events differ from the reference's, and how far the offsets that
    the methods estimate from the two lie apart. About 10 minutes of one core a flight.
    """
    start = time.perf_counter()
    config = SimConfig(
        spline=replace(SimConfig().spline, duration_s=duration),
        frames=FrameConfig(rate_hz=0.0),
        t_d_s=0.05,
    )
    rows = joblib.Parallel(n_jobs=jobs, return_as="generator")(
        joblib.delayed(fidelity_row)(config, seed) for seed in range(seeds)
    )
    table = []
    for row in rows:
        table.append(row)
        typer.echo(f"flight {len(table)} of {seeds}: {row}", err=True)
    frame = pd.DataFrame(table)
    out.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(out) as temporary:
        frame.to_csv(temporary, index=False, float_format="%.6g")
    command = f"ssac fidelity --seeds {seeds} --duration {duration:g}"
    save_provenance(out, command, config, time.perf_counter() - start, open_context())
    typer.echo(frame.drop(columns="seed").abs().mean().to_string())


def fidelity_row(config: SimConfig, seed: int) -> dict[str, float]:
    """Compare one flight with its reference: event differences, and offsets [ms] of all methods."""
    recording = simulate(config, seed)
    reference = simulate(reference_config(config), seed)
    pairs = zip(recording.cameras, reference.cameras, strict=True)
    each = [asdict(compare_events(ours.events, theirs.events)) for ours, theirs in pairs]
    row: dict[str, float] = {"seed": seed}
    row |= {name: float(np.mean([camera[name] for camera in each])) for name in each[0]}
    for name, method in METHODS.items():
        offsets_s = [
            method(*observations(r), rig_of(r, with_extrinsics=name == "ssac-known")).t_d_s
            for r in (recording, reference)
        ]
        row[f"{name}_t_d_difference_ms"] = 1e3 * (offsets_s[0] - offsets_s[1])
    return row


def compare_events(events: NDArray[Any], reference: NDArray[Any]) -> EventFidelity:
    """Match events with those of the reference and sum up how they differ.

    Parameters
    ----------
    events, reference : NDArray
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


def _sort_by_pixel(events: NDArray[Any]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return (pixel and polarity as one number, time [us]), sorted by both."""
    pixel = (events["y"].astype(np.int64) << 17) | (events["x"].astype(np.int64) << 1) | events["p"]
    order = np.lexsort((events["t"], pixel))
    return pixel[order], events["t"][order]


@njit(cache=True)
def _match(pixel_a, t_a, pixel_b, t_b, window_us):  # type: ignore[no-untyped-def]
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
