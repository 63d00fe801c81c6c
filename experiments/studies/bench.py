"""Speed and memory, as ratios side by side in one run, and how they grow with the recording.

Each part and each step runs in a process of its own on one core (the tables: on two). The growth is
summed up in the benchmark's last rows.
"""

from collections.abc import Iterator
from dataclasses import asdict
from functools import partial
from typing import Annotated, Any, Literal

import numpy as np
import pandas as pd
import typer
from numpy.typing import ArrayLike

from experiments.drawing.style import Axes, Figure, legend_below, panels
from experiments.lab.command import command_of
from experiments.lab.markdown import markdown_table
from experiments.lab.results import Results
from experiments.lab.study import How, Runs, Study
from experiments.lab.summary import answered, made_of
from experiments.machine.growth import POINTS, SIMULATE, STEP, STEPS, SYNCHRONISE, Point, StepCell
from experiments.machine.parts import PART, PARTS, Measurement, PartCell
from ssac.estimate import Status

SHORT_EVENTS = 15e6  # a camera, about: larger points are left out of a short run

MARK_EXPONENT = 1.1
MARKS_BYTES = {SYNCHRONISE: 73.0}  # of an event: 13 in the array, 60 beyond it
MARKS_S = {SIMULATE: 600.0, SYNCHRONISE: 60.0}  # of the largest point
MARK_PEAK_MB = 6000.0  # of the same
MIN_MARKED_EVENTS = 50e6  # that the largest point has, to be held against these

_HELD = {SIMULATE: 1, SYNCHRONISE: 2}  # cameras whose events are in memory at a time


Extent = Literal["full", "short"]
"""How far the growth is followed."""


def points_of(extent: Extent) -> list[Point]:
    """List the points of a run, the smallest first."""
    limit = SHORT_EVENTS if extent == "short" else np.inf
    return [one for one in POINTS if one.events_per_s * one.duration_s <= limit]


COMMITTED: dict[str, Extent] = {"growth": "full"}
"""How far `results/` go; the rest takes as long again as the short run of `make bench`."""

Growth = Annotated[
    Extent, typer.Option(help="Largest pair: 50 million events per camera (full), or 10 (short).")
]


def growth_cells(growth: Growth = "short") -> list[StepCell]:
    """List the steps of each point."""
    return [StepCell(point, step) for point in points_of(growth) for step in STEPS]


def growth_table(rows: pd.DataFrame, _: Results) -> pd.DataFrame:
    """Say of each step how many events its recording has, and why it was not measured."""
    failed = rows["reason"].fillna("").astype(str) != ""
    status = rows["status"].mask(failed, "not measured (" + rows["reason"].astype(str) + ")")
    return rows.assign(events_per_camera=rows["events_per_camera"].ffill(), status=status)


def part_cells(growth: Growth = "short") -> list[PartCell]:
    """List the parts; the growth is another study of the same command."""
    del growth
    return [PartCell(part) for part in PARTS]


def bench_table(rows: pd.DataFrame, results: Results) -> pd.DataFrame:
    """Lay out what the parts measured, then how time and memory grow."""
    measured: list[Measurement] = []
    for row in rows.to_dict("records"):
        if row["status"] == "ok":
            measured += [Measurement(**one) for one in row["measurements"]]
        else:
            measured.append(_missing(f"{row['part']}: not measured ({row['reason']})"))
    measured += growth_rows(results.table("bench_growth"))
    return pd.DataFrame([asdict(one) | {"verdict": one.verdict} for one in measured])


def _missing(name: str) -> Measurement:
    return Measurement(name, float("nan"), "")


def growth_rows(table: pd.DataFrame) -> list[Measurement]:
    """Sum up the steps: the largest point, and how time and memory grow up to it."""
    rows = [
        _missing(f"growth, {row.sensor}, {row.duration_s:g} s, {row.step}: {row.status}")
        for row in table[table["status"] != "ok"].itertuples()
    ]
    table = answered(table)
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
    return [*rows, *_largest(table)]


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


