"""The files that `ssac sync` writes of two cameras: JSON, figures, synchronised events."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ssac.errors import SsacError
from ssac.files.damage import Reading
from ssac.files.event_files import load_events, write_synced
from ssac.files.hdf5 import HDF5_SUFFIXES
from ssac.files.track_files import TRACK_SUFFIX, is_track_file, load_track, save_track
from ssac.files.whole_file import check_folder, check_targets
from ssac.pipeline.answer import Log, Stopwatch
from ssac.pipeline.api import Result
from ssac.pipeline.report import save_json
from ssac.plot.style import FILE_SUFFIXES

_SYNCED_SUFFIXES = (*HDF5_SUFFIXES, ".txt")


@dataclass(frozen=True)
class Outputs:
    """Where to write; None: not asked for."""

    json_file: Path | None = None
    plot: Path | None = None  # a folder, or one file for all figures
    synced: Path | None = None  # camera 2's events on camera 1's clock
    trajectory: Path | None = None  # the object's path


def check_outputs(inputs: Sequence[Path], outputs: Outputs) -> None:
    """Raise SsacError, before any work is done, for outputs that cannot be written.

    Parameters
    ----------
    inputs
        All files that are read, camera 2's the second.
    outputs
        What was asked for.
    """
    synced, plot = outputs.synced, outputs.plot
    suffixes = (TRACK_SUFFIX,) if is_track_file(inputs[1]) else _SYNCED_SUFFIXES
    if synced is not None and synced.suffix.lower() not in suffixes:
        raise SsacError(
            f"{synced}: cannot write the extension {synced.suffix!r}: use one of "
            f"{', '.join(suffixes)}"
        )
    files = [outputs.json_file, synced, outputs.trajectory]
    if plot is not None and _is_figure(plot):
        files.append(plot)
    elif plot is not None:
        check_folder(plot)
    check_targets(files, inputs)


def write_outputs(result: Result, outputs: Outputs, cam2: Path, reading: Reading, log: Log) -> None:
    """Write what was asked for and say so; synchronised events only where the offset holds.

    Parameters
    ----------
    result
        Of two cameras.
    outputs
        What was asked for.
    cam2, reading
        Camera 2's file, and how it was read.
    log
        Called with a line on each file.
    """
    clock = Stopwatch(log)
    estimate, synced = result.estimate, outputs.synced
    if outputs.json_file is not None:
        save_json(outputs.json_file, result.answer)
        log(f"wrote {outputs.json_file}")
    if outputs.plot is not None:
        with clock.part("draw") as say:
            drawn = result.plotted(outputs.plot)
            say(", ".join(map(str, drawn)) or "nothing: the method left no curve and no track")
    if synced is not None and estimate.has_offset:
        with clock.part("write") as say:
            # Read again, whole: what is in memory has been denoised.
            _write_synced(synced, result, cam2, reading)
            known = np.isfinite(estimate.t_d_std_s)
            say(str(synced) if known else f"{synced}, by an offset of unknown accuracy")
    elif synced is not None:
        log(f"not written: {synced}, since there is no reliable offset")


def _write_synced(path: Path, result: Result, cam2: Path, reading: Reading) -> None:
    """Write camera 2's events or points on camera 1's clock."""
    clock = result.estimate.clock
    if not is_track_file(cam2):
        write_synced(path, load_events(cam2, reading), clock)
        return
    track = load_track(cam2)
    save_track(path, replace(track, times_s=clock.cam1_from_cam2(track.times_s)))


def _is_figure(plot: Path) -> bool:
    """Tell a file for all figures from a folder for them; SsacError for what can be neither."""
    if plot.suffix.lower() in FILE_SUFFIXES:
        return True
    if plot.exists() and not plot.is_dir():
        raise SsacError(
            f"{plot}: exists and is no folder: name a folder, or a file ending in "
            f"{', '.join(FILE_SUFFIXES)}"
        )
    return False
