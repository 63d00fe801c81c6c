"""A whole file's bytes and a random generator in, damaged bytes out, and what was done to them."""

import re
from collections.abc import Callable, Mapping

import numpy as np

Damage = Callable[[bytes, np.random.Generator], bytes]

_NASTY = (
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
    return data[: one.start()] + _NASTY[int(rng.integers(len(_NASTY)))] + data[one.end() :]


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


OF_BYTES: Mapping[str, Damage] = {
    one.__name__: one
    for one in (flip, flip_at_start, insert, remove, zeros, ones, noise, repeat, cut)
}
OF_TEXT: Mapping[str, Damage] = {**OF_BYTES, "word": word, "word again": word, "line": line}


def _overwritten(data: bytes, rng: np.random.Generator, fill: Callable[[int], bytes]) -> bytes:
    at, n = int(rng.integers(len(data))), _block_length(data, rng)
    n = min(n, len(data) - at)
    return data[:at] + fill(n) + data[at + n :]


def _block_length(data: bytes, rng: np.random.Generator) -> int:
    """From 16 bytes to 4 KiB, but no more than a fifth of the file."""
    return int(min(2 ** rng.uniform(4.0, 12.0), max(1, len(data) // 5)))
