"""A tiny study for tests, a folder of its results, and ways to damage the text of a result."""

import os
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from experiments.lab.cache import Cache
from experiments.lab.cell import Measure, PlainCell, RunRow, load_nothing
from experiments.lab.provenance import provenance
from experiments.lab.results import Results, csv_text
from experiments.lab.study import Made, Runs, Study, save_made
from experiments.lab.verify import no_row
from tests.experiments.reported import PROVENANCE


@dataclass(frozen=True)
class SquareCell(PlainCell):
    number: int

    @property
    def columns(self) -> dict[str, Any]:
        return {"number": self.number, "pair": [self.number, 1]}


@dataclass(frozen=True)
class SquareRow(RunRow):
    square: float = np.nan


def squared(cell: SquareCell, loaded: object) -> SquareRow:
    return SquareRow("ok", "", float(cell.number**2))


def sums(results: Results) -> pd.DataFrame:
    runs = results.table("squares_runs")
    squares = runs.loc[runs["status"] == "ok", "square"]
    return pd.DataFrame({"half": ["low", "high"], "sum": [squares[:3].sum(), squares[3:].sum()]})


def drawn(results: Results) -> Figure:
    figure = Figure(figsize=(2, 2))
    runs, table = results.table("squares_runs"), results.table("squares")
    figure.subplots().plot(runs["number"], runs["square"] / table["sum"].iloc[0])
    return figure


SQUARES = Study(
    "squares",
    "Squares of numbers",
    lambda: [SquareCell(number) for number in range(2, 8)],
    Measure(load_nothing, squared, SquareRow),
    Runs("squares_runs.csv", ("number",)),
    (Made("squares.csv", sums), Made("squares.png", drawn),
     Made("squares.md", lambda results: f"The sums:\n\n{results.text('squares.csv')}")),
    numbers={"squares.sum": lambda results: f"{results.value('squares', 'sum', half='low'):.0f}"},
    checks=(("squares are no square roots", no_row("squares_runs", "square < 4 or square > 49")),),
    config={"numbers": [2, 8]},
)  # fmt: skip


def write_squares(folder: Path) -> None:
    """Write the files that `ssac study squares` writes."""
    rows = [{**cell.columns, **vars(squared(cell, None))} for cell in SQUARES.cells()]
    table = pd.DataFrame(rows).reset_index(names="cell")
    content = provenance("ssac study squares", {"study": "squares", **SQUARES.config}, 1.0, None)
    content |= {name: PROVENANCE[name] for name in ("commit", "gl")}
    save_made(SQUARES, folder, Cache(folder / "none"), csv_text(table), content)


def process_row(cell: SquareCell, loaded: object) -> SquareRow:
    """Return a row with the id of this process; the number 3 ends the process."""
    if cell.number == 3:
        os._exit(3)
    return SquareRow("ok", "", float(os.getpid()))


_NUMBER = re.compile(r"(?<![\w.])\d+\.\d+(?![\w.])|(?<![\w.])\d+(?![\w.])")


def double_a_number(text: str) -> str:
    """Double the last number that is not 0."""
    last = [found for found in _NUMBER.finditer(text) if float(found.group()) != 0.0][-1]
    return f"{text[: last.start()]}{2.0 * float(last.group()):.6g}{text[last.end() :]}"


def change_a_status(text: str) -> str:
    return ",no_match,".join(text.rsplit(",ok,", 1))


def delete_a_row(text: str) -> str:
    *others, _, last = text.splitlines(keepends=True)
    return "".join([*others, last])


def double_a_row(text: str) -> str:
    return text + text.splitlines(keepends=True)[-1]


def flipped(data: bytes, at: int, bit: int = 0) -> bytes:
    return data[:at] + bytes([data[at] ^ 1 << bit]) + data[at + 1 :]
