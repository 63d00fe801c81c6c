"""Ways to damage a file: its bytes, the words of a text, the structure of HDF5.

Each takes a random generator, so that the same seed damages the same way.
"""

import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np

Damage = Callable[[bytes, np.random.Generator], bytes]
Change = Callable[[h5py.File, np.random.Generator], None]

_BAD_WORDS = (
    b"nan", b"inf", b"-inf", b"-1", b"0", b"1e400", b"9" * 30, b"9" * 5000, b"4294967296", b"",
    b"[]", b"{}", b"'", b'"', b"\0", b"\xff", b"true", b"null", b"~", b"1e-3", b"0x10", b"[[1]]",
    b"<script>", b"../../etc/passwd", b"!!python/object/apply:os.getcwd []", b"&a [*a]", b"*b",
    b"[" * 3000, b"1979-05-27", b"\xef\xbb\xbf", b"=", b":", b"\n", b"\r", b"\t", b"#",
)  # fmt: skip
"""What a word of a text file is replaced by."""

_WORD = re.compile(rb"[^\s,:=\[\]{}]+")


def flip(data: bytes, rng: np.random.Generator) -> bytes:
    """Turn one to eight bits anywhere."""
    damaged = bytearray(data)
    for _ in range(int(rng.integers(1, 9))):
        damaged[int(rng.integers(len(damaged)))] ^= 1 << int(rng.integers(8))
    return bytes(damaged)


def flip_at_start(data: bytes, rng: np.random.Generator) -> bytes:
    """Turn one bit of the first 1000 bytes, where headers are."""
    damaged = bytearray(data)
    damaged[int(rng.integers(min(1000, len(damaged))))] ^= 1 << int(rng.integers(8))
    return bytes(damaged)


def insert(data: bytes, rng: np.random.Generator) -> bytes:
    """Put one to 16 random bytes in."""
    at = int(rng.integers(len(data)))
    return data[:at] + rng.bytes(int(rng.integers(1, 17))) + data[at:]


def remove(data: bytes, rng: np.random.Generator) -> bytes:
    """Take one to 16 bytes out."""
    at = int(rng.integers(len(data)))
    return data[:at] + data[at + int(rng.integers(1, 17)) :]


def zeros(data: bytes, rng: np.random.Generator) -> bytes:
    """Overwrite a block with zeros."""
    return _overwritten(data, rng, lambda n: bytes(n))


def ones(data: bytes, rng: np.random.Generator) -> bytes:
    """Overwrite a block with 0xFF."""
    return _overwritten(data, rng, lambda n: b"\xff" * n)


def noise(data: bytes, rng: np.random.Generator) -> bytes:
    """Overwrite a block with random bytes."""
    return _overwritten(data, rng, lambda n: rng.bytes(n))


def repeat(data: bytes, rng: np.random.Generator) -> bytes:
    """Write a block twice."""
    at, n = int(rng.integers(len(data))), _block_length(data, rng)
    return data[: at + n] + data[at:]


def cut(data: bytes, rng: np.random.Generator) -> bytes:
    """Leave the end out."""
    return data[: int(rng.integers(1, max(2, len(data))))]


def word(data: bytes, rng: np.random.Generator) -> bytes:
    """Replace a word of a text by something nasty."""
    found = list(_WORD.finditer(data))
    if not found:
        return data + b"\0"
    one = found[int(rng.integers(len(found)))]
    return data[: one.start()] + _BAD_WORDS[int(rng.integers(len(_BAD_WORDS)))] + data[one.end() :]


def line(data: bytes, rng: np.random.Generator) -> bytes:
    """Take a line of a text out, write it twice, or change it with the next."""
    lines = data.splitlines(keepends=True)
    at, what = int(rng.integers(len(lines))), int(rng.integers(3))
    if what == 0:
        del lines[at]
    elif what == 1:
        lines.insert(at, lines[at])
    else:
        lines[at : at + 2] = reversed(lines[at : at + 2])
    return b"".join(lines)


def _overwritten(data: bytes, rng: np.random.Generator, fill: Callable[[int], bytes]) -> bytes:
    at, n = int(rng.integers(len(data))), _block_length(data, rng)
    n = min(n, len(data) - at)
    return data[:at] + fill(n) + data[at + n :]


def _block_length(data: bytes, rng: np.random.Generator) -> int:
    """From 16 bytes to 4 KiB, but no more than a fifth of the file."""
    return int(min(2 ** rng.uniform(4.0, 12.0), max(1, len(data) // 5)))


OF_BYTES: Mapping[str, Damage] = {
    one.__name__: one
    for one in (flip, flip_at_start, insert, remove, zeros, ones, noise, repeat, cut)
}
OF_TEXT: Mapping[str, Damage] = {**OF_BYTES, "word": word, "word again": word, "line": line}


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
