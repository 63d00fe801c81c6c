"""Results and recordings in, the paper's figures and those of the tables out: `ssac figures`.

A picture is the same bytes whenever it is made from the same runs and recordings.
"""

import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import pandas as pd
import typer
from matplotlib.figure import Figure

from experiments.drawing.errors import beyond_figure, error_figure
from experiments.drawing.events import (
    alignment_figure,
    d_avg_figure,
    epipolar_figure,
    load_recording,
    preprocessing_figure,
)
from experiments.lab.cache import DEFAULT_FOLDER, Cache
from experiments.lab.files import record_checksums, save_png
from experiments.lab.grid import flight_seed
from experiments.lab.provenance import save_provenance
from experiments.paper.comparison import load_published
from experiments.paper.esim import ordered_runs, runs_from_csv
from sim.recording import SimConfig
from sim.render.gl_context import context_or_none
from sim.sensor.events import PRESETS
from sim.sensor.frames import FrameConfig
from ssac.errors import SsacError

FLIGHT = SimConfig(angle_deg=90.0)
"""A flight of the 20 s table."""

NOISY_FLIGHT = SimConfig(
    angle_deg=90.0,
    spline=replace(FLIGHT.spline, duration_s=10.0),
    sensor=PRESETS["davis346"],
    frames=FrameConfig(rate_hz=0.0),
)
"""One with a sensor's noise, so that denoising has something to do."""

SEED = flight_seed(20.0, 90.0, 0)
NOISY_SEED = flight_seed(10.0, 90.0, 0)
"""Of these flights: each is the first of its duration and angle."""

EPIPOLAR_T_D_S = 0.05  # at the tables' 50 ms the distance before alignment is seen at a glance


DrawRuns = Callable[[pd.DataFrame, Mapping[float, pd.DataFrame]], Figure]
"""From the runs of the tables, and the paper's table of each duration [s]."""


@dataclass(frozen=True)
class Drawing:
    """One figure: what it is made from, and who draws it."""

    draw: Callable[[Path, Cache], Figure]  # from the folder of results and the cache
    csv: str = ""  # that it is made of, in that folder, and of nothing else
    command: str = ""  # that makes the CSV
    recording: SimConfig | None = None  # that it is made of


def figures_command(
    names: Annotated[
        list[str] | None,
        typer.Argument(help="Figures to draw, by file name.  [default: all]", metavar="NAME"),
    ] = None,
    results: Annotated[Path, typer.Option(help="Folder with the CSVs.", metavar="FOLDER")] = Path(
        "results"
    ),
    cache: Annotated[
        Path, typer.Option(help="Folder of cached recordings.", metavar="FOLDER")
    ] = DEFAULT_FOLDER,
    out: Annotated[Path, typer.Option(help="Folder for the PNGs.", metavar="FOLDER")] = Path(
        "results"
    ),
) -> None:
    """Draw the paper's Fig. 3 to 5, and all methods' errors; studies draw their own figures."""
    start = time.perf_counter()
    chosen = choose(names or ())
    check_inputs(chosen, results)
    out.mkdir(parents=True, exist_ok=True)
    for name, drawing in chosen.items():
        path = out / f"{name}.png"
        save_png(drawing.draw(results, Cache(cache)), path)
        typer.echo(f"written to {path}")
    provenance = out / "figures.png"
    save_provenance(
        provenance,
        " ".join(["ssac figures", *(names or ())]),
        figures_config(chosen),
        time.perf_counter() - start,
        context_or_none(),
    )
    written = [out / f"{name}.png" for name in chosen]
    record_checksums(out, [*written, provenance.with_suffix(".provenance.json")])


def figures_config(chosen: Mapping[str, Drawing]) -> dict[str, Any]:
    """Give what figures are made with, for their provenance."""
    recordings = {name: one.recording for name, one in chosen.items() if one.recording}
    return {"figures": list(chosen), "recordings": recordings, "flight": 0}


def drawings() -> dict[str, Drawing]:
    """List every figure by the name of its file."""
    return {
        "fig3_preprocessing": Drawing(_preprocessing, recording=NOISY_FLIGHT),
        "fig4_epipolar": Drawing(_epipolar, recording=FLIGHT),
        "fig5_d_avg": Drawing(_d_avg, recording=FLIGHT),
        "alignment": Drawing(_alignment, recording=FLIGHT),
        "error_vs_angle": Drawing(partial(_of_runs, error_figure), "runs.csv", "make tables"),
        "beyond_paper": Drawing(partial(_of_runs, beyond_figure), "runs.csv", "make tables"),
    }


def choose(names: Iterable[str]) -> dict[str, Drawing]:
    """Look up figures; all of them when none is named. SsacError for an unknown name."""
    listed = drawings()
    for name in names:
        if name not in listed:
            raise SsacError(f"unknown figure {name!r}: expected some of {', '.join(listed)}")
    return {name: listed[name] for name in names} or listed


def check_inputs(chosen: dict[str, Drawing], results: Path) -> None:
    """Raise SsacError, before any work is done, when a CSV is missing."""
    for name, drawing in chosen.items():
        path = results / drawing.csv
        if drawing.csv and not path.is_file():
            raise SsacError(
                f"{path}: missing, and {name} is drawn from it: run `{drawing.command}` first, or "
                "name the figures to draw"
            )


def _preprocessing(_: Path, cache: Cache) -> Figure:
    return preprocessing_figure(load_recording(cache.recording_folder(NOISY_FLIGHT, NOISY_SEED)))


def _epipolar(_: Path, cache: Cache) -> Figure:
    folder = cache.recording_folder(FLIGHT, SEED)
    return epipolar_figure(load_recording(folder, EPIPOLAR_T_D_S))


def _d_avg(_: Path, cache: Cache) -> Figure:
    return d_avg_figure(load_recording(cache.recording_folder(FLIGHT, SEED)))


def _alignment(_: Path, cache: Cache) -> Figure:
    folder = cache.recording_folder(FLIGHT, SEED)
    return alignment_figure(load_recording(folder, EPIPOLAR_T_D_S))


def _of_runs(draw: DrawRuns, results: Path, _: Cache) -> Figure:
    path = results / "runs.csv"
    try:
        runs = ordered_runs(runs_from_csv(path.read_text(encoding="utf-8")))
        return draw(runs, load_published())
    except SsacError as error:
        raise SsacError(f"{path}: {error}") from error
