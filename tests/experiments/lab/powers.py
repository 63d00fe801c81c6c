"""A study of powers of numbers, each number a recording, that can be told to fail; no OpenGL."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from experiments.lab.cache import Cache
from experiments.lab.cell import Measure
from experiments.lab.study import Made, Runs, Study
from sim.recording import SimConfig

NUMBERS, POWERS = range(4), (1, 2)


@dataclass(frozen=True)
class PowerCell:
    number: int
    power: int

    @property
    def recordings(self) -> tuple[Any, ...]:
        return ((SimConfig(), self.number),)

    @property
    def columns(self) -> dict[str, Any]:
        return {"number": self.number, "pair": [self.number, 1], "power": self.power}

    @property
    def inputs(self) -> int:
        return self.power


@dataclass(frozen=True)
class PowerRow:
    status: str
    reason: str = ""
    value: int = 0
    share: float = np.nan


LOADED: list[int] = []
"""Numbers whose recordings were loaded."""

FAULTS: dict[str, BaseException] = {}
"""What is raised, by "number 3" or "power 2"."""


def load_number(cells: Sequence[PowerCell], _: Cache) -> int:
    number = cells[0].number
    LOADED.append(number)
    if f"number {number}" in FAULTS:
        raise FAULTS[f"number {number}"]
    return number


def power_row(cell: PowerCell, number: int) -> PowerRow:
    if f"power {cell.power}" in FAULTS:
        raise FAULTS[f"power {cell.power}"]
    return PowerRow("ok", "", number**cell.power, number / 7)


def power_cells() -> list[PowerCell]:
    return [PowerCell(number, power) for power in POWERS for number in NUMBERS]


def sums(runs: pd.DataFrame) -> pd.DataFrame:
    ok = runs[runs["status"] == "ok"]
    return ok.groupby("power", as_index=False)[["value", "share"]].sum()


CELLS = power_cells()
VALUES = [cell.number**cell.power for cell in CELLS]
MEASURE = Measure(load_number, power_row, PowerRow)

STUDY = Study(
    "powers", "Powers of numbers", power_cells, MEASURE,
    Runs("powers_runs.csv", ("number", "power")),
    (
        Made("powers.csv", lambda results: sums(results.table("powers_runs"))),
        Made("powers.png", lambda _: Figure()),
    ),
    config={"powers": POWERS},
)  # fmt: skip
