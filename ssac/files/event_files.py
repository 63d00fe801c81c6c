"""Event files in, events out; and events corrected to one clock, out to a file.

The extension names the format. The offset between two cameras is the difference of their clocks, so
a file is only of use when its absolute timestamps survive reading:

=======  ===============================================  ==========================
suffix   format                                           absolute time
=======  ===============================================  ==========================
.h5      HDF5: ours, DSEC's, Prophesee's (`hdf5`)         kept
.txt     ESIM text (`text`)                               kept
.csv     named columns (`text`)                           kept
.aedat4  iniVation AEDAT 4                                kept
.raw     Prophesee EVT2                                   kept
.raw     Prophesee EVT3                                   modulo 2^24 us = 16.8 s
.dat     Prophesee DAT                                    modulo 2^32 us = 71.6 min
.es      Event Stream                                     only if its writer kept it
=======  ===============================================  ==========================

The last five are read by the library faery. It follows the overflows of an EVT3 or DAT clock from
the file's start on, and adds the start back that it stores in the header of the EVT and DAT files
it writes itself. An Event Stream file has no such place: faery and others subtract the first
timestamp on writing, and it is lost, so a file that starts at time 0 gives a warning. RAW, DAT and
ES files have no end mark: a truncated one is a shorter recording. What is damaged in the middle
faery passes over, or is taken down by it, so this is looked at before (`words`, `aedat4`).
"""

import warnings
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ssac.clock import Clock
from ssac.errors import SsacError
from ssac.events import EVENT_DTYPE, US_PER_S, EventFile
from ssac.files.aedat4 import check_packets
from ssac.files.damage import STRICT, Reading, checked_file, refuse_damaged
from ssac.files.hdf5 import HDF5_SUFFIXES, load_events_h5, load_frames, save_events_h5
from ssac.files.net import brief, check_is_file, readable, silenced
from ssac.files.text import load_events_csv, load_events_text, save_events_text
from ssac.files.words import dat_signs, raw_signs

__all__ = [
    "EventFile",
    "Reading",
    "load_events",
    "load_frames",
    "save_events_h5",
    "save_events_text",
    "write_synced",
]

_ENDS = (KeyboardInterrupt, SystemExit)

_VIDEO = "; of a video, give the object's track (docs/sync.md, Tracks of any camera)"
_BAG = "; convert the events of a ROS bag to one of these (docs/sync.md, Event files)"
_WAYS = dict.fromkeys((".avi", ".mkv", ".mov", ".mp4"), _VIDEO) | dict.fromkeys(
    (".bag", ".db3", ".mcap"), _BAG
)
"""What to do with files that are likely to be given, and are no event files."""

UNKNOWN_SIZE = (65535, 65535)
"""What faery is told to assume when a header does not give the sensor's size."""


def load_events(path: Path | str, reading: Reading = STRICT) -> EventFile:
    """Read an event file of any format in the table above.

    Parameters
    ----------
    path
        The file; its extension names its format.
    reading
        What may be made of a file that is damaged or unsorted.

    Returns
    -------
    EventFile
        Events, sorted, on the clock of the camera that recorded them; the sensor's size where the
        file gives it.

    Raises
    ------
    SsacError
        If the file is missing, of unknown extension, empty, truncated (where that can be seen),
        unsorted, damaged, or has events outside its own sensor. The message names the file.
    """
    path = Path(path)
    if path.is_dir():
        raise SsacError(f"{path}: is a folder: give a file of one camera's events in it")
    reader = _READERS.get(path.suffix.lower())
    if reader is None:
        raise SsacError(
            f"{path}: unknown extension {path.suffix!r}: use one of {', '.join(sorted(_READERS))}"
            f"{_WAYS.get(path.suffix.lower(), '')}"
        )
    check_is_file(path)
    if path.stat().st_size == 0:
        raise SsacError(f"{path}: the file is empty (0 bytes): record or copy it again")
    return reader(path, reading)


