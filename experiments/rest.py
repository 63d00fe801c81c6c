"""What other commands leave in results/, until each is a study of its own."""

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from experiments.bench.growth import COLUMNS as GROWTH_COLUMNS
from experiments.bench.growth import COMMITTED, STEPS, bench_command_line, bench_config, points_of
from experiments.bench.measurement import Measurement
from experiments.damage.reliability import COMMAND as DAMAGE_COMMAND
from experiments.damage.reliability import COMMITTED as DAMAGE
from experiments.damage.reliability import reliability_faults
from experiments.drawing.growth import growth_figure
from experiments.lab.quote import pages, quotations
from experiments.lab.results import Results
from experiments.lab.scored import SCORED
from experiments.lab.study import How, Made, Runs, Study
from experiments.quoted.cells import NUMBERS
from experiments.quoted.tables import TABLES
from ssac.estimate import Status


def no_cells() -> Sequence[Any]:
    """List no cells: they are not known here."""
    return ()


def _bench_faults(results: Results) -> tuple[str, ...]:
    """Check shape and ranges: what was measured cannot be made again."""
    path = results.folder / "bench.csv"
    table = pd.read_csv(path, keep_default_na=False, na_values={"value": [""], "mark": [""]})
    columns = [*Measurement.__dataclass_fields__, "verdict"]
    there = [str(name) for name in table]
    if there != columns:
        return (f"its columns are {', '.join(there)}; expected {', '.join(columns)}",)
    faults = []
    for row in table.to_dict("records"):
        mark = None if np.isnan(row["mark"]) else float(row["mark"])
        one = Measurement(
            row["name"], float(row["value"]), row["unit"], mark, bool(row["higher_is_better"])
        )
        if not 0.0 < one.value < np.inf:
            faults.append(f"{one.name} is {one.value}")
        if not (isinstance(one.unit, str) and one.unit):
            faults.append(f"{one.name} has no unit")
        if one.verdict != row["verdict"]:
            faults.append(f"{one.name} is {one.value:g}, so it is not so that it {row['verdict']}")
    return tuple(faults) if len(table) else ("it is empty",)


def _growth_faults(results: Results) -> tuple[str, ...]:
    """Check that both steps of each point were measured, and that the pair was synchronised."""
    table = results.table("bench_growth")
    there = [str(name) for name in table]
    if there != list(GROWTH_COLUMNS):
        return (f"its columns are {', '.join(there)}; expected {', '.join(GROWTH_COLUMNS)}",)
    rows = zip(table["sensor"], table["duration_s"], table["step"], strict=True)
    expected = [
        (one.sensor, one.duration_s, step) for one in points_of(COMMITTED) for step in STEPS
    ]
    if list(rows) != expected:
        return (f"its points are not the {len(expected)} of today's benchmark",)
    faults = []
    for row in table.to_dict("records"):
        name = f"{row['sensor']}, {row['duration_s']:g} s, {row['step']}"
        if row["status"] != Status.OK.value:
            faults.append(f"{name}: {row['status']}")
        faults += [
            f"{name}: {column} is {row[column]}"
            for column in ("events_per_camera", "wall_s", "cpu_s", "peak_mb")
            if not 0.0 < float(row[column]) < np.inf
        ]
    return tuple(faults)


_ROOT = Path(__file__).resolve().parents[1]
_QUOTED = {name for page in pages(_ROOT) for name, *_ in quotations(page.read_text("utf-8"), page)}

STUDIES = (
    Study(
        "bench", "Speed and memory", no_cells, SCORED,
        Runs("bench.csv", ("name", "unit"), numbered=False),
        checks=(("bench.csv is a benchmark", _bench_faults),),
        config=bench_config(COMMITTED), command=bench_command_line(COMMITTED), how=How.GIVEN,
        numbers={name: one for name, one in {**NUMBERS, **TABLES}.items() if name in _QUOTED},
    ),
    Study(
        "bench_growth", "Growth of time and memory", no_cells, SCORED,
        Runs("bench_growth.csv", ("sensor", "duration_s", "step"), numbered=False),
        (Made("bench_growth.png", lambda results: growth_figure(results.table("bench_growth"))),),
        checks=(("bench_growth.csv has every point", _growth_faults),),
        config=bench_config(COMMITTED), command=bench_command_line(COMMITTED), how=How.GIVEN,
    ),
    Study(
        "reliability", "Damaged inputs", no_cells, SCORED,
        Runs("reliability.csv", ("input",), numbered=False),
        checks=(("every case is there, and none ended as it must not",
                 lambda results: reliability_faults(results.folder)),),
        config=asdict(DAMAGE), command=DAMAGE_COMMAND, how=How.GIVEN,
    ),
)  # fmt: skip
