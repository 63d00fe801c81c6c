"""Ever longer flights before two sizes of sensor in; time and memory of both sides, out.

Each point is a real flight of the default drone: `sim` records the pair with its frames to disk,
then `ssac sync` reads it and finds offset and pose by its default method. The larger sensor has a
longer lens, so that 20 s make 9 million events a camera, and 120 s 55 million. Each step runs in a
process of its own on one core, after a smaller one that loads the kernels.
"""

import json
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from experiments.bench.measurement import Measurement, peak_memory_mb
from experiments.bench.process import in_own_process
from experiments.lab.provenance import plain
from sim.recording import SimConfig
from sim.storage import record
from ssac.errors import SsacError
from ssac.estimate import Status
from ssac.pipeline.api import Result, sync

SIMULATE, SYNCHRONISE = "simulate", "synchronise"
STEPS = (SIMULATE, SYNCHRONISE)

COLUMNS = ("sensor", "duration_s", "step", "events_per_camera", "wall_s", "cpu_s", "peak_mb",
           "status", "t_d_error_ms")  # fmt: skip
"""Of the table of points: a row for each step of each."""

DURATIONS_S = (5.0, 20.0, 60.0, 120.0)
SHORT_EVENTS = 15e6  # a camera, about: larger points are left out of a short run

MARK_EXPONENT = 1.1
MARKS_BYTES = {SYNCHRONISE: 73.0}  # of an event: 13 in the array, 60 beyond it
MARKS = {SIMULATE: 600.0, SYNCHRONISE: 60.0}  # [s] of the largest point
MARK_PEAK_MB = 6000.0  # of the same
MIN_MARKED_EVENTS = 50e6  # that the largest point has, to be held against these

T_D_S = 0.05

_HELD = {SIMULATE: 1, SYNCHRONISE: 2}  # cameras whose events are in memory at a time


class Extent(str, Enum):
    """How far the growth is followed."""

    FULL = "full"
    SHORT = "short"


@dataclass(frozen=True)
class Point:
    """One recording to make and to synchronise."""

    width_px: int
    height_px: int
    focal_px: float
    duration_s: float
    events_per_s: float  # a camera makes, about

    @property
    def sensor(self) -> str:
        """Name the sensor."""
        return f"{self.width_px} x {self.height_px}"

    @property
    def config(self) -> SimConfig:
        """Give what is simulated."""
        default = SimConfig(t_d_s=T_D_S)
        return replace(
            default,
            resolution=(self.width_px, self.height_px),
            principal_point=(self.width_px / 2, self.height_px / 2),
            focal_px=self.focal_px,
            spline=replace(default.spline, duration_s=self.duration_s),
        )


SENSORS = ((346, 260, 200.0, 0.05e6), (1280, 720, 440.0, 0.46e6))
POINTS = tuple(
    Point(width, height, focal_px, duration_s, rate)
    for width, height, focal_px, rate in SENSORS
    for duration_s in DURATIONS_S
)


DEFAULT = Extent.SHORT
"""How far `make bench` goes: the rest takes as long again."""

COMMITTED = Extent.FULL
"""How far `results/` go."""


def points_of(extent: Extent) -> tuple[Point, ...]:
    """List the points of a run, the smallest first."""
    limit = SHORT_EVENTS if extent is Extent.SHORT else np.inf
    return tuple(one for one in POINTS if one.events_per_s * one.duration_s <= limit)


def bench_command_line(extent: Extent) -> str:
    """Give the command that measures as far as that."""
    return "ssac bench" if extent is DEFAULT else f"ssac bench --growth {extent.value}"


def bench_config(extent: Extent) -> dict[str, Any]:
    """Give what the benchmark is made with, for its provenance."""
    return {"growth": plain(points_of(extent))}


def measure_growth(points: tuple[Point, ...], say: Callable[[str], None]) -> pd.DataFrame:
    """Measure each point: a row for each of its steps, with what went wrong as its `status`."""
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        smallest = Path(folder) / "smallest"
        for point in points:
            pair = Path(folder) / "pair" if smallest.exists() else smallest
            for step in STEPS:
                say(f"measuring growth, {point.sensor}, {point.duration_s:g} s: {step} ...")
                rows.append(_row(point, step, pair, smallest))
            rows[-1]["events_per_camera"] = rows[-2]["events_per_camera"]
            if pair != smallest:
                for path in pair.glob("*"):
                    path.unlink()
    return pd.DataFrame(rows)


