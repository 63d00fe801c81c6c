"""Reading and writing of event files, in the format that their extension names.

A time offset is a difference of clocks, so a file is of use only if its format keeps absolute
times: the table in docs/sync.md says which formats do.

To add a format, add a module that reads it, and perhaps writes it, and a line in FORMATS and in
that table.
"""

from importlib import import_module
from pathlib import Path

import numpy as np

from ssac.clock import Clock
from ssac.errors import SsacError
from ssac.events import US_PER_S, EventFile
from ssac.files.damage import STRICT, Reading
from ssac.files.readable import check_is_file
from ssac.files.ros_bags import BAG_SUFFIXES, bag_of, load_events_bag

FORMATS = {
    suffix: (f"ssac.files.{module}", *functions.split())
    for suffixes, module, functions in (
        (".txt", "text", "load_events_text save_events_text"),
        (".csv", "text", "load_events_csv"),
        (".h5 .hdf5", "hdf5", "load_events_h5 save_events_h5"),
        (".npy .npz", "numpy_files", "load_events_numpy save_events_numpy"),
        (".aedat4 .raw .dat .es", "makers", "load_makers_file"),
        (" ".join(BAG_SUFFIXES), "ros_bags", "load_events_bag"),
    )
    for suffix in suffixes.split()
}
"""For each extension: the module to import when it is needed; its function (path, reading) that
returns an EventFile; and, if it can write, its function (path, events, width, height)."""

WRITTEN = tuple(suffix for suffix, (_, *functions) in FORMATS.items() if len(functions) == 2)
"""Extensions of the formats that can be written."""

_VIDEOS = (".avi", ".mkv", ".mov", ".mp4")


def load_events(path: Path | str, reading: Reading = STRICT) -> EventFile:
    """Read an event file in the format of its extension, or a topic of a ROS bag as BAG/TOPIC.

    Events are sorted by time, on the clock of the camera that recorded them; the sensor's size is
    None if the file does not state it. SsacError, which names the file, if the file cannot be
    read, is damaged or unsorted.
    """
    path = Path(path)
    if bag_of(path) is not None:
        return load_events_bag(path, reading)
    if path.is_dir():
        raise SsacError(f"{path}: is a folder: give a file of one camera's events in it")
    suffix = path.suffix.lower()
    if suffix not in FORMATS:
        way = "; of a video, give the object's track (docs/sync.md, Tracks of any camera)"
        raise SsacError(
            f"{path}: unknown extension {path.suffix!r}: use one of {', '.join(sorted(FORMATS))}"
            f"{way if suffix in _VIDEOS else ''}"
        )
    check_is_file(path)
    if path.stat().st_size == 0:
        raise SsacError(f"{path}: the file is empty (0 bytes): record or copy it again")
    module, reader, *_ = FORMATS[suffix]
    found: EventFile = getattr(import_module(module), reader)(path, reading)
    return found


def write_synced(path: Path | str, cam2: EventFile, clock: Clock) -> None:
    """Write camera 2's events on camera 1's clock [whole us], in the format of the extension."""
    path = Path(path)
    check_written(path)
    events = cam2.events.copy()
    if clock.is_delay:
        events["t"] -= round(clock.t_d_s * US_PER_S)
    else:
        events["t"] = np.rint(US_PER_S * clock.cam1_from_cam2(events["t"] / US_PER_S))
    module, _, writer = FORMATS[path.suffix.lower()]
    getattr(import_module(module), writer)(path, events, cam2.width, cam2.height)


def check_written(path: Path, suffixes: tuple[str, ...] = WRITTEN) -> None:
    """Raise SsacError unless a file's extension is one of `suffixes`, which can be written."""
    if path.suffix.lower() not in suffixes:
        raise SsacError(
            f"{path}: cannot write the extension {path.suffix!r}: use one of "
            f"{', '.join(sorted(suffixes))}"
        )
