"""Parts of the benchmark, each of which is measured in a process of its own on one core.

So none sees another's memory, and both GL backends can be compared. Each part is a function of a
module that is loaded where it is measured, and not before.
"""

import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any

from experiments.lab.cell import Measure
from experiments.machine.measurement import Measurement, peak_memory_mb

PARTS: Mapping[str, tuple[str, str, tuple[Any, ...]]] = {
    **{f"render-{by}": ("render", "bench_render", (by,)) for by in ("native", "osmesa", "egl")},
    "sensor": ("sensor", "bench_sensor", ()),
    "recording": ("parts", "bench_recording", ()),
    "sync": ("sync", "bench_sync", ()),
    "reading": ("reading", "bench_reading", ()),
    "tables": ("tables", "bench_tables", ()),  # which has two workers
}
"""Module, function and arguments by name."""


@dataclass(frozen=True)
class PartCell:
    """One part."""

    part: str

    recordings = ()

    @property
    def columns(self) -> dict[str, Any]:
        """Columns that say which part it is."""
        return {"part": self.part}

    @property
    def inputs(self) -> str:
        """What it depends on beside the machine."""
        return self.part


@dataclass(frozen=True)
class PartRow:
    """What was measured."""

    status: str
    reason: str = ""
    measurements: list[dict[str, Any]] = field(default_factory=list)  # of `Measurement`


def load_nothing(cells: Sequence[PartCell], cache: object) -> None:
    """Parts share nothing."""


def part_row(cell: PartCell, _: None) -> PartRow:
    """Measure a part."""
    module, function, arguments = PARTS[cell.part]
    measure = getattr(import_module(f"experiments.machine.{module}"), function)
    return PartRow("ok", "", [asdict(one) for one in measure(*arguments)])


PART = Measure(load_nothing, part_row, PartRow)


def bench_recording() -> list[Measurement]:
    """Wall time and peak memory of the default 20 s pair, frames and writing it included."""
    from experiments.scenes.simulate import record_with_progress
    from sim.recording import SimConfig
    from sim.scene.trajectory import SplineConfig

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
