"""A command line in, offset and pose on stdout and in files out: `ssac sync`.

What takes long to import is imported when the command runs, not for its help.
"""

from importlib import import_module
from pathlib import Path
from typing import Annotated, Any

import typer

from ssac.config import CLOCKS, MAX_SKEW_PPM, Config
from ssac.console.command_line import Sections
from ssac.console.event_options import AllowDamaged, NoDenoise, Sort, n_min_of
from ssac.console.exits import NO_ESTIMATE, warnings_as_lines
from ssac.console.options import number
from ssac.errors import SsacError
from ssac.tool.summaries import DEFAULT, OF_TRACKS, all_summaries

_SEARCH_DEFAULT = (
    f"{Config.interval_s[0]:g} {Config.interval_s[1]:g}; all offsets for tracks, or where that "
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
            default_words=f"{Config.skew_prior_ppm:g}; 1000 with tracks",
        ),
    ] = None,
    clock: Annotated[
        str,
        typer.Option(
            metavar="NAME", help="Clock model: affine, or pieces, whose skew changes, as in phones."
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
    from ssac.files.damage import Reading
    from ssac.files.track_files import is_track_file
    from ssac.tool.everywhere import SKEW_PRIOR_PPM
    from ssac.tool.many import (
        check_for_two,
        check_known_of_two,
        known_of,
        sync_all,
        write_path_of_two,
    )
    from ssac.tool.many_report import many_text, write_many
    from ssac.tool.outputs import Outputs, check_outputs, write_outputs
    from ssac.tool.report import report_text
    from ssac.tool.sync import sync

    files, as_read = [cam1, cam2, *(more or ())], Reading(allow_damaged, sort)
    outputs = Outputs(json_file, plot, write_synced, trajectory)
    if skew_prior is None:
        has_track = any(map(is_track_file, files))
        skew_prior = SKEW_PRIOR_PPM if has_track else Config.skew_prior_ppm
    config = Config(
        interval_s=search or Config.interval_s,
        n_samples=n_samples,
        half_window_s=half_window,
        n_min=n_min,
        n_neighbours=neighbours,
        denoise=not no_denoise,
        skew_prior_ppm=skew_prior,
        clock=clock,
        roughness_ppm=roughness,
    )
    with warnings_as_lines():
        check_outputs([*files, rig, *filter(None, (positions, rtk))], outputs)
        known = known_of(distance, positions, rtk, lever_arm)
        if more:
            for_two = {
                "--cameras": cameras != (1, 2),
                "--search": search,
                "--rate-range": rate_range,
                "--plot": plot,
                "--write-synced": write_synced,
                "--known-extrinsics": known_extrinsics,
                "--estimate-readout": estimate_readout,
                "--focal-std": focal_std is not None,
                "--centre-std": centre_std is not None,
            }
            check_for_two([name for name, value in for_two.items() if value])
            everywhere = search_all or None
            every = sync_all(files, rig, method, config, _to_stderr, known, everywhere, as_read)
            typer.echo(many_text(every))
            write_many(every, json_file, trajectory, _to_stderr)
            if every.answer.status != "ok":
                raise typer.Exit(NO_ESTIMATE)
            return
        check_known_of_two(known, trajectory is not None)
        result = sync(
            cam1,
            cam2,
            rig,
            method,
            known_extrinsics,
            config,
            log=_to_stderr,
            cameras=cameras,
            search_all=True if search_all else None if search is None else False,
            rate_range=rate_range,
            focal_std=None if focal_std is None else 0.01 * focal_std,
            centre_std_px=centre_std,
            reading=as_read,
            estimate_readout=estimate_readout,
        )
        typer.echo(report_text(result))
        write_outputs(result, outputs, _to_stderr)
        if trajectory is not None:
            write_path_of_two(trajectory, result, known, _to_stderr)
    if result.estimate.status != "ok":
        raise typer.Exit(NO_ESTIMATE)


def help_sections() -> Sections:
    """List the methods, and what an estimate's status may be, below the help."""
    estimate: Any = import_module("ssac.estimate")
    statuses = [(str(status), status.meaning) for status in getattr(estimate, "Status", ())]
    return {
        "Methods": list(all_summaries().items()),
        **({"Statuses": statuses} if statuses else {}),
    }


def _to_stderr(line: str) -> None:
    typer.echo(line, err=True)
