"""Ways to damage a file: its bytes, the words of a text, the structure of HDF5.

Each takes a random generator, so that the same seed damages the same way.
"""

import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np

Random = np.random.Generator
Damage = Callable[[bytes, Random], bytes]
Change = Callable[[h5py.File, Random], None]

_BAD_WORDS = (
    b"nan", b"inf", b"-inf", b"-1", b"0", b"1e400", b"9" * 30, b"9" * 5000, b"4294967296", b"",
    b"[]", b"{}", b"'", b'"', b"\0", b"\xff", b"true", b"null", b"~", b"1e-3", b"0x10", b"[[1]]",
    b"<script>", b"../../etc/passwd", b"!!python/object/apply:os.getcwd []", b"&a [*a]", b"*b",
    b"[" * 3000, b"1979-05-27", b"\xef\xbb\xbf", b"=", b":", b"\n", b"\r", b"\t", b"#",
)  # fmt: skip
"""What a word of a text file is replaced by."""

_WORD = re.compile(rb"[^\s,:=\[\]{}]+")


def _flipped(data: bytes, rng: Random, n: int, end: int) -> bytes:
    damaged = bytearray(data)
    for _ in range(n):
        damaged[int(rng.integers(end))] ^= 1 << int(rng.integers(8))
    return bytes(damaged)


def _insert(data: bytes, rng: Random) -> bytes:
    at = int(rng.integers(len(data)))
    return data[:at] + rng.bytes(int(rng.integers(1, 17))) + data[at:]


def _remove(data: bytes, rng: Random) -> bytes:
    at = int(rng.integers(len(data)))
    return data[:at] + data[at + int(rng.integers(1, 17)) :]


def _block(data: bytes, rng: Random) -> tuple[int, int]:
    """Choose a block of 16 bytes to 4 KiB, but no more than a fifth of the file."""
    at = int(rng.integers(len(data)))
    n = int(min(2 ** rng.uniform(4.0, 12.0), max(1, len(data) // 5)))
    return at, min(at + n, len(data))


def _overwrite(data: bytes, rng: Random, fill: Callable[[int], bytes]) -> bytes:
    at, end = _block(data, rng)
    return data[:at] + fill(end - at) + data[end:]


def _repeat(data: bytes, rng: Random) -> bytes:
    at, end = _block(data, rng)
    return data[:end] + data[at:]


def _word(data: bytes, rng: Random) -> bytes:
    """Replace a word of a text by something nasty."""
    found = list(_WORD.finditer(data))
    if not found:
        return data + b"\0"
    one = found[int(rng.integers(len(found)))]
    return data[: one.start()] + _BAD_WORDS[int(rng.integers(len(_BAD_WORDS)))] + data[one.end() :]


def _line(data: bytes, rng: Random) -> bytes:
    """Take a line of a text out, write it twice, or change it with the next."""
    lines = data.splitlines(keepends=True)
    at, what = int(rng.integers(len(lines))), int(rng.integers(3))
    first, following = lines[at], lines[at + 1 : at + 2]
    lines[at : at + 2] = ([*following], [first, first, *following], [*following, first])[what]
    return b"".join(lines)


OF_BYTES: Mapping[str, Damage] = {
    "flip": lambda data, rng: _flipped(data, rng, int(rng.integers(1, 9)), len(data)),
    "flip_at_start": lambda data, rng: _flipped(data, rng, 1, min(1000, len(data))),  # of headers
    "insert": _insert,
    "remove": _remove,
    "zeros": lambda data, rng: _overwrite(data, rng, bytes),
    "ones": lambda data, rng: _overwrite(data, rng, lambda n: b"\xff" * n),
    "noise": lambda data, rng: _overwrite(data, rng, rng.bytes),
    "repeat": _repeat,
    "cut": lambda data, rng: data[: int(rng.integers(1, max(2, len(data))))],
}
OF_TEXT: Mapping[str, Damage] = {**OF_BYTES, "word": _word, "word again": _word, "line": _line}


_STRANGE: tuple[Any, ...] = (
    "346,260", "wide", b"\xff\xfe", "", "x", "1e9x1e9", -1, 0, 1 << 40, 3.7, np.nan, np.inf,
    [346, 260], np.zeros((2, 2)), h5py.Empty("f"), "346x260x3", "<script>",
)  # fmt: skip
_N_DECLARED = (10**6, 4 * 10**8, 4 * 10**9, 10**15)


def restructured(path: Path, rng: Random) -> str:
    """Change one thing of a file; return what."""
    name, change = list(CHANGES.items())[int(rng.integers(len(CHANGES)))]
    with h5py.File(path, "a") as file:
        change(file, rng)
    return name


def _attribute(file: h5py.File, rng: Random) -> None:
    key = ("geometry", "width", "height")[int(rng.integers(3))]
    file.attrs[key] = _STRANGE[int(rng.integers(len(_STRANGE)))]


def _offset(file: h5py.File, rng: Random) -> None:
    _put(file, "t_offset", _STRANGE[int(rng.integers(len(_STRANGE)))])


def _dataset(file: h5py.File, rng: Random) -> None:
    """Put something else in a dataset's place."""
    name = _some_name(file, rng)
    others: tuple[Any, ...] = (
        {},  # a group
        5,
        np.full(3000, np.nan),
        np.array(["a"] * 3000, "S3"),
        h5py.SoftLink("/" + name),
        h5py.ExternalLink("elsewhere.h5", "/x"),
        np.zeros((3000, 2), np.int64),
        h5py.Empty("i8"),
    )
    _put(file, name, others[int(rng.integers(len(others)))])


def _declared(file: h5py.File, rng: Random) -> None:
    """Say that there are far more events than are stored."""
    n = _N_DECLARED[int(rng.integers(len(_N_DECLARED)))]
    chunks = (100_000,) if rng.integers(2) else None
    for name in [name for name in _names(file) if name in file]:
        dtype = file[name].dtype
        _put(file, name, None)
        file.create_dataset(name, shape=(n,), dtype=dtype, chunks=chunks)


def _order(file: h5py.File, rng: Random) -> None:
    """Have times that run back, leap, or are beyond what an integer of 64 bits holds."""
    if "events/t" not in file:
        return
    t = file["events/t"][:].astype(np.float64)
    at = int(rng.integers(len(t)))
    t[at:] += (-1e6, 1e13, -5.0)[int(rng.integers(3))]
    _put(file, "events/t", t.astype(np.int64))


def _names(file: h5py.File) -> list[str]:
    return ["CD/events"] if "CD" in file else [f"events/{field}" for field in "txyp"]


def _some_name(file: h5py.File, rng: Random) -> str:
    names = _names(file)
    return names[int(rng.integers(len(names)))]


def _put(file: h5py.File, name: str, value: Any) -> None:
    """Put a value, a group ({}) or nothing (None) where something may be."""
    if file.get(name, getlink=True) is not None:
        del file[name]
    if isinstance(value, dict):
        file.create_group(name)
    elif value is not None:
        file[name] = value


CHANGES: dict[str, Change] = {
    "attribute": _attribute,
    "attribute again": _attribute,
    "offset": _offset,
    "dataset": _dataset,
    "dataset again": _dataset,
    "declared size": _declared,
    "loop": lambda file, _: _put(file, "events", h5py.SoftLink("/events")),
    "missing": lambda file, rng: _put(file, _some_name(file, rng), None),
    "order": _order,
}
