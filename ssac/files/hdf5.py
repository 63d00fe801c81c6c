"""HDF5 recordings: events and intensity frames, in and out.

Three layouts are read: ours (`events/t`, `x`, `y`, `p`; the sensor's width and height as attributes
of the file or of `events`), DSEC's (the same datasets, times relative to the dataset `t_offset`,
blosc compression) and Prophesee's (`CD/events`, size in the attribute `geometry`). All of them
carry absolute time. Ours and DSEC's are compressed with codecs of the package hdf5plugin.
"""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from ssac.errors import SsacError
from ssac.events import EVENT_DTYPE, EventFile, check_events, check_lengths, field_values
from ssac.files.whole_file import whole_file

with suppress(ImportError):  # then what needs it is refused
    import hdf5plugin  # noqa: F401  its import registers blosc and other filters with h5py

HDF5_SUFFIXES = (".h5", ".hdf5")
FIELDS = ("t", "x", "y", "p")

EVENTS_PER_BLOCK = 1 << 18
"""Events read at once: few enough to stay in the processor's cache until they are in place."""

BYTES_PER_BLOCK = 1 << 24
"""Frames read at once when each of them is summed up."""

_PROPHESEE_ECF = 0x8ECF  # number of the codec of Prophesee's newer HDF5 files, not in hdf5plugin


def load_events_h5(path: Path) -> EventFile:
    """Read the events of an HDF5 file in any of the three layouts.

    Raises
    ------
    SsacError
        If the file is damaged, in another layout, or its events fail `check_events`.
    """
    with _open_h5(path) as file:
        width, height = _sensor_size(file)
        _check_codecs(file, ("CD/events", *(f"events/{field}" for field in FIELDS)), path)
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


def load_frames(
    path: Path | str, summary: Callable[[NDArray[np.uint8]], NDArray[Any]] | None = None
) -> tuple[NDArray[np.int64], NDArray[Any]] | None:
    """Read the intensity frames of a recording.

    Parameters
    ----------
    path
        Event file; only our HDF5 layout can hold frames, in `frames/t` and `frames/images`.
    summary
        What to keep of frames, (k, height, width) in, (k, ...) out: called with some at a time, so
        that never all are in memory. They are kept as they are when None.

    Returns
    -------
    tuple of NDArray, or None
        Times of mid-exposure, shape (n,) [us], and images, shape (n, height, width), uint8, or the
        summaries of all. None when the file has no frames.

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
        _check_codecs(file, ("frames/t", "frames/images"), path)
        times_us, images = file["frames/t"][:], file["frames/images"]
        if images.ndim != 3 or images.dtype != np.uint8 or times_us.shape != images.shape[:1]:
            raise SsacError(
                f"{path}: expected frames/images as (n, height, width) uint8 with n times in "
                f"frames/t, got {images.shape} {images.dtype} and {times_us.shape} times: write "
                "the frames again"
            )
        if times_us.dtype.kind not in "iu" or np.any(np.diff(times_us.astype(np.int64)) <= 0):
            raise SsacError(
                f"{path}: frames/t must hold increasing whole microseconds: write the frames again"
            )
        kept = images[:] if summary is None else _summarised(images, summary)
    return times_us.astype(np.int64), kept


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


def _summarised(
    images: h5py.Dataset, summary: Callable[[NDArray[np.uint8]], NDArray[Any]]
) -> NDArray[Any]:
    """Summaries of all frames; whole chunks are read at a time, as each is decoded as a whole."""
    n, height, width = images.shape
    per_chunk = images.chunks[0] if images.chunks else 1
    step = per_chunk * max(1, BYTES_PER_BLOCK // max(1, per_chunk * height * width))
    starts = range(0, max(n, 1), step)
    return np.concatenate([summary(images[start : start + step]) for start in starts])


def _check_codecs(file: h5py.File, names: tuple[str, ...], path: Path) -> None:
    """Raise SsacError when a dataset is compressed with what this HDF5 library cannot read."""
    for name in names:
        dataset = file.get(name)
        if not isinstance(dataset, h5py.Dataset):
            continue
        filters = dataset.id.get_create_plist()
        for k in range(filters.get_nfilters()):
            code, _, _, codec = filters.get_filter(k)
            if not h5py.h5z.filter_avail(code):
                remedy = (
                    "install Prophesee's HDF5 plugin, or convert the file to RAW"
                    if code == _PROPHESEE_ECF
                    else "pip install hdf5plugin"
                )
                known_as = codec.decode(errors="replace").partition(";")[0] or "a codec"
                raise SsacError(
                    f"{path}: {name} is compressed with {known_as} (number {code}), which this "
                    f"HDF5 library does not have: {remedy}"
                )


@contextmanager
def _open_h5(path: Path) -> Iterator[h5py.File]:
    """Open an HDF5 file for reading; what the library cannot read becomes one SsacError."""
    try:
        with h5py.File(path, "r") as file:
            yield file
    except OSError as error:
        raise SsacError(
            f"{path}: not a readable HDF5 file ({error}): copy or record it again if it is "
            "truncated"
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
