"""Speed and memory, as ratios side by side in one run, and how they grow with the recording.

Each part and each step runs in a process of its own on one core (the tables: on two). The growth is
summed up in the benchmark's last rows.
"""

from collections.abc import Iterator
from dataclasses import asdict
from functools import partial
from itertools import product
from typing import Annotated, Any, Literal

import numpy as np
import pandas as pd
import typer

from experiments.drawing.style import (
    ACCENT,
    Figure,
    Named,
    label_log_axis,
    legend_outside,
    panels,
)
from experiments.lab.command import command_of
from experiments.lab.results import Results
from experiments.lab.study import How, Runs, Study
from experiments.lab.summary import answered, made_of, markdown_table, records
from experiments.lab.verify import no_row
from experiments.machine import (
    PART,
    PARTS,
    POINTS,
    SIMULATE,
    STEP,
    STEPS,
    SYNCHRONISE,
    Measurement,
    PartCell,
    StepCell,
)

_TOOK = ("wall_s", "cpu_s", "peak_mb")
_MEASURED = "status == 'ok' and wall_s > 0 and cpu_s > 0 and peak_mb > 0 and events_per_camera > 0"

SHORT_EVENTS = 15e6  # of a camera, about; a short run leaves out larger points

MARK_EXPONENT = 1.1
MARK_PEAK_MB = 6000.0  # of the largest point
MIN_MARKED_EVENTS = 50e6  # of that point, from which the mark applies

Extent = Literal["full", "short"]
"""Up to which size of recordings the growth is measured."""

COMMITTED: dict[str, Extent] = {"growth": "full"}
"""Extent of `results/`; what it adds takes as long as the short run of `make bench`."""

Growth = Annotated[
    Extent, typer.Option(help="Largest pair: 50 million events per camera (full), or 10 (short).")
]


def growth_cells(growth: Growth = "short") -> list[StepCell]:
    """List the steps of each point, the smallest first."""
    limit = SHORT_EVENTS if growth == "short" else np.inf
    points = [one for one in POINTS if one.events_per_s * one.duration_s <= limit]
    return [StepCell(point, step) for point in points for step in STEPS]


def growth_table(rows: pd.DataFrame, _: Results) -> pd.DataFrame:
    """Fill in the events of each step's recording, and why a step was not measured."""
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
            measured.append(Measurement(f"{row['part']}: not measured ({row['reason']})"))
    measured += growth_rows(results.table("bench_growth"))
    return pd.DataFrame([asdict(one) | {"verdict": one.verdict} for one in measured])


def growth_rows(table: pd.DataFrame) -> list[Measurement]:
    """Sum up the steps: how time and memory grow, and the largest point beside its marks."""
    rows = [
        Measurement(f"growth, {row.sensor}, {row.duration_s:g} s, {row.step}: {row.status}")
        for row in table[table["status"] != "ok"].itertuples()
    ]
    table = answered(table)
    for (sensor, step), of_step in table.groupby(["sensor", "step"], sort=False):
        if len(of_step) < 2:
            continue
        # `cpu_s` leaves out other processes; the memory of start-up hides that of few events.
        grows = {"time": "cpu_s"} | ({"memory": "peak_mb"} if sensor == POINTS[-1].sensor else {})
        for what, column in grows.items():
            logarithms = np.log(of_step["events_per_camera"]), np.log(of_step[column])
            slope = float(np.polyfit(*logarithms, 1)[0])  # constant parts make it smaller
            name = f"growth, {sensor}: {step}, {what} over events"
            rows.append(Measurement(name, slope, "exponent", MARK_EXPONENT))
    most, name = table["events_per_camera"].max(), "growth, largest pair"
    is_marked = most >= MIN_MARKED_EVENTS
    for one in records(table[table["events_per_camera"] == most]):
        mark_mb = MARK_PEAK_MB if is_marked else np.nan
        rows += [
            Measurement(f"{name}: {one['step']}", one["wall_s"], "s"),
            Measurement(f"{name}: {one['step']}, peak memory", one["peak_mb"], "MB", mark_mb),
        ]
    if len(table):
        rows.append(Measurement(f"{name}: events per camera", most, "events"))
    return rows


_WHAT = {"wall_s": "time [s]", "peak_mb": "peak memory [MB]"}
_GUIDE: dict[str, Any] = {"color": "0.7", "lw": 1.0, "ls": ":", "zorder": 1}


