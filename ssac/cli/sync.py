"""The command `ssac sync`; slow modules are imported only when it runs, so its help is fast."""

import webbrowser
from functools import partial
from itertools import count, takewhile
from pathlib import Path
from types import SimpleNamespace
from typing import Annotated, Any

import typer

from ssac.cli import options as shared
from ssac.cli.command_line import Sections
from ssac.cli.exits import NO_ESTIMATE, warnings_as_lines
from ssac.cli.options import Option, argument, file_option, flag, named, number, with_options
from ssac.config import CLOCKS, EVENT_SKEW_PRIOR_PPM, INTERVAL_S, MAX_SKEW_PPM, Config
from ssac.errors import SsacError
from ssac.estimate import Status
from ssac.methods.method import DEFAULT, OF_TRACKS, all_summaries


def complete_method(incomplete: str) -> list[tuple[str, str]]:
    """List the methods whose names begin with `incomplete`, and their summaries."""
    return [pair for pair in all_summaries().items() if pair[0].startswith(incomplete)]


OPTIONS = {
    "topics": Option(
        named("T1 T2", "Topics of cameras 1 and 2, of ROS bags with several (BAG/TOPIC does too)."),
        type=tuple[str, str] | None,
    ),
    "known_extrinsics": Option(
        flag("known-extrinsics", "Take the pose from the rig file and find only the offset.")
    ),
    "method": Option(
        typer.Option(
            metavar="NAME",
            help="Method, one of those below.",
            autocompletion=complete_method,
            show_default=f"{DEFAULT}; {OF_TRACKS} with tracks",
        ),
        type=str | None,
    ),
    "cameras": Option(
        named("I J", "Numbers of the two cameras in the rig, from 1."),
        type=tuple[int, int],
        default=(1, 2),
    ),
    "search": Option(
        named(
            "LOW HIGH",
            "Range of offsets t_d to search, in seconds.",
            f"{INTERVAL_S[0]:g} {INTERVAL_S[1]:g}; all offsets for tracks, or where that "
            "leaves no common time",
        ),
        "interval_s",
    ),
    "search_all": Option(
        flag("search-all", "Search all offsets that leave enough common time."),
        "search",
        value="all",
    ),
    "rate_range": Option(
        named(
            "LOW HIGH",
            "Also search the rate of camera 2's clock over camera 1's in this range, at all"
            " offsets: for an unknown frame rate.",
            False,
        ),
        "rates",
    ),
    "skew_prior": Option(
        number(
            "Prior standard deviation of the clock skew; 0: no skew; phones need 1000.",
            0,
            MAX_SKEW_PPM,
            "ppm",
            default_words=f"{EVENT_SKEW_PRIOR_PPM:g}; 1000 with tracks",
        ),
        "skew_prior_ppm",
    ),
    "clock": Option(
        named(
            "NAME",
            "Clock model: affine, or pieces, whose skew changes, as in phones.",
            "affine; pieces for tracks that it does not fit",
        ),
        "clock",
    ),
    "roughness": Option(
        number(
            "With --clock pieces: standard deviation of the change of skew from piece to piece;"
            " variable frame rates need 6000.",
            1,
            MAX_SKEW_PPM,
            "ppm",
        ),
        "roughness_ppm",
    ),
    "estimate_readout": Option(
        flag(
            "estimate-readout",
            "Estimate rolling-shutter readout times that the rig does not give (tracks only).",
        )
    ),
    "json_file": shared.JSON_FILE,
    "plot": file_option("Draw figures: into a folder, or one file (.png, .pdf, .svg).", "PATH"),
    "report": file_option(
        "Write all of it as an HTML page, with a player, that needs no other file."
    ),
    "open_report": Option(flag("open", "Open the page of --report in a browser.")),
    "write_synced": file_option(
        "Write camera 2's events (.h5, .npy, .txt) or track (.csv) on camera 1's clock."
    ),
    "trajectory": file_option(
        "Write the object's path in space: .csv (with deviations), else TUM."
    ),
    "write_rig": file_option(
        "Write the rig with the pose found (Kalibr YAML), for --known-extrinsics."
    ),
    "distance": Option(
        number("Distance between cameras 1 and 2, which sets the scale.", 1e-3, 1e6, "m"),
        type=float | None,
    ),
    "positions": file_option("CSV of camera positions, camera,x_m,y_m,z_m: sets frame and scale."),
    "rtk": file_option("The object's path by RTK, on any clock: sets frame and scale."),
    "lever_arm": shared.LEVER_ARM,
    "focal_std": Option(
        number(
            "Standard deviation of both focal lengths, overriding the rig file.", 0, 20, "percent"
        ),
        type=float | None,
    ),
    "centre_std": Option(
        number(
            "Standard deviation of both principal points, overriding the rig file.", 0, 100, "px"
        ),
        type=float | None,
    ),
    "no_denoise": shared.NO_DENOISE,
    **shared.READING,
    "n_samples": Option(
        number(
            "Number of sample times at which positions are compared.", 20, 100_000, metavar="COUNT"
        ),
        "n_samples",
    ),
    **shared.OF_EVENTS,
    "neighbours": Option(
        number(
            "Noise filter: events needed within 5 px and 5 ms to keep an event.",
            1,
            1000,
            metavar="COUNT",
            default_words="20; adapted to noise and thin objects",
        ),
        "n_neighbours",
    ),
}
"""The options of `ssac sync` by the names of their parameters, in the order of the help."""


