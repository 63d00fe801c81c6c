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
    f"{Config.interval_s[0]:g} {Config.interval_s[1]:g}; all where a file is a track, or where "
    "that leaves no common time"
)

MAX_SEARCH_S = 3600.0
"""Width of a search interval that still ends: its time is proportional to it."""


def complete_method(incomplete: str) -> list[tuple[str, str]]:
    """List the methods for a shell that completes a name."""
    return [pair for pair in all_summaries().items() if pair[0].startswith(incomplete)]


def sync_command(
    cam1: Annotated[
        Path,
        typer.Argument(metavar="CAM1", help="Events, or a track, of camera 1.", show_default=False),
    ],
    cam2: Annotated[
        Path,
        typer.Argument(metavar="CAM2", help="Events, or a track, of camera 2.", show_default=False),
    ],
    rig: Annotated[
        Path,
        typer.Option(
            metavar="FILE", help="Kalibr or OpenCV YAML of both cameras.", show_default=False
        ),
    ],
    more: Annotated[
        list[Path] | None,
        typer.Argument(metavar="CAM3 ...", help="Of more cameras.", show_default=False),
    ] = None,
    known_extrinsics: Annotated[
        bool,
        typer.Option(
            "--known-extrinsics", help="Use the pose that the rig file gives; find the offset."
        ),
    ] = False,
    method: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="How to find them: see the methods below.",
            autocompletion=complete_method,
            show_default=f"{DEFAULT}; {OF_TRACKS} where a file is a track",
        ),
    ] = None,
    cameras: Annotated[
        tuple[int, int],
        typer.Option(metavar="I J", help="Which cameras of the rig they are, from 1 on."),
    ] = (1, 2),
    search: Annotated[
        tuple[float, float] | None,
        typer.Option(
            metavar="LOW HIGH",
            help="Least and largest offset t_d to try, in seconds.",
            show_default=_SEARCH_DEFAULT,
        ),
    ] = None,
    search_all: Annotated[
        bool,
        typer.Option(
            "--search-all", help="Try every offset that leaves the cameras enough common time."
        ),
    ] = False,
    rate_range: Annotated[
        tuple[float, float] | None,
        typer.Option(
            metavar="LOW HIGH",
            help="As --search-all, and camera 2's clock may run so many times as fast as camera 1's"
            ": where a frame rate is unknown.",
            show_default=False,
        ),
    ] = None,
    skew_prior: Annotated[
        float | None,
        number(
            "Prior deviation of the clocks' skew; phones need 1000; 0: they run alike.",
            0,
            MAX_SKEW_PPM,
            "ppm",
            default_words=f"{Config.skew_prior_ppm:g}; 1000 where a file is a track",
        ),
    ] = None,
    clock: Annotated[
        str,
        typer.Option(
            metavar="NAME", help="affine; or pieces, where the skew itself changes, as in phones."
        ),
    ] = Config.clock,
    roughness: Annotated[
        float,
        number(
            "Deviation of a piece's skew from that of the last; variable frame rates need 6000.",
            1,
            MAX_SKEW_PPM,
            "ppm",
        ),
    ] = Config.roughness_ppm,
    estimate_readout: Annotated[
        bool,
        typer.Option(
            "--estimate-readout",
            help="Find the readouts of rolling shutters, of tracks, that the rig does not state.",
        ),
    ] = False,
    json_file: Annotated[
        Path | None,
        typer.Option("--json", metavar="FILE", help="Write the result for machines."),
    ] = None,
    plot: Annotated[
        Path | None,
        typer.Option(
            metavar="PATH", help="Draw the result: a folder for all figures, or .png, .pdf, .svg."
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
            metavar="FILE", help="Write the object's path: .csv with deviations, else TUM."
        ),
    ] = None,
    distance: Annotated[
        float | None,
        number("Between cameras 1 and 2, for the scale of all.", 1e-3, 1e6, "m"),
    ] = None,
    positions: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="Where cameras stand, camera,x_m,y_m,z_m: the frame of all."
        ),
    ] = None,
    rtk: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="The object's path by RTK, on its own clock: likewise."),
    ] = None,
    lever_arm: Annotated[
        tuple[float, float, float] | None,
        number(
            "Where RTK's antenna is in the body: forward, left, up. Needs its attitude.",
            -100,
            100,
            "metres",
            metavar="X Y Z",
        ),
    ] = None,
    focal_std: Annotated[
        float | None,
        number(
            "Deviation of both cameras' focal lengths, in place of the rig's.", 0.0, 20.0, "percent"
        ),
    ] = None,
    centre_std: Annotated[
        float | None,
        number(
            "Deviation of both cameras' principal points, in place of the rig's.", 0.0, 100.0, "px"
        ),
    ] = None,
    no_denoise: NoDenoise = False,
    allow_damaged: AllowDamaged = False,
    sort: Sort = False,
    n_samples: Annotated[
        int,
        number("Times at which the object's positions are compared.", 20, 100_000, metavar="COUNT"),
    ] = Config.n_samples,
    half_window: Annotated[
        float,
        number(
            "Events this long before and after such a time give a position.", 0.001, 0.25, "seconds"
        ),
    ] = Config.half_window_s,
    n_min: Annotated[int | None, n_min_of("a position")] = None,
    neighbours: Annotated[
        int | None,
        number(
            "Other events within 5 px, 5 ms that keep an event from being taken for noise.",
            1,
            1000,
            metavar="COUNT",
            default_words="20; by the noise that is there, and for a thin object fewer",
        ),
    ] = None,
) -> None:
    """Find the time offset and the relative pose of two cameras, or more, from one moving object.

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