def write_synced(path: Path | str, cam2: EventFile, clock: Clock) -> None:
    """Write camera 2's events on camera 1's clock.

    Parameters
    ----------
    path
        File to write, HDF5 or ESIM text by its extension.
    cam2
        Camera 2's events on its own clock.
    clock
        Camera 2's; what it shows is rounded to whole microseconds.

    Raises
    ------
    SsacError
        If the extension is neither HDF5's nor .txt.
    """
    path = Path(path)
    writers = dict.fromkeys(HDF5_SUFFIXES, save_events_h5) | {".txt": save_events_text}
    writer = writers.get(path.suffix.lower())
    if writer is None:
        raise SsacError(
            f"{path}: cannot write the extension {path.suffix!r}: use one of "
            f"{', '.join(sorted(writers))}"
        )
    events = cam2.events.copy()
    if clock.is_delay:
        events["t"] -= round(clock.t_d_s * US_PER_S)
    else:
        events["t"] = np.rint(US_PER_S * clock.cam1_from_cam2(events["t"] / US_PER_S))
    writer(path, events, cam2.width, cam2.height)


def _load_makers_file(path: Path, reading: Reading) -> EventFile:
    """Read a camera maker's format through faery."""
    refuse_damaged(path, _signs(path), reading)
    file = checked_file(*_decoded(path, reading), path, reading)
    if path.suffix.lower() == ".es" and file.events["t"][0] == 0:
        warnings.warn(
            f"{path} starts at time 0: whoever wrote it may have subtracted its first timestamp, "
            "and the offset found is then off by it",
            stacklevel=3,
        )
    return file


def _decoded(
    path: Path, reading: Reading
) -> tuple[NDArray[np.void], tuple[int | None, int | None]]:
    """Events, and the sensor's size; fewer of them where that is allowed."""
    import faery  # here, as it takes long: other formats do without it

    blocks: list[NDArray[Any]] = [np.empty(0, faery.EVENTS_DTYPE)]
    with _net(path), silenced():
        stream = faery.events_stream_from_file(path, dimensions_fallback=UNKNOWN_SIZE)
        width, height = stream.dimensions()
        try:
            blocks.extend(stream)
        except BaseException as error:  # the library's panics are no Exception
            if len(blocks) == 1 or not reading.allow_damaged or isinstance(error, _ENDS):
                raise
            n_read = sum(map(len, blocks))
            warnings.warn(
                f"{path} can be read no further than its first {n_read} events ({brief(error)})",
                stacklevel=4,
            )
    # Both dtypes have the fields t, x, y, p of 8, 2, 2 and 1 bytes in this order.
    events = np.concatenate(blocks).view(EVENT_DTYPE)
    return events, (None, None) if (width, height) == UNKNOWN_SIZE else (width, height)


def _net(path: Path) -> AbstractContextManager[None]:
    return readable(path, f"a complete {path.suffix} file")


def _signs(path: Path) -> list[str]:
    """Look for damage that faery passes over, or that would take it down."""
    suffix = path.suffix.lower()
    if suffix == ".aedat4":
        return check_packets(path)
    if suffix == ".dat":
        return dat_signs(path)
    return raw_signs(path, _evt_version(path)) if suffix == ".raw" else []


def _evt_version(path: Path) -> str:
    """Version in a RAW file's header; SsacError without one that faery can decode."""
    import faery

    with _net(path), silenced(), faery.evt.Decoder(path, UNKNOWN_SIZE, None) as decoder:
        version = str(decoder.version)
    if version not in ("evt2", "evt3"):
        raise SsacError(f"{path}: its encoding is {version}: convert it to EVT2 or EVT3")
    return version


_READERS: dict[str, Callable[[Path, Reading], EventFile]] = {
    **dict.fromkeys(HDF5_SUFFIXES, load_events_h5),
    ".txt": load_events_text,
    ".csv": load_events_csv,
    **dict.fromkeys((".aedat4", ".raw", ".dat", ".es"), _load_makers_file),
}
