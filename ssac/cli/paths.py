"""The commands `ssac track` and `ssac import`, which make track files, and `ssac compare`."""

import warnings
from pathlib import Path
from types import SimpleNamespace
from typing import Annotated, Any, Literal

import typer

from ssac.cli import options as shared
from ssac.cli.exits import warnings_as_lines
from ssac.cli.options import Option, argument, config_of, flag, named, number, with_options
from ssac.errors import SsacError

OPTIONS = {
    "camera": Option(
        number("Number of this camera in the rig.", 1, 1000, metavar="K"), type=int, default=1
    ),
    "no_denoise": shared.NO_DENOISE,
    "faint": Option(
        flag(
            "faint",
            "Follow an object so small and far away that the noise filter would remove its"
            " events. Usually with --half-window 0.05 --n-min 8.",
        )
    ),
    **shared.READING,
    **shared.OF_EVENTS,
}
"""The options of `ssac track` by the names of their parameters."""

SCALES = ("unknown", "known")


@with_options(OPTIONS)
def track_command(
    cam: Annotated[Path, argument("CAM", "Event file of one camera.")],
    rig: Annotated[Path, named("FILE", "Calibration: Kalibr or OpenCV YAML.", False)],
    out: Annotated[Path, named("FILE", "Track file to write (.csv).", False)],
    **options: Any,
) -> None:
    """Write the path of the one moving object as a track file: t_s,x_px,y_px,sigma_px."""
    given = SimpleNamespace(**options)
    from ssac.cli.progress import compilation_told
    from ssac.files.damage import Reading
    from ssac.files.rigs import load_rig
    from ssac.files.ros_bags import file_of
    from ssac.files.track_files import TRACK_SUFFIX, is_track_file, save_track
    from ssac.files.whole_file import check_targets
    from ssac.pipeline.opened import Recording
    from ssac.search.object_track import things_seen, track_of_events
    from ssac.track.clean import clean
    from ssac.track.faint import faint_object_events
    from ssac.track.observation import Observation

    if out.suffix.lower() != TRACK_SUFFIX:
        raise SsacError(f"{out}: a track is written as {TRACK_SUFFIX}: name such a file")
    if given.faint and given.no_denoise:
        raise SsacError("--faint tells the object from noise, --no-denoise keeps it: leave one out")
    check_targets((out,), (file_of(cam),))
    if is_track_file(cam):
        raise SsacError(f"{cam}: is a track already: give a camera's events")
    calibrated = load_rig(rig, (given.camera, given.camera)).cam1
    name, reading = f"camera {given.camera} of {rig}", Reading(given.allow_damaged, given.sort)
    with warnings_as_lines():
        events = Recording(cam, calibrated, name, reading).read().events
    config = config_of(OPTIONS, options | {"no_denoise": given.no_denoise or given.faint})
    shape = calibrated.width, calibrated.height
    try:
        with compilation_told():
            if given.faint:
                events = faint_object_events(events, *shape, config.rules)
            seen = clean(Observation(events), calibrated, config.cleaning)
            track = track_of_events(seen, config)
            n_things = things_seen(seen, config.rules.objects)
    except SsacError as error:
        raise SsacError(f"{cam}: {error}") from error
    if n_things > 1:
        with warnings_as_lines():
            warnings.warn(
                f"{cam}: {n_things} things move at a time, and the track lies between them: give "
                "the events themselves to ssac sync, which tells the one that all cameras see",
                stacklevel=1,
            )
    save_track(out, track)
    typer.echo(
        f"{out}: {len(track)} points from {track.times_s[0]:.3f} to {track.times_s[-1]:.3f} s"
    )