def growth_figure(table: pd.DataFrame) -> Figure:
    """Draw time and memory on logarithmic axes: a colour is a step, and a marker a sensor."""
    colors = {SIMULATE: "0.6", SYNCHRONISE: ACCENT}
    figure, (both,) = panels("How run time and memory grow with the recording", 4.4, columns=2)
    table = table.assign(events_per_camera=1e-6 * table["events_per_camera"])
    measured = table[table["wall_s"].notna()]
    markers = dict(zip(dict.fromkeys(measured["sensor"]), "^s", strict=False))
    for axes, (column, label) in zip(both, _WHAT.items(), strict=True):
        axes.set(xscale="log", yscale="log", xlabel="events of a camera [million]", ylabel=label)
        axes.grid(color="0.92", lw=0.6)
        axes.set_axisbelow("line")  # the guide is below the grid
        for (step, color), (sensor, marker) in product(colors.items(), markers.items()):
            here = measured[(measured["step"] == step) & (measured["sensor"] == sensor)]
            line: dict[str, Any] = {"color": color, "marker": marker, "ms": 5, "lw": 1.2}
            axes.plot(here["events_per_camera"], here[column], zorder=3, **line)
        if len(measured):
            top = measured.loc[measured[column].idxmax()]  # through which the guide goes
            events = np.array([measured["events_per_camera"].min(), top["events_per_camera"]])
            ends = axes.get_ylim()
            axes.plot(events, float(top[column]) * events / events[1], **_GUIDE)
            axes.set_ylim(*ends)
            for axis in (axes.xaxis, axes.yaxis):
                label_log_axis(axis)
    marks: list[Named] = [(step, {"lw": 1.2, "color": color}) for step, color in colors.items()]
    marks += [(name, {"marker": of, "ms": 5, "lw": 0}) for name, of in markers.items()]
    marks.append(("linear in the events", _GUIDE))
    legend_outside(figure, 5, marks)
    return figure


def bench_faults(results: Results) -> Iterator[str]:
    """Check the measured values, which cannot be reproduced, and the rows that follow from them."""
    table = results.table("bench").fillna({"verdict": ""})
    for row in records(table):
        verdict = row.pop("verdict")
        one = Measurement(**row)
        if not 0.0 < one.value < np.inf or one.verdict != verdict:
            yield f"{one.name} is {one.value:g}, and {verdict}"
    summed = growth_rows(results.table("bench_growth"))
    last, values = table.tail(len(summed)), [row.value for row in summed]
    is_named = list(last["name"]) == [row.name for row in summed]
    if not is_named or not np.allclose(last["value"], values, rtol=1e-5):  # of six digits
        yield "the last rows of bench.csv do not follow from bench_growth.csv"


def growth_faults(results: Results) -> list[str]:
    """Check that both steps of each point are there."""
    table = results.table("bench_growth")
    expected = [list(cell.columns.values()) for cell in growth_cells(**COMMITTED)]
    there = table[["sensor", "duration_s", "step"]].to_numpy().tolist()
    return [] if there == expected else [f"not the {len(expected)} steps of today's benchmark"]


def page_table(results: Results) -> str:
    """Lay out what was measured beside its marks."""
    rows = []
    for row in records(results.table("bench")):
        mark = f"{'>=' if row['higher_is_better'] else '<='} {row['mark']:g} {row['unit']}"
        has_mark = np.isfinite(row["mark"])
        rows.append({
            "what": row["name"],
            "measured": f"{row['value']:{'.0f' if row['value'] >= 100 else '.3g'}} {row['unit']}",
            "mark": mark if has_mark else "",
            "verdict": row["verdict"] if has_mark else "",
        })  # fmt: skip
    return markdown_table(pd.DataFrame(rows))


def minutes(results: Results, what: str, decimals: int) -> str:
    """Give the minutes that two workers take for all recordings of the tables."""
    row = f"tables, {what}: all, 2 workers"
    return f"{results.value('bench', 'value', name=row) / 60:.{decimals}f}"


_SHARED: dict[str, Any] = {"config": {"growth": POINTS}, "command": "ssac bench",
                           "how": How.ALONE, "committed": COMMITTED}  # fmt: skip

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
        table=growth_table,
    ),
    (made_of("bench_growth.png", growth_figure, "bench_growth"),),
    checks=(
        ("every step is there", growth_faults),
        ("every step was measured", no_row("bench_growth", f"not ({_MEASURED})")),
    ),
    **_SHARED,
)
BENCH = Study(
    "bench",
    "Speed and memory, as ratios side by side",
    part_cells,
    PART,
    Runs("bench.csv", ("name",), numbered=False, table=bench_table),
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
