"""The commands `ssac track` and `ssac import`, which make track files from other recordings."""

import warnings
from pathlib import Path
from types import SimpleNamespace
from typing import Annotated, Any, Literal

import typer

from ssac.cli.exits import warnings_as_lines
from ssac.cli.options import (
    NO_DENOISE,
    OF_EVENTS,
    READING,
    Option,
    argument,
    config_of,
    flag,
    named,
    number,
    with_options,
)
from ssac.errors import SsacError

OPTIONS = {
    "camera": Option(
        number("Number of this camera in the rig.", 1, 1000, metavar="K"), type=int, default=1
    ),
    "no_denoise": NO_DENOISE,
    "faint": Option(
        flag(
            "faint",
            "Follow an object so small and far away that the noise filter would remove its"
            " events. Usually with --half-window 0.05 --n-min 8.",
        )
    ),
    **READING,
    **OF_EVENTS,
}


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
