"""The paper's Fig. 3 to 5 and the alignment of two cameras, each drawn of one recording.

`ssac figures` draws them, and those of the tables. A picture is the same bytes whenever it is made
from the same runs and recordings.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from experiments.lab.cache import DEFAULT_FOLDER, Cache
from experiments.lab.cell import Flight
from experiments.lab.files import record_checksums
from experiments.lab.grid import flight_seed
from experiments.lab.provenance import provenance, write_provenance
from experiments.lab.results import PROVENANCE, Results
from experiments.lab.scored import SCORED
from experiments.lab.study import Made, Study
from experiments.studies import tables
from sim.recording import SimConfig
from sim.render.gl_context import context_or_none
from sim.sensor.events import PRESETS
from sim.sensor.frames import FrameConfig
from ssac.errors import SsacError
from ssac.files.whole_file import whole_file

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COMMAND = "ssac figures"

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


def _drawn(name: str, t_d_s: float = 0.0) -> "Callable[[Results, Path], Figure]":
    """Draw a figure of `experiments.drawing.events` of a recording, with an offset added."""

    def draw(_: Results, folder: Path) -> "Figure":
        from experiments.drawing import events

        figure: Figure = getattr(events, name)(events.load_recording(folder, t_d_s))
        return figure

    return draw


_OF: Sequence[tuple[str, Callable[..., Any], Flight]] = (
    ("fig3_preprocessing", _drawn("preprocessing_figure"), (NOISY_FLIGHT, NOISY_SEED)),
    ("fig4_epipolar", _drawn("epipolar_figure", EPIPOLAR_T_D_S), (FLIGHT, SEED)),
    ("fig5_d_avg", _drawn("d_avg_figure"), (FLIGHT, SEED)),
    ("alignment", _drawn("alignment_figure", EPIPOLAR_T_D_S), (FLIGHT, SEED)),
)


def _recording(flight: Flight, **_: Any) -> tuple[Flight, ...]:
    return (flight,)


_OF_TABLES = tuple(made for made in tables.STUDIES[0].makes if made.file.endswith(".png"))

DRAWINGS = {
    made.file.removesuffix(".png"): made
    for made in (
        *(
            Made(f"{name}.png", draw, recordings=partial(_recording, flight))
            for name, draw, flight in _OF
        ),
        *_OF_TABLES,
    )
}
"""Every figure that the command draws."""


def config(names: Sequence[str] = tuple(DRAWINGS)) -> dict[str, Any]:
    """Give what figures are made with, for their provenance."""
    recordings = {name: flight[0] for name, _, flight in _OF if name in names}
    return {"figures": list(names), "recordings": recordings, "flight": 0}


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
    for made in chosen.values():
        folders = [Cache(cache).recording_folder(*flight) for flight in made.filmed()]
        try:
            picture = made.bytes_of(Results(results), *folders)
        except SsacError as error:
            raise SsacError(f"{results if folders else results / 'runs.csv'}: {error}") from error
        with whole_file(out / made.file) as temporary:
            temporary.write_bytes(picture or b"")
        typer.echo(f"written to {out / made.file}")
    line = " ".join([COMMAND, *(names or ())])
    content = provenance(
        line, config(tuple(chosen)), time.perf_counter() - start, context_or_none()
    )
    write_provenance(out / "figures.png", content)
    record_checksums(
        out, [*(out / made.file for made in chosen.values()), out / f"figures{PROVENANCE}"]
    )


def choose(names: Sequence[str]) -> dict[str, Made]:
    """Look up figures; all of them when none is named. SsacError for an unknown name."""
    for name in names:
        if name not in DRAWINGS:
            raise SsacError(f"unknown figure {name!r}: expected some of {', '.join(DRAWINGS)}")
    return {name: DRAWINGS[name] for name in names} or dict(DRAWINGS)


def check_inputs(chosen: dict[str, Made], results: Path) -> None:
    """Raise SsacError, before any work is done, when the tables' runs are missing."""
    for name, made in chosen.items():
        path = results / "runs.csv"
        if not made.recordings and not path.is_file():
            raise SsacError(
                f"{path}: missing, and {name} is drawn from it: run `make tables` first, or "
                "name the figures to draw"
            )


STUDIES = (
    Study(
        "figures",
        "The paper's figures",
        lambda: (),
        SCORED,
        None,
        tuple(made for made in DRAWINGS.values() if made.recordings),
        config=config(),
        command=COMMAND,
    ),
)
