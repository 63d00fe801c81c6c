"""An open HDF5 file in; the datasets and attributes of it that can be trusted out.

Its sizes are what it says: before memory is taken they are held against what the file really
stores. Nothing in it leads out of it: links to other files are refused.
"""

import math
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from ssac.errors import SsacError
from ssac.events import EVENT_DTYPE

MAX_RATIO = 1000
"""No codec makes more than so many bytes of events, or of frames, of one that is stored."""

_NEVER_MIND = 1 << 20  # bytes, that anything may take
_PROPHESEE_ECF = 0x8ECF  # number of the codec of Prophesee's newer HDF5 files, not in hdf5plugin
_MAX_SIDE_PX = np.iinfo(EVENT_DTYPE["x"]).max


def dataset(file: h5py.File, name: str, path: Path) -> Any:
    """Give a dataset of a file; None where it has none of this name.

    Parameters
    ----------
    file
        Open for reading.
    name
        "events/t"
    path
        Of the file, for messages.

    Raises
    ------
    SsacError
        If the name is that of something else, or leads to another file; if the dataset is
        compressed with what this HDF5 library cannot read, or says that it is far larger than what
        is stored of it.
    """
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
    _check_codec(found, name, path)
    _check_size(found, name, path)
    return found


def signs_of_loss(found: Any) -> list[str]:
    """Say what of a dataset is not stored: it would be read as zeros."""
    if found.size == 0:
        return []
    if found.chunks:
        n_chunks = math.prod(
            -(-length // at_once) for length, at_once in zip(found.shape, found.chunks, strict=True)
        )
        lost = n_chunks - found.id.get_num_chunks()
        return [f"{lost} of {n_chunks} blocks of {found.name[1:]} are lost"] if lost > 0 else []
    is_whole = found.id.get_storage_size() >= found.size * found.dtype.itemsize
    return [] if is_whole else [f"{found.name[1:]} is not stored"]


def sensor_size(file: h5py.File, path: Path) -> tuple[int | None, int | None]:
    """Width and height [px] from the file's attributes; None where they are missing."""
    if "geometry" in file.attrs:
        geometry = file.attrs["geometry"]
        text = geometry.decode() if isinstance(geometry, bytes) else str(geometry)
        columns, _, rows = text.partition("x")
        return _side_px(columns, "geometry", path), _side_px(rows, "geometry", path)
    link = file.get("events", getlink=True)
    group = file["events"] if isinstance(link, h5py.HardLink) else file
    sizes = {key: file.attrs.get(key, group.attrs.get(key)) for key in ("width", "height")}
    width, height = (
        None if size is None else _side_px(size, key, path) for key, size in sizes.items()
    )
    return width, height


def brief_list(file: h5py.File) -> str:
    """Names of what stands in a file, not too many."""
    names = sorted(file)
    return f"{names[:5]}{' and more' if len(names) > 5 else ''}"


def _side_px(value: Any, key: str, path: Path) -> int:
    try:
        side_px = int(value)
    except (TypeError, ValueError, OverflowError):
        side_px = 0
    if not 1 <= side_px <= _MAX_SIDE_PX:
        expected = "WIDTHxHEIGHT" if key == "geometry" else "a number"
        raise SsacError(
            f"{path}: the attribute {key} must be {expected} of 1 to {_MAX_SIDE_PX} px, got "
            f"{str(value)[:40]!r}: correct it, or leave it out"
        )
    return side_px


def _check_codec(found: Any, name: str, path: Path) -> None:
    """Raise SsacError when a dataset is compressed with what this HDF5 library cannot read."""
    filters = found.id.get_create_plist()
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


def _check_size(found: Any, name: str, path: Path) -> None:
    largest = max(found.size, math.prod(found.chunks or (0,))) * found.dtype.itemsize
    stored = found.id.get_storage_size()
    if largest > _NEVER_MIND and largest > MAX_RATIO * stored:
        raise SsacError(
            f"{path}: {name} says that it has {found.size} values, but {stored} bytes of it are "
            "stored: the file is damaged, copy or record it again"
        )
