"""A copy of an HDF5 file in, the same with something in it that no recorder writes out."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np

Change = Callable[[h5py.File, np.random.Generator], None]

_STRANGE: tuple[Any, ...] = (
    "346,260", "wide", b"\xff\xfe", "", "x", "1e9x1e9", -1, 0, 1 << 40, 3.7, np.nan, np.inf,
    [346, 260], np.zeros((2, 2)), h5py.Empty("f"), "346x260x3", "<script>",
)  # fmt: skip
_N_DECLARED = (10**6, 4 * 10**8, 4 * 10**9, 10**15)


def restructured(path: Path, rng: np.random.Generator) -> str:
    """Change one thing of a file; return what."""
    name, change = list(CHANGES.items())[int(rng.integers(len(CHANGES)))]
    with h5py.File(path, "a") as file:
        change(file, rng)
    return name


def _attribute(file: h5py.File, rng: np.random.Generator) -> None:
    key = ("geometry", "width", "height")[int(rng.integers(3))]
    file.attrs[key] = _STRANGE[int(rng.integers(len(_STRANGE)))]


def _offset(file: h5py.File, rng: np.random.Generator) -> None:
    _remove(file, "t_offset")
    file["t_offset"] = _STRANGE[int(rng.integers(len(_STRANGE)))]


def _dataset(file: h5py.File, rng: np.random.Generator) -> None:
    """Put something else in a dataset's place."""
    name = _some_name(file, rng)
    _remove(file, name)
    kind = int(rng.integers(8))
    if kind == 0:
        file.create_group(name)
    elif kind == 1:
        file[name] = 5
    elif kind == 2:
        file[name] = np.full(3000, np.nan)
    elif kind == 3:
        file[name] = np.array(["a"] * 3000, "S3")
    elif kind == 4:
        file[name] = h5py.SoftLink("/" + name)
    elif kind == 5:
        file[name] = h5py.ExternalLink("elsewhere.h5", "/x")
    elif kind == 6:
        file[name] = np.zeros((3000, 2), np.int64)
    else:
        file[name] = h5py.Empty("i8")


def _declared(file: h5py.File, rng: np.random.Generator) -> None:
    """Say that there are far more events than are stored."""
    n = _N_DECLARED[int(rng.integers(len(_N_DECLARED)))]
    chunks = (100_000,) if rng.integers(2) else None
    for name in [name for name in _names(file) if name in file]:
        dtype = file[name].dtype
        _remove(file, name)
        file.create_dataset(name, shape=(n,), dtype=dtype, chunks=chunks)


def _loop(file: h5py.File, rng: np.random.Generator) -> None:
    del rng
    _remove(file, "events")
    file["events"] = h5py.SoftLink("/events")


def _missing(file: h5py.File, rng: np.random.Generator) -> None:
    _remove(file, _some_name(file, rng))


def _order(file: h5py.File, rng: np.random.Generator) -> None:
    """Have times that run back, leap, or are beyond what an integer of 64 bits holds."""
    if "events/t" not in file:
        return
    t = file["events/t"][:].astype(np.float64)
    at = int(rng.integers(len(t)))
    t[at:] += (-1e6, 1e13, -5.0)[int(rng.integers(3))]
    _remove(file, "events/t")
    file["events/t"] = t.astype(np.int64)


def _names(file: h5py.File) -> list[str]:
    return ["CD/events"] if "CD" in file else [f"events/{field}" for field in "txyp"]


def _some_name(file: h5py.File, rng: np.random.Generator) -> str:
    names = _names(file)
    return names[int(rng.integers(len(names)))]


def _remove(file: h5py.File, name: str) -> None:
    if file.get(name, getlink=True) is not None:
        del file[name]


CHANGES: dict[str, Change] = {
    "attribute": _attribute,
    "attribute again": _attribute,
    "offset": _offset,
    "dataset": _dataset,
    "dataset again": _dataset,
    "declared size": _declared,
    "loop": _loop,
    "missing": _missing,
    "order": _order,
}