def _largest(table: pd.DataFrame) -> Iterator[Measurement]:
    """Hold the largest point against its marks, if it is as large as these are meant for."""
    if table.empty:
        return
    most, name = table["events_per_camera"].max(), "growth, largest pair"
    is_marked = most >= MIN_MARKED_EVENTS
    yield Measurement(f"{name}: events per camera", float(most), "events")
    for one in table[table["events_per_camera"] == most].to_dict("records"):
        mark_s, mark_mb = (MARKS_S[one["step"]], MARK_PEAK_MB) if is_marked else (None, None)
        yield Measurement(f"{name}: {one['step']}", one["wall_s"], "s", mark_s)
        yield Measurement(f"{name}: {one['step']}, peak memory", one["peak_mb"], "MB", mark_mb)
    error_ms = table["t_d_error_ms"].max()
    if np.isfinite(error_ms):
        yield Measurement("growth: largest error of t_d", float(error_ms), "ms")


_WHAT = {"wall_s": "time [s]", "peak_mb": "peak memory [MB]"}
_GUIDE: dict[str, Any] = {"color": "0.7", "lw": 1.0, "ls": ":", "zorder": 1}


def growth_figure(table: pd.DataFrame) -> Figure:
    """Draw time and memory on logarithmic axes: the smaller sensor's points are hollow."""
    from matplotlib.lines import Line2D

    looks: dict[str, dict[str, Any]] = {SIMULATE: {"color": "#0072B2", "marker": "o"},
             SYNCHRONISE: {"color": "#000000", "marker": "D"}}  # fmt: skip
    figure, (both,) = panels("How run time and memory grow with the recording", 4.4, columns=2)
    measured = table[table["wall_s"].notna()]
    sensors = list(dict.fromkeys(measured["sensor"]))
    for axes, (column, label) in zip(both, _WHAT.items(), strict=True):
        axes.set(xscale="log", yscale="log", xlabel="events of a camera", ylabel=label)
        axes.grid(color="0.92", lw=0.6)
        axes.set_axisbelow("line")  # the guide is below the grid
        for step, look in looks.items():
            for sensor in sensors:
                here = measured[(measured["step"] == step) & (measured["sensor"] == sensor)]
                face = look["color"] if sensor == sensors[-1] else "white"
                line: dict[str, Any] = {**look, "mfc": face, "ms": 5, "lw": 1.2, "zorder": 3}
                axes.plot(here["events_per_camera"], here[column], **line)
        if len(measured):
            _draw_guide(axes, measured, column)
    handles = [Line2D([], [], ms=5, lw=1.2, label=step, **look) for step, look in looks.items()]
    for sensor in sensors:
        face = "0.3" if sensor == sensors[-1] else "white"
        handles.append(Line2D([], [], color="0.3", marker="o", ms=5, lw=0, label=sensor, mfc=face))
    handles.append(Line2D([], [], label="linear in the events", **_GUIDE))
    legend_below(figure, 5, handles)
    return figure


def _draw_guide(axes: Axes, measured: pd.DataFrame, column: str) -> None:
    """Draw a line of slope one through the largest value."""
    top = measured.loc[measured[column].idxmax()]
    events = np.array([measured["events_per_camera"].min(), top["events_per_camera"]])
    bottom, highest = axes.get_ylim()
    axes.plot(events, float(top[column]) * events / events[1], **_GUIDE)
    axes.set_ylim(bottom, highest)


def bench_faults(results: Results) -> list[str]:
    """Check shape and ranges: what was measured cannot be made again."""
    table = results.table("bench")
    columns = [*Measurement.__dataclass_fields__, "verdict"]
    if list(table) != columns:
        return [f"its columns are {', '.join(map(str, table))}; expected {', '.join(columns)}"]
    if table.empty:
        return ["it is empty"]
    faults = []
    for row in table.astype(object).replace({np.nan: None}).to_dict("records"):
        verdict = row.pop("verdict") or ""
        one = Measurement(**{str(name): value for name, value in row.items()})
        if not 0.0 < (one.value or np.nan) < np.inf:
            faults.append(f"{one.name} is {one.value}")
        if not one.unit:
            faults.append(f"{one.name} has no unit")
        if one.verdict != verdict:
            faults.append(f"{one.name} is {one.value:g}, so it is not so that it {verdict}")
    return [*faults, *_unlike_growth(results)]


