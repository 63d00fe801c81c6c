"""The paper's Fig. 3 to 5, and how two cameras' views come together, each of one recording.

`ssac figures` draws them, and the figures of all studies that follow from the CSVs; it runs no
study. The same runs and recordings give a picture of the same bytes.
"""

import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

from experiments.drawing.style import Figure
from experiments.lab.cache import DEFAULT_FOLDER, Cache
from experiments.lab.cell import Flight
from experiments.lab.command import CacheOption, OutOption, chosen
from experiments.lab.grid import flight_seed
from experiments.lab.provenance import provenance, provenance_file
from experiments.lab.results import PROVENANCE, File, Results, save_files
from experiments.lab.scored import SCORED
from experiments.lab.study import NO_RUNS, Made, Study
from experiments.studies import all_studies
from sim.recording import SimConfig
from sim.render.gl_context import context_or_none
from sim.sensor.events import PRESETS
from sim.sensor.frames import FrameConfig
from ssac.errors import SsacError

COMMAND = "ssac figures"

FLIGHT = SimConfig(angle_deg=90.0)  # a flight of the 20 s table

NOISY_FLIGHT = SimConfig(
    angle_deg=90.0,
    spline=replace(FLIGHT.spline, duration_s=10.0),
    sensor=PRESETS["davis346"],
    frames=FrameConfig(rate_hz=0.0),
)
"""A flight with a sensor's noise, so that denoising has something to do."""

SEED = flight_seed(20.0, 90.0, 0)
NOISY_SEED = flight_seed(10.0, 90.0, 0)
"""Seeds of these flights, each the first of its duration and angle."""

EPIPOLAR_T_D_S = 0.05  # at the tables' 50 ms the distance before alignment is seen at a glance
ALIGNED_T_D_S = 0.3  # of the animation: the views come together over many of its pictures


def _of(name: str, function: str, t_d_s: float, flight: Flight) -> Made:
    """Declare a figure that a function of `drawing.events` draws of a flight with an offset."""

    def draw(_: Results, folder: Path) -> Figure | bytes:
        from experiments.drawing import events

        drawn: Figure | bytes = getattr(events, function)(events.load_recording(folder, t_d_s))
        return drawn

    return Made(f"{name}.png", draw, recordings=lambda **_: (flight,))


_OF_RECORDINGS = (
    _of("fig3_preprocessing", "preprocessing_figure", 0.0, (NOISY_FLIGHT, NOISY_SEED)),
    _of("fig4_epipolar", "epipolar_figure", EPIPOLAR_T_D_S, (FLIGHT, SEED)),
    _of("fig5_d_avg", "d_avg_figure", 0.0, (FLIGHT, SEED)),
    _of("alignment", "alignment_animation", ALIGNED_T_D_S, (FLIGHT, SEED)),
)


def drawings() -> dict[str, Made]:
    """Give every figure that the command draws, by name."""
    of_studies = (
        made
        for study in all_studies().values()
        for made in study.makes
        if study.is_committed and made.follows and made.file.endswith(".png")
    )
    return {made.file.removesuffix(".png"): made for made in (*_OF_RECORDINGS, *of_studies)}


def config(some: Sequence[Made] = _OF_RECORDINGS) -> dict[str, Any]:
    """Return the configuration of figures of recordings, for their provenance."""
    flown = {one.file.removesuffix(".png"): sim for one in some for sim, _ in one.filmed()}
    return {"figures": list(flown), "recordings": flown, "flight": 0}


def figures_command(
    names: Annotated[
        list[str] | None,
        typer.Argument(help="Figures to draw, by file name.  [default: all]", metavar="NAME"),
    ] = None,
    cache: CacheOption = DEFAULT_FOLDER,
    out: OutOption = Path("results"),
) -> None:
    """Draw the paper's Fig. 3 to 5, and all figures that follow from the CSVs, anew."""
    start = time.perf_counter()
    known = drawings()
    drawn = chosen(names or known, known, "figure")

    def files() -> Iterator[File]:
        for made in drawn:
            folders = [Cache(cache).recording_folder(*flight) for flight in made.filmed()]
            try:
                yield made.file, made.bytes_of(Results(out), *folders)
            except SsacError as error:
                raise SsacError(f"{made.file}: {error}") from error
        filmed = [made for made in _OF_RECORDINGS if made in drawn]
        # Studies write the provenance of the others; that of all of these outlives one drawn anew.
        is_there = (out / f"figures{PROVENANCE}").exists()
        if filmed and (len(filmed) == len(_OF_RECORDINGS) or not is_there):
            line, took_s = " ".join([COMMAND, *(names or ())]), time.perf_counter() - start
            content = provenance(line, config(filmed), took_s, context_or_none())
            yield provenance_file("figures", content)

    for path in save_files(out, files()):
        typer.echo(f"written to {path}")


STUDIES = (
    Study(
        "figures",
        "The paper's figures",
        lambda: (),
        SCORED,
        NO_RUNS,
        _OF_RECORDINGS,
        config=config(),
        command=COMMAND,
    ),
)
