"""The command `ssac sync`: offsets and poses of two or more cameras.

What takes long to import is imported when the command runs, not for its help.
"""

from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ssac.cli.command_line import Sections
from ssac.cli.exits import NO_ESTIMATE, warnings_as_lines
from ssac.cli.options import AllowDamaged, NoDenoise, Sort, n_min_of, number
from ssac.config import CLOCKS, EVENT_SKEW_PRIOR_PPM, INTERVAL_S, MAX_SKEW_PPM, Config
from ssac.errors import SsacError
from ssac.pipeline.summaries import DEFAULT, OF_TRACKS, all_summaries

if TYPE_CHECKING:
    from ssac.pipeline.opened import Known

_SEARCH_DEFAULT = (
    f"{INTERVAL_S[0]:g} {INTERVAL_S[1]:g}; all offsets for tracks, or where that "
    "leaves no common time"
)

MAX_SEARCH_S = 3600.0
"""Width of a search interval that still ends: its time is proportional to it."""


def complete_method(incomplete: str) -> list[tuple[str, str]]:
    """List the methods for a shell that completes a name."""
    return [pair for pair in all_summaries().items() if pair[0].startswith(incomplete)]


def sync_command(
    cam1: Annotated[
        Path,
        typer.Argument(metavar="CAM1", help="Event or track file of camera 1.", show_default=False),
    ],
    cam2: Annotated[
        Path,
        typer.Argument(metavar="CAM2", help="Event or track file of camera 2.", show_default=False),
    ],
    rig: Annotated[
        Path,
        typer.Option(
            metavar="FILE",
            help="Calibration of the cameras: Kalibr or OpenCV YAML.",
            show_default=False,
        ),
    ],
    more: Annotated[
        list[Path] | None,
        typer.Argument(metavar="CAM3", help="Files of further cameras.", show_default=False),
    ] = None,
    known_extrinsics: Annotated[
        bool,
        typer.Option(
            "--known-extrinsics", help="Take the pose from the rig file and find only the offset."
        ),
    ] = False,
    method: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="Method, one of those below.",
            autocompletion=complete_method,
            show_default=f"{DEFAULT}; {OF_TRACKS} with tracks",
        ),
    ] = None,
    cameras: Annotated[
        tuple[int, int],
        typer.Option(metavar="I J", help="Numbers of the two cameras in the rig, from 1."),
    ] = (1, 2),
    search: Annotated[
        tuple[float, float] | None,
        typer.Option(
            metavar="LOW HIGH",
            help="Range of offsets t_d to search, in seconds.",
            show_default=_SEARCH_DEFAULT,
        ),
    ] = None,
    search_all: Annotated[
        bool,
        typer.Option("--search-all", help="Search all offsets that leave enough common time."),
    ] = False,
    rate_range: Annotated[
        tuple[float, float] | None,
        typer.Option(
            metavar="LOW HIGH",
            help="Also search the rate of camera 2's clock over camera 1's in this range, at all"
            " offsets: for an unknown frame rate.",
            show_default=False,
        ),
    ] = None,
    skew_prior: Annotated[
        float | None,
        number(
            "Prior standard deviation of the clock skew; 0: no skew; phones need 1000.",
            0,
            MAX_SKEW_PPM,
            "ppm",
            default_words=f"{EVENT_SKEW_PRIOR_PPM:g}; 1000 with tracks",
        ),
    ] = None,
    clock: Annotated[
        str,
        typer.Option(
            metavar="NAME",
            help="Clock model: affine, or pieces, whose skew changes, as in phones.",
            show_default="affine; pieces for tracks that it does not fit",
        ),
    ] = Config.clock,
    roughness: Annotated[
        float,
        number(
            "With --clock pieces: standard deviation of the change of skew from piece to piece;"
            " variable frame rates need 6000.",
            1,
            MAX_SKEW_PPM,
            "ppm",
        ),
    ] = Config.roughness_ppm,
    estimate_readout: Annotated[
        bool,
        typer.Option(
            "--estimate-readout",
            help="Estimate rolling-shutter readout times that the rig does not give (tracks only).",
        ),
    ] = False,
    json_file: Annotated[
        Path | None,
        typer.Option("--json", metavar="FILE", help="Write the result as JSON."),
    ] = None,
    plot: Annotated[
        Path | None,
        typer.Option(
            metavar="PATH", help="Draw figures: into a folder, or one file (.png, .pdf, .svg)."
        ),
    ] = None,
    write_synced: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Write camera 2's events (.h5, .txt) or track (.csv) on camera 1's clock.",
        ),
    ] = None,
    trajectory: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Write the object's path in space: .csv (with deviations), else TUM.",
        ),
    ] = None,
    distance: Annotated[
        float | None,
        number("Distance between cameras 1 and 2, which sets the scale.", 1e-3, 1e6, "m"),
    ] = None,
    positions: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="CSV of camera positions, camera,x_m,y_m,z_m: sets frame and scale.",
        ),
    ] = None,
    rtk: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="The object's path by RTK, on any clock: sets frame and scale."
        ),
    ] = None,
    lever_arm: Annotated[
        tuple[float, float, float] | None,
        number(
            "Position of the RTK antenna in the body: forward, left, up. Needs its attitude.",
            -100,
            100,
            "metres",
            metavar="X Y Z",
        ),
    ] = None,
    focal_std: Annotated[
        float | None,
        number(
            "Standard deviation of both focal lengths, overriding the rig file.",
            0.0,
            20.0,
            "percent",
        ),
    ] = None,
    centre_std: Annotated[
        float | None,
        number(
            "Standard deviation of both principal points, overriding the rig file.",
            0.0,
            100.0,
            "px",
        ),
    ] = None,
    no_denoise: NoDenoise = False,
    allow_damaged: AllowDamaged = False,
    sort: Sort = False,
    n_samples: Annotated[
        int,
        number(
            "Number of sample times at which positions are compared.", 20, 100_000, metavar="COUNT"
        ),
    ] = Config.n_samples,
    half_window: Annotated[
        float,
        number("Half of the time window whose events give a position.", 0.001, 0.25, "seconds"),
    ] = Config.half_window_s,
    n_min: Annotated[int | None, n_min_of("a position")] = None,
    neighbours: Annotated[
        int | None,
        number(
            "Noise filter: events needed within 5 px and 5 ms to keep an event.",
            1,
            1000,
            metavar="COUNT",
            default_words="20; adapted to noise and thin objects",
        ),
    ] = None,
) -> None:
    """Find the time offset and relative pose of two or more cameras from one moving object.

    Exit code 0: done; 1: the data give no reliable estimate, the output says why; 2: wrong usage,
    or a file that cannot be used; 3: a bug of this program; 130: interrupted.
    """
    if search is not None and (search_all or rate_range is not None):
        raise SsacError("--search: not with --search-all or --rate-range, which try every offset")
    if search is not None and not 0.0 < search[1] - search[0] <= MAX_SEARCH_S:
        raise SsacError(
            "--search: expected a smaller and a larger offset, at most "
            f"{MAX_SEARCH_S:g} seconds apart, got {search[0]:g} {search[1]:g}"
        )
    if clock not in CLOCKS:
        raise SsacError(f"--clock: expected {' or '.join(CLOCKS)}, got {clock}")
    from ssac.cli.outputs import Outputs, check_outputs, known_of, write_outputs
    from ssac.files.damage import Reading
    from ssac.pipeline.api import Result, sync

    files, reading = [cam1, cam2, *(more or ())], Reading(allow_damaged, sort)
    config = Config(
        interval_s=search,
        n_samples=n_samples,
        half_window_s=half_window,
        n_min=n_min,
        n_neighbours=neighbours,
        denoise=not no_denoise,
        skew_prior_ppm=skew_prior,
        clock=clock,
        roughness_ppm=roughness,
        search="all" if search_all else Config.search,
        rates=rate_range,
    )
    with warnings_as_lines():
        outputs = Outputs(json_file, plot, write_synced, trajectory)
        check_outputs([*files, rig, *filter(None, (positions, rtk))], outputs)
        known = known_of(distance, positions, rtk, lever_arm)
        for_two = {
            "--cameras": cameras != (1, 2),
            "--plot": plot,
            "--write-synced": write_synced,
            "--known-extrinsics": known_extrinsics,
            "--estimate-readout": estimate_readout,
        }
        if more:
            _check_for_two([name for name, value in for_two.items() if value])
        else:
            _check_known_of_two(known, trajectory is not None)
        call: Callable[..., Any] = sync
        result = call(
            *((files, rig, None) if more else (cam1, cam2, rig)),
            method,
            config,
            known_extrinsics=known_extrinsics,
            cameras=cameras,
            focal_std=None if focal_std is None else 0.01 * focal_std,
            centre_std_px=centre_std,
            estimate_readout=estimate_readout,
            reading=reading,
            known=known if more else type(known)(),
            log=_to_stderr,
        )
        typer.echo(result.summary())
        if isinstance(result, Result):
            write_outputs(result, outputs, cam2, reading, _to_stderr)
            if trajectory is not None:
                from ssac.pipeline.many import write_path_of_two

                write_path_of_two(trajectory, result.answer, known, _to_stderr)
        else:
            from ssac.pipeline.many import write_many

            write_many(result, json_file, trajectory, _to_stderr)
    if result.status != "ok":
        raise typer.Exit(NO_ESTIMATE)


def help_sections() -> Sections:
    """List the methods, and what an estimate's status may be, below the help."""
    estimate: Any = import_module("ssac.estimate")
    statuses = [(str(status), status.meaning) for status in getattr(estimate, "Status", ())]
    return {
        "Methods": list(all_summaries().items()),
        **({"Statuses": statuses} if statuses else {}),
    }


def _check_for_two(given: list[str]) -> None:
    """Refuse options that are of two cameras."""
    if given:
        raise SsacError(
            f"{given[0]}: is for two cameras, and more were given: leave it out, or give two"
        )


def _check_known_of_two(known: "Known", has_trajectory: bool) -> None:
    """Refuse what two cameras cannot use: of these, the path alone has a scale and a frame."""
    if known.positions is not None:
        raise SsacError(
            "--positions: needs three cameras or more, and two were given: give --distance"
        )
    name = "--distance" if known.distance_m is not None else "--rtk"
    if known != type(known)() and not has_trajectory:
        raise SsacError(f"{name}: is for the object's path: give --trajectory too, or leave it out")


def _to_stderr(line: str) -> None:
    typer.echo(line, err=True)
