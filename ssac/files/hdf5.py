"""HDF5 recordings: events and intensity frames.

Three layouts are read: ours (`events/t`, `x`, `y`, `p`; the sensor's width and height as attributes
of the file or of `events`), DSEC's (the same datasets, times relative to the dataset `t_offset`)
and Prophesee's (`CD/events`, size in the attribute `geometry`).

Before memory is allocated, the sizes that a file states are checked against what it really stores.
Links, and data in other files, are refused.
"""

import math
from collections.abc import Callable, Collection, Mapping
from pathlib import Path
from typing import Any

import h5py
import hdf5plugin  # noqa: F401  its import registers blosc and other filters with h5py
import numpy as np
from numpy.typing import NDArray

from ssac.arrays import Events, IntArray
from ssac.errors import SsacError
from ssac.events import EVENT_DTYPE, EventFile, SizePx, check_lengths, field_values
from ssac.files.damage import STRICT, Reading, checked_file, readable, refuse_damaged, side_px
from ssac.files.whole_file import check_writable, whole_file

HDF5_SUFFIXES = (".h5", ".hdf5")

EVENTS_PER_BLOCK = 1 << 18  # read at a time: a block stays in the processor's cache until copied
BYTES_PER_BLOCK = 1 << 24  # of frames read at a time, if only their summaries are kept
_KIND = "a readable HDF5 file"


def load_events_h5(path: Path, reading: Reading = STRICT) -> EventFile:
    """Read the events of an HDF5 file in any of the three layouts."""
    with readable(path, _KIND), h5py.File(path, "r") as file:
        size_px = _sensor_size(file, path)
        cd = _dataset(file, "CD/events", path)
        columns = {field: _dataset(file, f"events/{field}", path) for field in "txyp"}
        if cd is not None:
            if cd.ndim != 1 or not set("txyp") <= set(cd.dtype.names or ()):
                raise SsacError(
                    f"{path}: CD/events must be a list of x, y, p, t, got the shape {cd.shape} of "
                    f"{cd.dtype}: convert it again"
                )
            has_lost = refuse_damaged(path, _signs_of_loss(cd), reading)
            events = _read_blocks([cd], cd.__getitem__, path)
        elif all(column is not None for column in columns.values()):
            check_lengths({field: column.shape for field, column in columns.items()}, str(path))
            # Of lost times the zeros show, and are left out; of lost coordinates they do not.
            has_lost = refuse_damaged(path, _signs_of_loss(columns["t"]), reading)
            lost = [sign for field in "xyp" for sign in _signs_of_loss(columns[field])]
            if lost:
                raise SsacError(f"{path}: is damaged: {'; '.join(lost)}: copy or record it again")
            events = _read_blocks(
                columns.values(), lambda block: {f: columns[f][block] for f in "txyp"}, path
            )
        else:
            has = f"{sorted(file)[:5]}{' and more' if len(file) > 5 else ''}"
            raise SsacError(
                f"{path}: expected the datasets events/t, events/x, events/y, events/p, or "
                f"CD/events; the file has {has}: convert it to one of these layouts"
            )
        events = events[events["t"] != 0] if has_lost else events
        if cd is None:
            events["t"] += _offset_us(file, path)
    return checked_file(events, size_px, path, reading, "microseconds")


def load_frames(
    path: Path, summary: Callable[[NDArray[np.uint8]], NDArray[Any]] | None = None
) -> tuple[IntArray, NDArray[Any]] | None:
    """Read a recording's times of mid-exposure (n,) [us] and frames (n, height, width) uint8.

    None if there are no frames or the file is not HDF5. `summary` is called with blocks of frames
    (k, height, width); the array (k, ...) that it returns is kept in their place.
    """
    if path.suffix.lower() not in HDF5_SUFFIXES:
        return None
    with readable(path, _KIND), h5py.File(path, "r") as file:
        times, images = (_dataset(file, f"frames/{name}", path) for name in ("t", "images"))
        if times is None or images is None:
            return None
        lost = [*_signs_of_loss(times), *_signs_of_loss(images)]
        if lost:
            raise SsacError(
                f"{path}: its frames are damaged: {'; '.join(lost)}: copy or record it again, or"
                " use a method for events"
            )
        if images.ndim != 3 or images.dtype != np.uint8 or times.shape != images.shape[:1]:
            raise SsacError(
                f"{path}: expected frames/images as (n, height, width) uint8 with n times in "
                f"frames/t, got {images.shape} {images.dtype} and {times.shape} times: write the "
                "frames again"
            )
        times_us = times[:]
        if times_us.dtype.kind not in "iu" or np.any(np.diff(times_us.astype(np.int64)) <= 0):
            raise SsacError(
                f"{path}: frames/t must hold increasing whole microseconds: write the frames again"
            )
        kept = images[:] if summary is None else _summarised(images, summary)
    return times_us.astype(np.int64), kept


def save_events_h5(path: Path, events: Events, width: int | None, height: int | None) -> None:
    """Write events in our HDF5 layout, with the sensor's size [px] where it is known."""
    check_writable(path, EVENT_DTYPE.itemsize * len(events))
    with whole_file(path) as temporary, h5py.File(temporary, "w") as file:
        for field in "txyp":
            file[f"events/{field}"] = events[field]
        for key, value in (("width", width), ("height", height)):
            if value is not None:
                file.attrs[key] = value


