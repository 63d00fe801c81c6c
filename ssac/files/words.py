"""A camera maker's raw file in; the signs of damage in its words out, before it is decoded.

The decoder passes over words that mean nothing, and takes a clock that runs back for one that began
anew, so that of a file from which a byte is missing it gives a third of the events at times of
years. What a sensor writes has none of these:

EVT2, EVT3  words of unknown type, or that continue nothing; a clock that runs back, or leaps where
            it is written all the time; one and the same word again and again
DAT         a polarity that is none, a clock that runs back, one and the same event again and again
"""

from pathlib import Path
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from ssac.files.net import readable

REPEATED = 32
"""So many equal words, or events, in a row are none of a sensor: a block was overwritten."""

_KINDS = ("words that mean nothing", "times that run back", "leaps of the clock", "repeated words")

_OF_EVENTS = 1 << 0x0 | 1 << 0x2 | 1 << 0x3 | 1 << 0x6  # kinds of EVT3 words: y, x, x, time

_SLACK_EVT3 = 16  # steps of 4.1 ms that the clock of a busy sensor may leave out


def raw_signs(path: Path, version: str) -> list[str]:
    """Look for damage in the words of an EVT2 or EVT3 file.

    Parameters
    ----------
    path
        The file; that it has a header is known.
    version
        "evt2" or "evt3".

    Returns
    -------
    list of str
        What is wrong, with numbers; empty for a file that is whole.
    """
    words, rest = _words(path, np.dtype("<u2" if version == "evt3" else "<u4"), 0)
    find = _signs_of_evt3 if version == "evt3" else _signs_of_evt2
    return _said(find(words, REPEATED), len(words), rest, words.itemsize)


def dat_signs(path: Path) -> list[str]:
    """Look for damage in the records of a DAT file; as `raw_signs`."""
    words, rest = _words(path, np.dtype("<u8"), 2)  # after the type and the size of a record
    return _said(_signs_of_dat(words, REPEATED), len(words), rest, words.itemsize)


def _words(path: Path, dtype: np.dtype[Any], n_about: int) -> tuple[NDArray[Any], int]:
    """Words behind the header and `n_about` bytes, and how many bytes are left over."""
    with readable(path, "a readable file"), path.open("rb") as file:
        start = 0
        while (line := file.readline()).startswith(b"%"):
            start = file.tell()
            if line.startswith(b"% end"):
                break
        start += n_about
        n_bytes = max(0, path.stat().st_size - start)
        count = n_bytes // dtype.itemsize
        if not count:
            return np.empty(0, dtype), n_bytes
        words = np.fromfile(path, dtype, count, offset=start)
    return words, n_bytes - len(words) * dtype.itemsize


def _said(counts: NDArray[np.int64], n_words: int, rest: int, size: int) -> list[str]:
    signs = [
        f"{count} {kind} ({100.0 * count / n_words:.2g} %)"
        for count, kind in zip(counts.tolist(), _KINDS, strict=True)
        if count
    ]
    if rest:
        signs.append(f"{rest} bytes beyond the last whole word of {size}")
    return signs


@numba.njit(cache=True)
def _signs_of_evt2(words: NDArray[np.uint32], repeated: int) -> NDArray[np.int64]:
    """Count invalid words, times that run back, leaps, repeated words."""
    signs = np.zeros(4, np.int64)
    high, last_us, before, run = -1, -1, -1, 1
    previous = 16
    for i in range(len(words)):
        word = int(words[i])
        kind = word >> 28
        if kind <= 1:
            run = run + 1 if word == before else 1
            signs[3] += repeated if run == repeated else run > repeated
            time_us = high << 6 | (word >> 22) & 0x3F
            if high >= 0:
                signs[1] += time_us < last_us
                last_us = time_us
        elif kind == 0x8:
            new = word & 0xFFFFFFF
            if new < high:
                signs[1] += high - new <= 1 << 27  # else the counter began anew
                last_us = -1
            high = new
        elif not (kind == 0xA or kind == 0xE or (kind == 0xF and previous in (0xE, 0xF))):
            signs[0] += 1
        previous = kind
        before = word
    return signs


@numba.njit(cache=True)
def _signs_of_evt3(words: NDArray[np.uint16], repeated: int) -> NDArray[np.int64]:
    """Count as `_signs_of_evt2`."""
    signs = np.zeros(4, np.int64)
    n_same = n_steps = 0
    high, before, run = -1, -1, 1
    previous = 16
    for i in range(len(words)):
        word = int(words[i])
        kind = word >> 12
        if _OF_EVENTS >> kind & 1:  # first, as nearly all words are of these kinds
            if word == before:
                run += 1
                signs[3] += repeated if run == repeated else run > repeated
            else:
                run = 1
        elif kind == 0x8:
            new = word & 0xFFF
            if high >= 0:
                step = (new - high) & 0xFFF
                n_steps += 1
                n_same += step == 0
                signs[1] += step >= 0x800
                signs[2] += _SLACK_EVT3 < step < 0x800
            high = new
        elif kind == 0x7 or kind == 0xF:
            signs[0] += not (previous == 0xE or previous == 0x7 or previous == 0xF)
        elif not (kind == 0x4 or kind == 0x5 or kind == 0xA or kind == 0xE):
            signs[0] += 1
        previous = kind
        before = word
    if n_same * 10 < n_steps:  # written when it changes, and so not while nothing happens
        signs[2] = 0
    return signs


@numba.njit(cache=True)
def _signs_of_dat(words: NDArray[np.uint64], repeated: int) -> NDArray[np.int64]:
    """Count as `_signs_of_evt2`."""
    signs = np.zeros(4, np.int64)
    before, last_us, run = np.uint64(0), -1, 1
    for i in range(len(words)):
        word = words[i]
        time_us = int(word & np.uint64(0xFFFFFFFF))
        signs[0] += (word >> np.uint64(60)) > np.uint64(1)
        if time_us < last_us:
            signs[1] += last_us - time_us <= 1 << 31  # else the counter began anew
        if i and word == before:
            run += 1
            signs[3] += repeated if run == repeated else run > repeated
        else:
            run = 1
        before, last_us = word, time_us
    return signs
