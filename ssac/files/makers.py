"""Camera makers' files, which the library faery decodes: RAW, DAT, AEDAT 4 and Event Stream.

faery follows the overflows of an EVT3 or DAT clock from the file's start on, and adds the start
back that it stores in the header of the EVT and DAT files it writes itself. An Event Stream file
has no such place: faery and others subtract the first timestamp on writing, and it is lost, so a
file that starts at time 0 gives a warning. RAW, DAT and ES files have no end mark: a truncated one
is a shorter recording.

What is damaged in the middle faery passes over, or is taken down by it, so this is looked at
before. The decoder takes a clock that runs back for one that began anew, so that of a file from
which a byte is missing it gives a third of the events at times of years. What a sensor writes has
none of these:

EVT2, EVT3  words of unknown type, or that continue nothing; a clock that runs back, or leaps where
            it is written all the time; one and the same word again and again
DAT         a polarity that is none, a clock that runs back, one and the same event again and again
AEDAT 4     a size that is nonsense, for which faery takes as much memory and ends the process when
            there is none; a packet of a stream that is none
"""

import re
import struct
import warnings
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any, BinaryIO
from xml.etree import ElementTree

import numba
import numpy as np
from numpy.typing import NDArray

from ssac.errors import SsacError
from ssac.events import EVENT_DTYPE, EventFile
from ssac.files.damage import REPEATED, Reading, checked_file, refuse_damaged
from ssac.files.readable import brief, readable, silenced

_ENDS = (KeyboardInterrupt, SystemExit)

UNKNOWN_SIZE = (65535, 65535)
"""What faery is told to assume when a header does not give the sensor's size."""

_KINDS = ("words that mean nothing", "times that run back", "leaps of the clock", "repeated words")

_OF_EVENTS = 1 << 0x0 | 1 << 0x2 | 1 << 0x3 | 1 << 0x6  # kinds of EVT3 words: y, x, x, time

_SLACK_EVT3 = 16  # steps of 4.1 ms that the clock of a busy sensor may leave out

_MAGIC = b"#!AER-DAT4.0\r\n"
_STREAM = re.compile(rb'<node name="(\d+)"')


def load_makers_file(path: Path, reading: Reading) -> EventFile:
    """Read a camera maker's file; SsacError if it is damaged, or encoded as faery cannot read."""
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
    with _readable(path), silenced():
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


def _readable(path: Path) -> AbstractContextManager[None]:
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

    with _readable(path), silenced(), faery.evt.Decoder(path, UNKNOWN_SIZE, None) as decoder:
        version = str(decoder.version)
    if version not in ("evt2", "evt3"):
        raise SsacError(f"{path}: its encoding is {version}: convert it to EVT2 or EVT3")
    return version


def raw_signs(path: Path, version: str) -> list[str]:
    """Say what is wrong with the words of a RAW file of version "evt2" or "evt3"."""
    words, rest = _words(path, np.dtype("<u2" if version == "evt3" else "<u4"), 0)
    find = _signs_of_evt3 if version == "evt3" else _signs_of_evt2
    return _said(find(words, REPEATED), len(words), rest, words.itemsize)


def dat_signs(path: Path) -> list[str]:
    """Say what is wrong with the records of a DAT file."""
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


def _signs_of_dat(words: NDArray[np.uint64], repeated: int) -> NDArray[np.int64]:
    """Count as `_signs_of_evt2`."""
    steps_us = np.diff((words & np.uint64(0xFFFFFFFF)).astype(np.int64))
    runs = np.diff(np.flatnonzero(words[1:] != words[:-1]), prepend=-1, append=len(words) - 1)
    invalid = np.count_nonzero(words >> np.uint64(60) > 1)
    # By more the counter began anew.
    back = np.count_nonzero((steps_us < 0) & (steps_us >= -(1 << 31)))
    return np.array([invalid, back, 0, runs[runs >= repeated].sum()])


def check_packets(path: Path) -> list[str]:
    """Say what is wrong with an AEDAT 4 file that still leaves packets to read.

    SsacError if its header is none.
    """
    kind = f"a complete {path.suffix} file"
    with readable(path, kind), path.open("rb") as file:
        size = path.stat().st_size
        if file.read(len(_MAGIC)) != _MAGIC:
            raise SsacError(f"{path}: not {kind} (its first line is none): copy it again")
        (n_header,) = struct.unpack("<I", file.read(4))
        if not 16 <= n_header <= min(1 << 24, size - file.tell()):
            raise SsacError(
                f"{path}: not {kind} (its header says that it has {n_header} bytes): copy it again"
            )
        header = file.read(n_header)
        _check_description(header, path)
        streams = {int(number) for number in _STREAM.findall(header)}
        table = _table_position(header)
        if table > size:
            return [f"the table of its packets is at byte {table} of {size}"]
        return _broken(file, table if table > 0 else size, streams)


def _broken(file: BinaryIO, end: int, streams: set[int]) -> list[str]:
    n_packets = n_strange = 0
    at = file.tell()
    while at + 8 <= end:
        stream, n_bytes = struct.unpack("<ii", file.read(8))
        if not 0 <= n_bytes <= end - at - 8:
            return [f"packet {n_packets} says that it has {n_bytes} bytes, of {end - at - 8} left"]
        n_packets += 1
        n_strange += stream not in streams
        at += 8 + n_bytes
        file.seek(at)
    signs = [f"{n_strange} of {n_packets} packets are of no stream"] if n_strange else []
    return signs if at == end else [*signs, f"{end - at} bytes beyond the last packet"]


def _check_description(header: bytes, path: Path) -> None:
    """Raise SsacError unless the header's XML can be parsed: else the library may abort."""
    place = _field_place(header, 2)
    start = place + struct.unpack_from("<I", header, place)[0] if place else 0
    (length,) = struct.unpack_from("<I", header, start) if place else (0,)
    text = header[start + 4 : start + 4 + length] if place else b""
    try:
        if len(text) < length or b"<!" in text:  # an entity may stand for gigabytes
            raise ValueError("its description of streams is cut off, or no plain one")
        ElementTree.fromstring(text.decode("utf-8"))
    except (ValueError, ElementTree.ParseError) as error:
        raise SsacError(
            f"{path}: not a complete {path.suffix} file (its header's XML: {brief(error)}): copy "
            "it again"
        ) from error


def _table_position(header: bytes) -> int:
    """Read off the header where the table of packets begins, behind them; 0: it does not say."""
    place = _field_place(header, 1)
    position: int = struct.unpack_from("<q", header, place)[0] if place else 0
    return position


def _field_place(header: bytes, number: int) -> int:
    """Find a field of the header, a flat buffer; 0 where it is left out."""
    (root,) = struct.unpack_from("<I", header)
    fields = root - struct.unpack_from("<i", header, root)[0]
    (length,) = struct.unpack_from("<H", header, fields)
    place = 4 + 2 * number
    if place + 2 > length:
        return 0
    (offset,) = struct.unpack_from("<H", header, fields + place)
    return root + offset if offset else 0
