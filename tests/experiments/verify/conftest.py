"""A small complete folder of results: the tables with made-up numbers, and one tiny study."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from shutil import copytree
from typing import Any

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure

from experiments.bench.growth import COMMITTED, points_of
from experiments.bench.measurement import Measurement
from experiments.drawing.figures import drawings
from experiments.drawing.growth import growth_figure
from experiments.lab.cache import Cache
from experiments.lab.files import png_bytes, read_table, record_checksums, save_csv
from experiments.lab.provenance import plain, provenance, write_provenance
from experiments.lab.study import Study, save_derived
from experiments.lab.task import Measure
from experiments.paper.comparison import PUBLISHED
from experiments.paper.grids import table_cells
from experiments.paper.results import save_results
from experiments.verify import derived, sample
from experiments.verify.manifest import Manifest, manifest_of
from sim.render.gl_context import open_context
from ssac.pipeline.registry import OURS
from tests.experiments.flown import write_made_up_flights
from tests.experiments.grown import made_up_growth
from tests.experiments.reported import made_up_runs

NAMES = tuple(method.name for method in OURS)
N_FLIGHTS = 12
"""Of a cell of the tables here, some more than the paper's: few, as all is made many times."""


@dataclass(frozen=True)
class SquareCell:
    number: int

    @property
    def recordings(self) -> tuple[Any, ...]:
        return ()

    @property
    def columns(self) -> dict[str, Any]:
        return {"number": self.number, "pair": [self.number, 1]}

    @property
    def inputs(self) -> int:
        return self.number


@dataclass(frozen=True)
class SquareRow:
    status: str
    reason: str = ""
    square: float = np.nan


def load_nothing(cells: Sequence[SquareCell], cache: Cache) -> None:
    return None


def squared(cell: SquareCell, loaded: None) -> SquareRow:
    return SquareRow("ok", "", float(cell.number**2))


def drawn_squares(means: pd.DataFrame, runs: pd.DataFrame) -> Figure:
    figure = Figure(figsize=(2, 2))
    figure.subplots().plot(runs["number"], runs["square"] / means["square"].iloc[0])
    return figure


SQUARES = Study(
    "squares",
    "Squares of numbers",
    lambda: [SquareCell(number) for number in range(2, 8)],
    Measure(load_nothing, squared, SquareRow),
    lambda runs: runs[["square"]].mean().to_frame().T,
    keys=("number",),
    draw=drawn_squares,
    config={"numbers": [2, 8]},
)
STUDIES: Mapping[str, Study] = {SQUARES.name: SQUARES}


@pytest.fixture(scope="session", autouse=True)
def few_flights() -> Iterator[None]:
    """Let the tables have fewer flights than they have."""
    few = [cell for cell in table_cells() if cell.flight < N_FLIGHTS]
    with pytest.MonkeyPatch.context() as patch:
        for module in (derived, sample):
            patch.setattr(module, "table_cells", lambda: few)
        yield


@pytest.fixture(scope="session")
def manifest() -> Manifest:
    return manifest_of(STUDIES)


@pytest.fixture(scope="session")
def complete(tmp_path_factory: pytest.TempPathFactory, manifest: Manifest) -> Path:
    """Results as all commands together leave them."""
    folder = Path(tmp_path_factory.mktemp("verify")) / "results"
    copytree(PUBLISHED, folder / "published")
    made_with = provenance("ssac tables", {}, 1.0, open_context()) | {"commit": "0123456789ab"}
    runs = made_up_runs(NAMES, N_FLIGHTS)
    runs["t_d_error_ms"] = runs["t_d_error_ms"].clip(upper=900.0)  # within the search
    runs["t_d_estimate_ms"] = runs["t_d_ms"] + runs["t_d_error_ms"]
    save_results(runs, folder, made_with)
    rows = [{"cell": n, **cell.columns, **vars(squared(cell, None))}
            for n, cell in enumerate(SQUARES.cells())]  # fmt: skip
    save_csv(folder / SQUARES.runs_file, pd.DataFrame(rows))
    save_derived(SQUARES, folder)
    bench = [Measurement("drawing", 2.0, "s", 3.0), Measurement("reading", 4.0, "MB/s")]
    table = pd.DataFrame([{**vars(row), "verdict": row.verdict} for row in bench])
    table.to_csv(folder / "bench.csv", index=False)
    save_csv(folder / "bench_growth.csv", made_up_growth(points_of(COMMITTED)))
    write_made_up_flights(folder)
    for one in manifest.provenances:
        path = folder / one.name.replace(".provenance.json", ".csv")
        write_provenance(path, made_with | {"command": one.command, "config": plain(one.config)})
    for name, drawing in drawings().items():
        figure = drawing.draw(folder, Cache()) if drawing.csv else Figure(figsize=(1, 1))
        (folder / f"{name}.png").write_bytes(png_bytes(figure))
    figure = growth_figure(read_table((folder / "bench_growth.csv").read_text()))
    (folder / "bench_growth.png").write_bytes(png_bytes(figure))
    record_checksums(folder, [folder / name for name in manifest.files])
    return folder


@pytest.fixture
def results(complete: Path, tmp_path: Path) -> Path:
    return Path(copytree(complete, tmp_path / "results"))
