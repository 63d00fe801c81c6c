"""A tiny study for tests, a folder of its results, and ways to damage a file of results."""

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
from experiments.lab.results import Results, csv_text, record_checksums, save_text
from experiments.lab.study import Made, Runs, Study, save_made
from experiments.lab.verify import between

GL = {"backend": "osmesa", "renderer": "llvmpipe", "version": "4.5"}


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
    ok = runs[runs["status"] == "ok"]
    return pd.DataFrame(
        {"half": ["low", "high"], "sum": [ok["square"][:3].sum(), ok["square"][3:].sum()]}
    )


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
    checks=(("squares are no square roots", between("squares_runs", "square", 4.0, 49.0)),),
    config={"numbers": [2, 8]},
)  # fmt: skip


def write_squares(folder: Path) -> None:
    """Write the files that `ssac study squares` writes."""
    folder.mkdir(parents=True)
    rows = [
        {"cell": n, **cell.columns, **vars(squared(cell, None))}
        for n, cell in enumerate(SQUARES.cells())
    ]
    save_text(folder / "squares_runs.csv", csv_text(pd.DataFrame(rows)))
    content = provenance("ssac study squares", {"study": "squares", **SQUARES.config}, 1.0, None)
    content |= {"commit": "0123456789ab", "gl": GL}
    record_checksums(folder, save_made(SQUARES, folder, Cache(folder / "none"), content))


def process_row(cell: SquareCell, loaded: object) -> SquareRow:
    """Return a row with the id of this process; the number 3 ends the process."""
    if cell.number == 3:
        os._exit(3)
    return SquareRow("ok", "", float(os.getpid()))


_NUMBER = re.compile(r"(?<![\w.])\d+\.\d+(?![\w.])|(?<![\w.])\d+(?![\w.])")


def double_a_number(path: Path) -> None:
    """Double the last number that is not 0."""
    text = path.read_text(encoding="utf-8")
    last = [found for found in _NUMBER.finditer(text) if float(found.group()) != 0.0][-1]
    doubled = f"{2.0 * float(last.group()):.6g}"
    path.write_text(text[: last.start()] + doubled + text[last.end() :], encoding="utf-8")


def change_a_status(path: Path) -> None:
    before, ok, after = path.read_text(encoding="utf-8").rpartition(",ok,")
    assert ok
    path.write_text(f"{before},no_match,{after}", encoding="utf-8")


def delete_a_row(path: Path) -> None:
    lines = path.read_text(encoding="utf-8").splitlines(keepends=True)
    path.write_text("".join([*lines[:-2], lines[-1]]), encoding="utf-8")


def double_a_row(path: Path) -> None:
    lines = path.read_text(encoding="utf-8").splitlines(keepends=True)
    path.write_text("".join([*lines, lines[-1]]), encoding="utf-8")


def flip_a_byte(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(bytes(content))
