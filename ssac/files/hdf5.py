"""HDF5 recordings: events and intensity frames, in and out.

Three layouts are read: ours (`events/t`, `x`, `y`, `p`; the sensor's width and height as attributes
of the file or of `events`), DSEC's (the same datasets, times relative to the dataset `t_offset`,
blosc compression) and Prophesee's (`CD/events`, size in the attribute `geometry`). All of them
carry absolute time.
"""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py
import hdf5plugin  # noqa: F401  its import registers blosc and other filters with h5py
import numpy as np
from numpy.typing import NDArray

from ssac.errors import SsacError
from ssac.events import EVENT_DTYPE, EventFile, check_events, check_lengths, field_values
from ssac.files.whole_file import whole_file

HDF5_SUFFIXES = (".h5", ".hdf5")
FIELDS = ("t", "x", "y", "p")

EVENTS_PER_BLOCK = 1 << 18
"""Events read at once: few enough to stay in the processor's cache until they are in place."""


def load_events_h5(path: Path) -> EventFile:
    """Read the events of an HDF5 file in any of the three layouts.

    Raises
    ------
    SsacError
        If the file is damaged, in another layout, or its events fail `check_events`.
    """
    with _open_h5(path) as file:
        width, height = _sensor_size(file)
        if "CD/events" in file:
            cd = file["CD/events"]
            events = _read_blocks(len(cd), cd.__getitem__, path)
        elif all(f"events/{field}" in file for field in FIELDS):
            columns = {field: file[f"events/{field}"] for field in FIELDS}
            check_lengths({field: column.shape for field, column in columns.items()}, str(path))
            events = _read_blocks(
                len(columns["t"]), lambda block: {f: columns[f][block] for f in FIELDS}, path
            )
            if "t_offset" in file:
                events["t"] += int(file["t_offset"][()])
        else:
            raise SsacError(
                f"{path}: expected the datasets events/t, events/x, events/y, events/p, or "
                f"CD/events; the file has {sorted(file)}: convert it to one of these layouts"
            )
    check_events(events, width, height, name=str(path))
    return EventFile(events, width, height)


def load_frames(path: Path | str) -> tuple[NDArray[np.int64], NDArray[np.uint8]] | None:
    """Read the intensity frames of a recording.

    Parameters
    ----------
    path
        Event file; only our HDF5 layout can hold frames, in `frames/t` and `frames/images`.

    Returns
    -------
    tuple of NDArray, or None
        Times of mid-exposure, shape (n,) [us], and images, shape (n, height, width), uint8. None
        when the file has no frames.

    Raises
    ------
    SsacError
        If the file is damaged, or times and images do not belong together.
    """
    path = Path(path)
    if path.suffix.lower() not in HDF5_SUFFIXES:
        return None
    with _open_h5(path) as file:
        if "frames/t" not in file or "frames/images" not in file:
            return None
        times_us, images = file["frames/t"][:], file["frames/images"][:]
    if images.ndim != 3 or images.dtype != np.uint8 or times_us.shape != images.shape[:1]:
        raise SsacError(
            f"{path}: expected frames/images as (n, height, width) uint8 with n times in frames/t, "
            f"got {images.shape} {images.dtype} and {times_us.shape} times: write the frames again"
        )
    if times_us.dtype.kind not in "iu" or np.any(np.diff(times_us.astype(np.int64)) <= 0):
        raise SsacError(
            f"{path}: frames/t must hold increasing whole microseconds: write the frames again"
        )
    return times_us.astype(np.int64), images


def save_events_h5(
    path: Path | str, events: NDArray[np.void], width: int | None, height: int | None
) -> None:
    """Write events in our HDF5 layout; the file appears only when it is complete.

    Parameters
    ----------
    path
        File to write; one that exists is replaced.
    events
        Events, dtype EVENT_DTYPE, shape (N,); times are written as they are.
    width, height
        Sensor size [px]; None leaves the attribute out.
    """
    with whole_file(Path(path)) as temporary, h5py.File(temporary, "w") as file:
        for field in FIELDS:
            file[f"events/{field}"] = events[field]
        for key, value in (("width", width), ("height", height)):
            if value is not None:
                file.attrs[key] = value


def _read_blocks(
    n_events: int, read: Callable[[slice], Mapping[str, NDArray[Any]]], path: Path
) -> NDArray[np.void]:
    """Event array filled block by block; `read` gives the fields of a slice of the events."""
    events = np.empty(n_events, dtype=EVENT_DTYPE)
    for first in range(0, n_events, EVENTS_PER_BLOCK):
        block = slice(first, first + EVENTS_PER_BLOCK)
        columns = read(block)
        for field in FIELDS:
            events[field][block] = field_values(field, columns[field], str(path))
    return events


@contextmanager
def _open_h5(path: Path) -> Iterator[h5py.File]:
    """Open an HDF5 file for reading; what the library cannot read becomes one SsacError."""
    try:
        with h5py.File(path, "r") as file:
            yield file
    except OSError as error:
        raise SsacError(
            f"{path}: not a readable HDF5 file ({error}): copy or record it again if it is "
            "truncated; if its codec is missing (Prophesee's ECF), install the codec's HDF5 plugin "
            "or convert the file to RAW"
        ) from error


def _sensor_size(file: h5py.File) -> tuple[int | None, int | None]:
    """Width and height [px] from the file's attributes; None where they are missing."""
    if "geometry" in file.attrs:
        geometry = file.attrs["geometry"]
        text = geometry.decode() if isinstance(geometry, bytes) else str(geometry)
        columns, rows = text.split("x")
        return int(columns), int(rows)
    group = file.get("events", file)
    sizes = [file.attrs.get(key, group.attrs.get(key)) for key in ("width", "height")]
    width, height = (None if size is None else int(size) for size in sizes)
    return width, height