def _unlike_growth(results: Results) -> list[str]:
    """Check that the benchmark's last rows sum the growth up."""
    summed, table = growth_rows(results.table("bench_growth")), results.table("bench")
    last = table.tail(len(summed))
    if list(last["name"]) != [row.name for row in summed]:
        return ["the last rows of bench.csv are not those of bench_growth.csv"]
    if not np.allclose(last["value"], [row.value for row in summed], rtol=1e-5):  # of six digits
        return ["the last rows of bench.csv do not follow from bench_growth.csv"]
    return []


def growth_faults(results: Results) -> list[str]:
    """Check that both steps of each point were measured, and that the pair was synchronised."""
    table = results.table("bench_growth")
    expected = [list(cell.columns.values()) for cell in growth_cells(**COMMITTED)]
    if table[["sensor", "duration_s", "step"]].to_numpy().tolist() != expected:
        return [f"its steps are not the {len(expected)} of today's benchmark"]
    faults = _unlike_growth(results)
    for row in table.to_dict("records"):
        name = f"{row['sensor']}, {row['duration_s']:g} s, {row['step']}"
        if row["status"] != Status.OK.value:
            faults.append(f"{name}: {row['status']}")
        faults += [
            f"{name}: {column} is {row[column]}"
            for column in ("events_per_camera", "wall_s", "cpu_s", "peak_mb")
            if not 0.0 < float(row[column]) < np.inf
        ]
    return faults


_SHOWN = {
    # row of bench.csv: unit, decimals and the words for it
    "render, native, 257 samples per pixel: crops": ("poses/s", 0, "rendering, native"),
    "render, native, 257 samples per pixel: ratio to OpenGL's crops": ("x", 1, "... over OpenGL"),
    "render, native, 257 samples per pixel: ratio": ("x", 0, "... over pyrender alike"),
    "render, native, 64 samples per pixel: ratio to it": (
        "x", 0, "64 samples, over pyrender untouched",
    ),
    "render, osmesa, 257 samples per pixel: crops": ("poses/s", 0, "rendering, OSMesa"),
    "render, osmesa, 257 samples per pixel: ratio": ("x", 0, "the same, over pyrender alike"),
    "render, egl, 257 samples per pixel: crops": ("poses/s", 0, "rendering, EGL"),
    "render, egl, 257 samples per pixel: ratio": ("x", 0, "the same, over pyrender alike"),
    "sensor, 346 x 260 float frames": ("frames/s", 0, "sensor model, full frames"),
    "sensor over eventify-dvs": ("x", 1, "... over eventify-dvs' NumPy"),
    "sensor over ESIM's core, quoted": ("x", 2, "... over ESIM's C++, as quoted"),
    "simulate a 20 s pair, frames included": ("s", 1, "a pair of 20 s simulated"),
    "simulate a 20 s pair: peak memory": ("MB", 0, "its memory"),
    "sync, ssac: all but reading": ("s", 2, "`ssac` on a pair of 20 s"),
    "sync, joint: all but reading": ("s", 2, "`joint` on it"),
    "sync, tangency: all but reading": ("s", 2, "`tangency` on it"),
    "sync, stage: reading": ("s", 2, "of this, first: reading"),
    "sync, stage: checks and denoising": ("s", 2, "checks and denoising"),
    "sync, stage: tracks": ("s", 2, "tracks"),
    "sync, stage: search over +-1 s": ("s", 2, "search over 2 s"),
    "sync, stage: joint refinement": ("s", 2, "`joint`'s refinement"),
    "sync, stage: tangency refinement": ("s", 2, "`tangency`'s refinement"),
    "read 10 M events, .h5: ratio": ("x", 2, "reading HDF5, over h5py"),
    "read 10 M events, .aedat4: ratio": ("x", 2, "reading AEDAT4, over faery"),
    "read 10 M events, .raw: ratio": ("x", 2, "reading RAW, over faery"),
    "tables: recordings": ("", 0, "recordings of the tables"),
    "tables, from nothing: all, 2 workers": ("s", 0, "the tables from nothing"),
    "tables, recordings cached: all, 2 workers": ("s", 0, "... recordings cached"),
    "tables, from nothing: 1 -> 2 workers": ("x", 2, "two workers over one"),
    "tables: peak memory of a worker": ("MB", 0, "memory of a worker"),
    "growth, largest pair: events per camera": ("events", 0, "the largest pair: events a camera"),
    "growth, largest pair: simulate": ("s", 0, "simulated"),
    "growth, largest pair: simulate, peak memory": ("MB", 0, "... memory"),
    "growth, largest pair: synchronise": ("s", 1, "synchronised"),
    "growth, largest pair: synchronise, peak memory": ("MB", 0, "... memory"),
    "growth, 1280 x 720: simulate, time over events": ("exponent", 2, "growth: simulating, time"),
    "growth, 1280 x 720: synchronise, time over events": ("exponent", 2, "... synchronising, time"),
    "growth, 1280 x 720: synchronise, memory over events": ("exponent", 2, "... and memory"),
}  # fmt: skip