def growth_rows(table: pd.DataFrame) -> list[Measurement]:
    """Sum up `measure_growth`: the largest point, and how time and memory grow up to it."""
    is_ok = table["status"] == Status.OK.value
    rows = [
        Measurement(f"growth, {row.sensor}, {row.duration_s:g} s, {row.step}: {row.status}",
                    float("nan"), "")
        for row in table[~is_ok].itertuples()
    ]  # fmt: skip
    table = table[is_ok]
    for (sensor, step), of_step in table.groupby(["sensor", "step"], sort=False):
        if len(of_step) < 2:
            continue
        events, name = of_step["events_per_camera"], f"growth, {sensor}: {step}"
        value = exponent(events, of_step["cpu_s"])  # what others take meanwhile is not in it
        rows.append(Measurement(f"{name}, time over events", value, "exponent", MARK_EXPONENT))
        if sensor != table["sensor"].iloc[-1]:  # what start-up takes hides so few events
            continue
        value = exponent(events, of_step["peak_mb"])
        rows.append(Measurement(f"{name}, memory over events", value, "exponent", MARK_EXPONENT))
        value, mark = _bytes_of_event(of_step), MARKS_BYTES.get(str(step))
        rows.append(Measurement(f"{name}, memory of an event", value, "B", mark))
    return rows + _largest(table)


def exponent(events: ArrayLike, values: ArrayLike) -> float:
    """Slope of a straight line through the logarithms of both: 1 where one is linear in the other.

    What does not grow, as start-up does not, makes it smaller.
    """
    return float(np.polyfit(np.log(events), np.log(values), 1)[0])


def _bytes_of_event(of_step: pd.DataFrame) -> float:
    """Peak memory that an event more takes, from the smallest point to the largest [B]."""
    ends = of_step.sort_values("events_per_camera").iloc[[0, -1]]
    held = _HELD[str(of_step["step"].iloc[0])] * np.diff(ends["events_per_camera"])
    return float(np.diff(ends["peak_mb"])[0] * 2**20 / held[0])


def _largest(table: pd.DataFrame) -> list[Measurement]:
    """Hold the largest point against its marks, if it is as large as these are meant for."""
    if table.empty:
        return []
    most = table["events_per_camera"].max()
    of_point = table[table["events_per_camera"] == most]
    is_marked = most >= MIN_MARKED_EVENTS
    rows = [Measurement("growth, largest pair: events per camera", float(most), "events")]
    for one in of_point.to_dict("records"):
        name, step = "growth, largest pair", one["step"]
        mark_s, mark_mb = (MARKS[step], MARK_PEAK_MB) if is_marked else (None, None)
        rows += [
            Measurement(f"{name}: {step}", one["wall_s"], "s", mark_s),
            Measurement(f"{name}: {step}, peak memory", one["peak_mb"], "MB", mark_mb),
        ]
    error_ms = table["t_d_error_ms"].max()
    if np.isfinite(error_ms):
        rows.append(Measurement("growth: largest error of t_d", float(error_ms), "ms"))
    return rows


def _row(point: Point, step: str, pair: Path, smallest: Path) -> dict[str, Any]:
    """Measure one step of a point in a process of its own."""
    row = {
        **dict.fromkeys(COLUMNS, np.nan),
        "sensor": point.sensor,
        "duration_s": point.duration_s,
        "step": step,
    }
    arguments = json.dumps(plain(point)), step, str(pair), str(smallest)
    try:
        made: dict[str, Any] = in_own_process("experiments.bench.growth", *arguments)
    except SsacError as error:
        made = {"status": f"not measured ({error})"}
    return row | made


def _measured(point: Point, step: str, pair: Path, smallest: Path) -> dict[str, Any]:
    """Take one step of a point in this process."""
    with tempfile.TemporaryDirectory() as folder:
        if step == SIMULATE:
            short = replace(POINTS[0], duration_s=1.0).config
            record(short, 0, Path(folder) / "short", {})
        else:
            _sync(smallest)
    wall_s, cpu_s = time.perf_counter(), time.process_time()
    if step == SIMULATE:
        recorded = record(point.config, 0, pair, {})
        made: dict[str, Any] = {"events_per_camera": float(np.mean(recorded.n_events))}
        made["status"] = Status.OK.value
    else:
        estimate = _sync(pair).estimate
        made = {"status": str(estimate.status)}
        if estimate.status == Status.OK:
            made["t_d_error_ms"] = 1e3 * abs(estimate.t_d_s - T_D_S)
    return made | {
        "wall_s": time.perf_counter() - wall_s,
        "cpu_s": time.process_time() - cpu_s,
        "peak_mb": peak_memory_mb(),
    }


def _sync(folder: Path) -> Result:
    return sync(folder / "cam1.h5", folder / "cam2.h5", folder / "rig.yaml")


if __name__ == "__main__":
    of_point, step_name, *paths = sys.argv[1:]
    made = _measured(Point(**json.loads(of_point)), step_name, *map(Path, paths))
    print(json.dumps(made))
