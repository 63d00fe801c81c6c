"""A data set of others in, files of ours out: `ssac import`."""

from enum import Enum
from pathlib import Path
from typing import Annotated

import typer

from ssac.errors import SsacError


class Form(str, Enum):
    """What can be imported."""

    DRONE_TRACKING = "drone-tracking"


def import_command(
    form: Annotated[
        Form, typer.Argument(metavar="FORM", help="Data set: drone-tracking.", show_default=False)
    ],
    folder: Annotated[
        Path, typer.Argument(metavar="FOLDER", help="Folder of one data set.", show_default=False)
    ],
    out: Annotated[
        Path,
        typer.Argument(metavar="OUT", help="Folder to write cam*.csv and rig.yaml to."),
    ],
) -> None:
    """Turn a public data set into track files and a rig.

    drone-tracking: a folder dataset1 ... dataset5 of github.com/CenekAlbl/drone-tracking-datasets.
    """
    from ssac.convert.drone_tracking import import_data_set
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