_OPTIONAL = ("sensor over eventify-dvs", "sensor over ESIM's core, quoted")
"""Of these rows: with the peer's package alone."""


def page_table(results: Results) -> str:
    """Lay out the main figures beside their marks, but for those of peers that are not there."""
    rows = []
    measured = set(results.table("bench")["name"])
    for name, (unit, decimals, words) in _SHOWN.items():
        if name in _OPTIONAL and name not in measured:
            continue
        row = results.rows("bench", name=name).iloc[0]
        has_mark, bound = np.isfinite(row["mark"]), ">=" if row["higher_is_better"] else "<="
        value = f"{row['value']:.{decimals}f} {unit}".strip()
        mark = f"{bound} {row['mark']:g} {unit}"
        rows.append([words, value, *([mark, str(row["verdict"])] if has_mark else ["", ""])])
    return markdown_table(["what", "measured", "mark", "verdict"], rows)


def minutes(results: Results, what: str, decimals: int) -> str:
    """Say how long all recordings of the tables take two workers."""
    row = f"tables, {what}: all, 2 workers"
    return f"{results.value('bench', 'value', name=row) / 60:.{decimals}f}"


_SHARED: dict[str, Any] = {"config": {"growth": POINTS}, "command": "ssac bench",
                           "how": How.ALONE, "committed": COMMITTED}  # fmt: skip
_TOOK = ("wall_s", "cpu_s", "peak_mb")

GROWTH = Study(
    "bench_growth",
    "Time and memory of ever longer flights",
    growth_cells,
    STEP,
    Runs(
        "bench_growth.csv",
        ("sensor", "duration_s", "step"),
        ("sensor", "duration_s", "step", "events_per_camera", *_TOOK, "status", "t_d_error_ms"),
        numbered=False,
        took=_TOOK,
        table=growth_table,
    ),
    (made_of("bench_growth.png", growth_figure, "bench_growth"),),
    checks=(("every step was measured", growth_faults),),
    **_SHARED,
)
BENCH = Study(
    "bench",
    "Speed and memory, as ratios side by side",
    part_cells,
    PART,
    Runs("bench.csv", ("name", "unit"), numbered=False, took=("value", "verdict"),
         table=bench_table),
    numbers={
        "table.bench": page_table,
        "minutes.tables.cached": partial(minutes, what="recordings cached", decimals=1),
        "minutes.tables.nothing": partial(minutes, what="from nothing", decimals=0),
    },
    checks=(("it is a benchmark", bench_faults),),
    reads=("bench_growth.csv",),
    shows="bench",
    **_SHARED,
)  # fmt: skip

STUDIES = (GROWTH, BENCH)

command = command_of(
    {"bench": STUDIES},
    "Measure speed and memory, each on one core, and write them with their marks.",
)
