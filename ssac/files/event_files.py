"""Reading and writing of event files, in the format that their extension names.

A time offset is a difference of clocks, so a file is of use only if its format keeps absolute
times: the table in docs/sync.md says which formats do.

To add a format, add a module that reads it, and perhaps writes it, and a line in FORMATS and in
that table. NumPy's files are read here: a structured array (.npy), with fields in any order, or an
archive (.npz) of an array `events`, or of one for each of t, x, y and p, and perhaps of the
sensor's `width` and `height`. Nothing is unpickled.
"""

from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ssac.arrays import Events
from ssac.clock import Clock
from ssac.errors import SsacError
from ssac.events import EVENT_DTYPE, US_PER_S, EventFile, events_from_arrays, events_of_array
from ssac.files.damage import STRICT, Reading, check_is_file, checked_file, readable, side_px
from ssac.files.ros_bags import BAG_SUFFIXES, bag_of, load_events_bag
from ssac.files.whole_file import check_writable, whole_file

FORMATS = {
    suffix: (f"ssac.files.{module}", *functions.split())
    for suffixes, module, functions in (
        (".txt", "text", "load_events_text save_events_text"),
        (".csv", "text", "load_events_csv"),
        (".h5 .hdf5", "hdf5", "load_events_h5 save_events_h5"),
        (".npy .npz", "event_files", "load_events_numpy save_events_numpy"),
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


def write_synced(path: Path, cam2: EventFile, clock: Clock) -> None:
    """Write camera 2's events on camera 1's clock [whole us], in the format of the extension."""
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


def load_events_numpy(path: Path, reading: Reading) -> EventFile:
    """Read events that NumPy saved."""
    with readable(path, f"a complete {path.suffix} file of NumPy"):
        if path.suffix.lower() == ".npy":
            arrays = {"events": np.array(np.load(path, mmap_mode="r", allow_pickle=False))}
        else:
            with np.load(path, allow_pickle=False) as archive:
                wanted = {"events", *"txyp", "width", "height"}.intersection(archive.files)
                arrays = {name: archive[name] for name in wanted}
    width, height = (
        side_px(arrays[name], f"{name} must be a number of", path) if name in arrays else None
        for name in ("width", "height")
    )
    return checked_file(_events(arrays, path), (width, height), path, reading, "microseconds")


def save_events_numpy(path: Path, events: Events, width: int | None, height: int | None) -> None:
    """Write events; an archive (.npz) also holds the sensor's size [px] where it is known."""
    check_writable(path, EVENT_DTYPE.itemsize * len(events))
    with whole_file(path) as temporary, temporary.open("wb") as file:
        if path.suffix.lower() == ".npy":
            np.save(file, events)
        else:
            sizes = {"width": width, "height": height}
            arrays = {name: np.asarray(side) for name, side in sizes.items() if side is not None}
            np.savez(file, allow_pickle=False, events=events, **arrays)


def _events(arrays: dict[str, NDArray[Any]], path: Path) -> Events:
    if "events" in arrays and arrays["events"].ndim == 1:
        return events_of_array(arrays["events"], str(path))
    if all(field in arrays for field in "txyp"):
        t, x, y, p = (arrays[field] for field in "txyp")
        return events_from_arrays(t, x, y, p, name=str(path))
    raise SsacError(
        f"{path}: expected a structured array with the fields t [us], x, y and p (in an archive as"
        " `events`, or an array for each of them): save it so"
    )
