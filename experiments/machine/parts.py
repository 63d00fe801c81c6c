"""Parts of the benchmark, each measured in a process of its own on one core, and how.

So none sees another's memory, and both GL backends can be compared. Each part is a function of a
module that is loaded where it is measured: `ssac simulate` is measured in a process that loads
what that command does, and no more.
"""

import resource
import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any, TypeVar

from experiments.lab.cell import Measure, PlainCell, RunRow, load_nothing

Result = TypeVar("Result")

PARTS: Mapping[str, tuple[str, str, tuple[Any, ...]]] = {
    **{f"render-{by}": ("simulating", "bench_render", (by,)) for by in ("native", "osmesa", "egl")},
    "sensor": ("simulating", "bench_sensor", ()),
    "recording": ("parts", "bench_recording", ()),
    "sync": ("synchronising", "bench_sync", ()),
    "reading": ("synchronising", "bench_reading", ()),
    "tables": ("tables", "bench_tables", ()),  # which has two workers
}
"""Module, function and arguments by name."""


@dataclass(frozen=True)
class Measurement:
    """A figure, what it is held against, and the mark to reach."""

    name: str
    value: float
    unit: str
    mark: float | None = None  # of the value; None: for information
    higher_is_better: bool = False

    @property
    def verdict(self) -> str:
        """Return "meets", "misses", or nothing where there is no mark."""
        if self.mark is None:
            return ""
        met = self.value >= self.mark if self.higher_is_better else self.value <= self.mark
        return "meets" if met else "misses"


def best_seconds(work: Callable[[], Result], repeats: int) -> tuple[float, Result]:
    """Least processor time [s] of a few runs after a warm-up, and the result."""
    result = work()
    seconds = []
    for _ in range(repeats):
        start = time.process_time()
        result = work()
        seconds.append(time.process_time() - start)
    return min(seconds), result


def best_rate(work: Callable[[], int], repeats: int) -> float:
    """Return how much work is done per second of processor time, at best, after a warm-up."""
    seconds, done = best_seconds(work, repeats)
    return done / seconds


def peak_memory_mb() -> float:
    """Return the most memory that this process has had."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


@dataclass(frozen=True)
class PartCell(PlainCell):
    """One part."""

    part: str


@dataclass(frozen=True)
class PartRow(RunRow):
    """What was measured."""

    measurements: list[dict[str, Any]] = field(default_factory=list)  # of `Measurement`


def part_row(cell: PartCell, _: object) -> PartRow:
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