def import_command(
    form: Annotated[Literal["drone-tracking"], argument("FORM", "Data set: drone-tracking.")],
    folder: Annotated[Path, argument("FOLDER", "Folder of one data set.")],
    out: Annotated[Path, argument("OUT", "Folder to write cam*.csv and rig.yaml to.")],
) -> None:
    """Turn a public data set into track files and a rig.

    drone-tracking: a folder dataset1 ... dataset5 of github.com/CenekAlbl/drone-tracking-datasets.
    """
    from ssac.files.drone_tracking import import_data_set
    from ssac.files.whole_file import check_folder

    if out.exists() and (not out.is_dir() or (folder.exists() and out.samefile(folder))):
        raise SsacError(f"{out}: not a folder to write to: name another")
    check_folder(out)
    for camera in import_data_set(folder, out):
        left_out = f", {camera.n_outside} outside the image left out" if camera.n_outside else ""
        start_s, end_s = camera.track.times_s[[0, -1]]
        typer.echo(
            f"{out / camera.name}.csv: {camera.model}, {len(camera.track)} points from "
            f"{start_s:.1f} to {end_s:.1f} s at {camera.fps:g} frames/s{left_out}"
        )
    typer.echo(f"{out / 'rig.yaml'}")


def compare_command(
    estimate: Annotated[Path, argument("ESTIMATE", "Estimated path.")],
    truth: Annotated[Path, argument("TRUTH", "Reference path, such as RTK.")],
    scale: Annotated[str, named("|".join(SCALES), "known: the estimate is in metres.")] = SCALES[0],
    max_shift: Annotated[
        float | None,
        number(
            "Largest shift of the truth's clock to try, either way.",
            0,
            1e10,
            "seconds",
            default_words="all that leave enough common time",
        ),
    ] = None,
    rate_std: Annotated[
        float,
        number(
            "Prior standard deviation of the clocks' relative rate; 0: same rate.", 0, 10_000, "ppm"
        ),
    ] = 50.0,
    lever_arm: Annotated[tuple[float, float, float] | None, shared.LEVER_ARM.info] = None,
    plot: Annotated[Path | None, named("FILE", "Figure to write (.png, .pdf, .svg).")] = None,
    json_file: Annotated[Path | None, shared.JSON_FILE.info] = None,
) -> None:
    """Say how far a path is from the truth, at equal times and as a shape.

    Paths are TUM (t x y z qx qy qz qw), csv (t_s,x_m,y_m,z_m) or rows of x y z. Frame, scale, time
    shift and clock rate are found.
    """
    from ssac.files.whole_file import FIGURE_SUFFIXES, check_targets
    from ssac.network.comparison import compare
    from ssac.network.tum import read_path
    from ssac.pipeline.report import save_json, text_of

    if scale not in SCALES:
        raise SsacError(f"--scale: expected {' or '.join(SCALES)}, got {scale!r}")
    check_targets((plot, json_file), (estimate, truth))
    if plot is not None and plot.suffix.lower() not in FIGURE_SUFFIXES:
        raise SsacError(f"{plot}: a figure is a file ending in {', '.join(FIGURE_SUFFIXES)}")
    paths = read_path(estimate, needs_times=False), read_path(truth, needs_times=False)
    found = compare(*paths, scale == "unknown", max_shift, rate_std, lever_arm)
    if json_file is not None:
        save_json(json_file, found.figures())
    if plot is not None:
        from ssac.pipeline.plots import draw_comparison, save

        save(draw_comparison(found), plot, 130)
    rows = [("at equal times", "no: there are no times in both")]
    if found.in_time is not None:
        clock, off = found.in_time.clock, _in_words(found.in_time.figures())
        shift = f"truth = estimate {clock.t_d_s:+.4f} s, {clock.skew_ppm:+.1f} ppm"
        covered = f"{100.0 * found.in_time.coverage:.1f} % of the truth's covered"
        explained = f"{100.0 * found.in_time.explained:.2f} % of its motion explained"
        rows = [
            ("clock", f"{shift}; holds at {clock.t_ref_s:.3f} s of the estimate's"),
            ("at equal times", f"{off}, {covered}, {explained}"),
        ]
    typer.echo(text_of([*rows, ("as shapes, ICP", _in_words(found.as_shape.figures()))]))


def _in_words(figures: dict[str, float | int]) -> str:
    return (
        "RMSE {rmse_m:.4f} m, median {median_m:.4f} m, max {max_m:.4f} m, scale {scale:.6g}, "
        "{n_samples} samples"
    ).format(**figures)