def _read_blocks(
    kept: Collection[h5py.Dataset],
    read: Callable[[slice], Mapping[str, NDArray[Any]]],
    path: Path,
) -> Events:
    """Read all events, whole chunks of the largest at a time, as HDF5 decodes each as a whole."""
    n_events = max(map(len, kept))
    events = np.empty(n_events, dtype=EVENT_DTYPE)
    per_chunk = max(one.chunks[0] if one.chunks else 1 for one in kept)
    step = per_chunk * max(1, EVENTS_PER_BLOCK // per_chunk)
    for first in range(0, n_events, step):
        block = slice(first, first + step)
        columns = read(block)
        for field in "txyp":
            events[field][block] = field_values(field, columns[field], str(path))
    return events


def _summarised(
    images: h5py.Dataset, summary: Callable[[NDArray[np.uint8]], NDArray[Any]]
) -> NDArray[Any]:
    """Summarise all frames; read whole chunks, as HDF5 decodes each chunk as a whole."""
    n, height, width = images.shape
    per_chunk = images.chunks[0] if images.chunks else 1
    step = per_chunk * max(1, BYTES_PER_BLOCK // max(1, per_chunk * height * width))
    starts = range(0, max(n, 1), step)
    return np.concatenate([summary(images[start : start + step]) for start in starts])


def _offset_us(file: h5py.File, path: Path) -> int:
    """Return `t_offset` [us], to which DSEC's times are relative; 0 if the file has none."""
    offset = _dataset(file, "t_offset", path)
    if offset is None:
        return 0
    is_number = offset.size == 1 and offset.dtype.kind in "iuf"
    value = np.ravel(offset[()])[0] if is_number else np.nan
    if not abs(value) < 2.0**60:  # true of NaN too
        raise SsacError(
            f"{path}: t_offset must be one number of microseconds, got {value:g}, of the shape "
            f"{offset.shape} of {offset.dtype}: convert it again"
        )
    return int(value)


def _dataset(file: h5py.File, name: str, path: Path) -> Any:
    """Return a dataset such as "events/t"; None if there is none, SsacError if it is unsafe."""
    parts = name.split("/")
    for k in range(1, len(parts) + 1):
        link = file.get("/".join(parts[:k]), getlink=True)
        if link is None:
            return None
        if not isinstance(link, h5py.HardLink):
            raise SsacError(
                f"{path}: {name} is a link to elsewhere: copy what it leads to into the file"
            )
    found = file[name]
    if not isinstance(found, h5py.Dataset) or found.shape is None:
        raise SsacError(f"{path}: {name} must be a dataset, got {found!r}: convert the file again")
    if found.external or found.is_virtual:
        raise SsacError(f"{path}: {name} is stored in other files: copy it into this one")
    filters = found.id.get_create_plist()
    for k in range(filters.get_nfilters()):
        code, _, _, codec = filters.get_filter(k)
        if not h5py.h5z.filter_avail(code):
            raise SsacError(
                f"{path}: {name} is compressed with {codec.decode(errors='replace')} (number "
                f"{code}), which this HDF5 library does not have: install its plugin, or convert "
                "the file"
            )
    largest = max(found.size, math.prod(found.chunks or (0,))) * found.dtype.itemsize
    stored = found.id.get_storage_size()
    # A megabyte does no harm, and of frames of an even sky Zstd makes 20,000 bytes of one.
    if largest > max(1 << 20, 50_000 * stored):
        raise SsacError(
            f"{path}: {name} says that it has {found.size} values, but {stored} bytes of it are "
            "stored: the file is damaged, copy or record it again"
        )
    return found


def _signs_of_loss(found: Any) -> list[str]:
    """List the parts of a dataset that are not stored, and would be read as zeros."""
    if found.chunks:
        n_chunks = math.prod(-(-n // k) for n, k in zip(found.shape, found.chunks, strict=True))
        lost = n_chunks - found.id.get_num_chunks()
        return [f"{lost} of {n_chunks} blocks of {found.name[1:]} are lost"] if lost > 0 else []
    is_whole = found.id.get_storage_size() >= found.size * found.dtype.itemsize
    return [] if is_whole else [f"{found.name[1:]} is not stored"]


def _sensor_size(file: h5py.File, path: Path) -> SizePx:
    """Return the sensor's width and height [px] from attributes; None where they are missing."""
    if "geometry" in file.attrs:
        geometry = file.attrs["geometry"]
        text = geometry.decode() if isinstance(geometry, bytes) else str(geometry)
        columns, _, rows = text.partition("x")
        said = "the attribute geometry must be WIDTHxHEIGHT of"
        return side_px(columns, said, path), side_px(rows, said, path)
    link = file.get("events", getlink=True)
    group = file["events"] if isinstance(link, h5py.HardLink) else file
    sizes = {key: file.attrs.get(key, group.attrs.get(key)) for key in ("width", "height")}
    width, height = (
        None if size is None else side_px(size, f"the attribute {key} must be a number of", path)
        for key, size in sizes.items()
    )
    return width, height