@with_options(OPTIONS)
def sync_command(
    cam1: Annotated[
        Path,
        argument(
            "CAM1",
            "Event or track file of camera 1; or alone a folder of ssac simulate, or a ROS bag"
            " of both cameras with --topics.",
        ),
    ],
    cam2: Annotated[Path | None, argument("CAM2", "Event or track file of camera 2.")] = None,
    rig: Annotated[
        Path | None,
        named(
            "FILE",
            "Calibration of the cameras: Kalibr or OpenCV YAML. Of a folder: its own by default.",
            False,
        ),
    ] = None,
    more: Annotated[list[Path] | None, argument("CAM3", "Files of further cameras.")] = None,
    **options: Any,
) -> None:
    """Find the time offset and relative pose of two or more cameras from one moving object.

    Exit code 0: done; 1: the data give no reliable estimate, the output says why; 2: wrong usage,
    or a file that cannot be used; 3: a bug of this program; 130: interrupted.
    """
    given = SimpleNamespace(**options)
    _check_search(given)
    if given.open_report and given.report is None:
        raise SsacError("--open: opens the page of --report: give that too, or leave it out")
    from ssac.cli.outputs import check_outputs, known_of, write_outputs
    from ssac.cli.progress import compilation_told
    from ssac.files.damage import Reading
    from ssac.pipeline.api import sync
    from ssac.pipeline.registry import choose_method

    files = _files([cam1, *filter(None, [cam2]), *(more or ())], given.topics)
    if rig is None:
        if not (cam1 / "cam1.h5").is_file():
            raise SsacError(
                "Missing option '--rig': give a Kalibr camchain or OpenCV's stereo YAML with the"
                " intrinsics of the cameras; docs/sync.md has one to fill in"
            )
        has_pose = choose_method(given.method, given.known_extrinsics).needs_extrinsics
        rig = cam1 / ("rig_extrinsics.yaml" if has_pose else "rig.yaml")
    reading, has_more = Reading(given.allow_damaged, given.sort), len(files) > 2
    config, log = shared.config_of(OPTIONS, options), partial(typer.echo, err=True)
    with warnings_as_lines(), compilation_told():
        check_outputs(files, rig, given)
        known = known_of(given)
        _check_suits(given, has_more)
        result = sync(
            files,
            rig,
            method=given.method,
            config=config,
            known_extrinsics=given.known_extrinsics,
            cameras=given.cameras,
            focal_std=None if given.focal_std is None else 0.01 * given.focal_std,
            centre_std_px=given.centre_std,
            estimate_readout=given.estimate_readout,
            reading=reading,
            known=known if has_more else type(known)(known.distance_m),
            log=log,
        )
        try:
            typer.echo(result.summary())
        finally:  # nobody may read it, and the files are asked for
            write_outputs(result, given, files[1], reading, known, log)
        if given.open_report:
            webbrowser.open(given.report.resolve().as_uri())
    if result.status != "ok":
        raise typer.Exit(NO_ESTIMATE)


