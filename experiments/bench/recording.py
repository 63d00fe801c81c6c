"""The default 20 s pair in, time and memory of `ssac simulate` for it out.

Run as a module it loads what that command loads, and so measures its memory: not that of the other
parts of the benchmark, and of what writes and draws their tables.
"""

import json
import tempfile
import time
from dataclasses import asdict
from pathlib import Path

from experiments.bench.measurement import Measurement, peak_memory_mb
from experiments.scenes.simulate import record_with_progress
from sim.recording import SimConfig
from sim.scene.trajectory import SplineConfig


def bench_recording() -> list[Measurement]:
    """Wall time and peak memory of the default 20 s pair, frames and writing it included."""
    short = SimConfig(spline=SplineConfig(duration_s=1.0))
    with tempfile.TemporaryDirectory() as folder:
        record_with_progress(short, 0, Path(folder) / "short")  # loads the kernels
        start = time.perf_counter()
        recorded = record_with_progress(SimConfig(), 0, Path(folder) / "pair")
        seconds = time.perf_counter() - start
    instants, events = recorded.flight.n_instants, sum(recorded.n_events)
    return [
        Measurement("simulate a 20 s pair, frames included", seconds, "s", 3.0),
        Measurement("simulate a 20 s pair: instants", instants, "instants"),
        Measurement("simulate a 20 s pair: events", events, "events"),
        Measurement("simulate a 20 s pair: peak memory", peak_memory_mb(), "MB", 450.0),
    ]


if __name__ == "__main__":
    print(json.dumps([asdict(row) for row in bench_recording()]))