def _files(given: list[Path], topics: tuple[str, str] | None) -> list[Path]:
    """Return each camera's file: as given, from a simulated folder, or as topics of bags."""
    from ssac.files.damage import check_is_file
    from ssac.files.ros_bags import SeveralTopicsError, bag_of, topic_of

    if topics is not None:
        bags = 2 * given if len(given) == 1 else given
        if len(bags) != 2 or any((bag_of(bag) or ("", "/"))[1] for bag in bags):
            raise SsacError(
                f"--topics: expected one ROS bag or two, got {' '.join(map(str, given))}: leave it"
                " out, or name each topic behind its bag, as BAG/TOPIC"
            )
        return [bag / topic.strip("/") for bag, topic in zip(bags, topics, strict=True)]
    try:
        found = [topic_of(path) for path in given if bag_of(path) is not None]
    except SeveralTopicsError as error:
        if len(given) > 2 or len({*given}) > 1:  # --topics cannot name these
            raise
        both = f"or both cameras' with --topics {' '.join(error.names[:2])}"
        raise SsacError(f"{error}, {both}") from error
    if len(given) > 1:
        return given
    only = given[0]
    if found:
        raise SsacError(
            f"{only}: one camera's topic, {found[0].name}: give the other camera's file too"
        )
    if not only.is_dir():
        check_is_file(only)
    recorded = [*takewhile(Path.is_file, (only / f"cam{k}.h5" for k in count(1)))]
    if len(recorded) < 2:
        raise SsacError(
            f"{only}: expected two cameras, or a folder with cam1.h5, cam2.h5 and rig.yaml as ssac"
            " simulate writes it: give the files of both cameras"
        )
    return recorded


def _check_search(given: SimpleNamespace) -> None:
    search = given.search
    if search is not None and (given.search_all or given.rate_range is not None):
        raise SsacError("--search: not with --search-all or --rate-range, which try every offset")
    most_s = 3600.0  # longest interval: the time that a search takes grows with it
    if search is not None and not 0.0 < search[1] - search[0] <= most_s:
        raise SsacError(
            "--search: expected a smaller and a larger offset, at most "
            f"{most_s:g} seconds apart, got {search[0]:g} {search[1]:g}"
        )
    if given.clock not in CLOCKS:
        raise SsacError(f"--clock: expected {' or '.join(CLOCKS)}, got {given.clock}")


def help_sections() -> Sections:
    """Return the lists that end the help: methods and an estimate's statuses, with meanings."""
    statuses = [(str(status), status.meaning) for status in Status]
    return {"Methods": list(all_summaries().items()), "Statuses": statuses}


def _check_suits(given: SimpleNamespace, has_more: bool) -> None:
    """Raise SsacError for options that do not suit the number of cameras, or the method."""
    from ssac.pipeline.registry import METHODS

    for_two = {
        "--cameras": given.cameras != (1, 2),
        "--write-synced": given.write_synced,
        "--known-extrinsics": given.known_extrinsics,
        "--estimate-readout": given.estimate_readout,
    }
    refused = [name for name, value in for_two.items() if value and has_more]
    if refused:
        raise SsacError(
            f"{refused[0]}: is for two cameras, and more were given: leave it out, or give two"
        )
    if given.positions is not None and not has_more:
        raise SsacError(
            "--positions: needs three cameras or more, and two were given: give --distance"
        )
    if given.rtk is not None and given.trajectory is None and not has_more:
        raise SsacError("--rtk: is for the object's path: give --trajectory too, or leave it out")

    if given.method not in METHODS or not METHODS[given.method].finds_offset_alone:
        return
    of_poses_and_clocks = {
        "--trajectory": given.trajectory,
        "--write-rig": given.write_rig,
        "--distance": given.distance,
        "--focal-std": given.focal_std,
        "--centre-std": given.centre_std,
        "--skew-prior": given.skew_prior,
        "--clock": None if given.clock == Config.clock else given.clock,
    }
    for name, value in of_poses_and_clocks.items():
        if value is not None:
            raise SsacError(
                f"{name}: is of poses or of the clocks' rates, and {given.method} finds the offset"
                f" alone: leave it out, or use another method, such as {OF_TRACKS}"
            )
