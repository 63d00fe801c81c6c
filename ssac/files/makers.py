"""Camera makers' files, which the library faery decodes: RAW, DAT, AEDAT 4 and Event Stream.

An Event Stream file has no place for its absolute start: faery and others subtract the first
timestamp on writing, so a file that starts at time 0 gives a warning. RAW, DAT and ES files have no
end mark: a truncated file reads as a shorter recording.

Where a file is damaged in its middle, faery overlooks the damage or crashes: for an AEDAT 4 file it
allocates as much memory as a corrupt size states, and ends the process if there is not enough. So
files are first searched for patterns that no sensor writes; docs/security.md lists them.
"""

import re
import struct
import warnings
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, BinaryIO
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from ssac.arrays import Events, Mask
from ssac.errors import SsacError
from ssac.events import EVENT_DTYPE, EventFile, SizePx
from ssac.files.damage import (
    Reading,
    brief,
    checked_file,
    count_repeated,
    readable,
    refuse_damaged,
    silenced,
)

Words = NDArray[Any]

UNKNOWN_SIZE = (65535, 65535)  # assumed by faery when a header does not give the sensor's size

_KINDS = ("words that mean nothing", "times that run back", "leaps of the clock", "repeated words")

_SLACK_EVT3 = 16  # steps of 4.1 ms that the clock of a busy sensor may leave out

_MAGIC = b"#!AER-DAT4.0\r\n"
_STREAM = re.compile(rb'<node name="(\d+)"')


def load_makers_file(path: Path, reading: Reading, named: Path | None = None) -> EventFile:
    """Read a camera maker's file; messages call it `named`, or `path` if `named` is None."""
    name = named or path
    with TemporaryDirectory() as folder:
        decoded = _decoded(_undamaged(path, reading, name, Path(folder)), reading, name)
    file = checked_file(*decoded, name, reading)
    if path.suffix.lower() == ".es" and file.events["t"][0] == 0:
        warnings.warn(
            f"{path} starts at time 0: whoever wrote it may have subtracted its first timestamp, "
            "and the offset found is then off by it",
            stacklevel=3,
        )
    return file


def _decoded(path: Path, reading: Reading, name: Path) -> tuple[Events, SizePx]:
    """Return all events, or those before the damage if allowed, and the sensor's size [px]."""
    import faery  # here, as it takes long: other formats do without it

    blocks: list[NDArray[Any]] = [np.empty(0, faery.EVENTS_DTYPE)]
    with readable(name, f"a complete {name.suffix} file"), silenced():
        stream = faery.events_stream_from_file(path, dimensions_fallback=UNKNOWN_SIZE)
        width, height = stream.dimensions()
        try:
            blocks.extend(stream)
        except BaseException as error:  # a panic of the library is no Exception
            is_end = isinstance(error, KeyboardInterrupt | SystemExit)
            if is_end or len(blocks) == 1 or not reading.allow_damaged:
                raise
            n_read = sum(map(len, blocks))
            warnings.warn(
                f"{name} can be read no further than its first {n_read} events ({brief(error)})",
                stacklevel=4,
            )
    # Both dtypes have the fields t, x, y, p of 8, 2, 2 and 1 bytes in this order.
    events = np.concatenate(blocks).view(EVENT_DTYPE)
    return events, (None, None) if (width, height) == UNKNOWN_SIZE else (width, height)


def _undamaged(path: Path, reading: Reading, name: Path, folder: Path) -> Path:
    """Return the file that faery is to decode; SsacError for damage that faery overlooks."""
    suffix = path.suffix.lower()
    if suffix in (".aedat4", ".es"):
        refuse_damaged(name, _signs_of_packets(path) if suffix == ".aedat4" else [], reading)
        return path
    encoding = "dat" if suffix == ".dat" else _evt_version(path)
    dtype, n_about, find = {
        "evt2": ("<u4", 0, _signs_of_evt2),
        "evt3": ("<u2", 0, _signs_of_evt3),
        "dat": ("<u8", 2, _signs_of_dat),  # 2 bytes of a record's type and size
    }[encoding]
    words, n_rest = _words(path, np.dtype(dtype), n_about)
    *counts, is_event = find(words)
    counts.append(count_repeated((words[1:] == words[:-1]) & is_event[1:]))
    signs = [
        f"{count} {kind} ({100.0 * count / len(words):.2g} %)"
        for count, kind in zip(counts, _KINDS, strict=True)
        if count
    ]
    if n_rest:
        signs.append(f"{n_rest} bytes beyond the last whole word of {words.itemsize}")
    refuse_damaged(name, signs, reading)
    return _with_wraps(path, words, n_rest, folder) if encoding == "evt3" else path


def _with_wraps(path: Path, words: Words, n_rest: int, folder: Path) -> Path:
    """Return a file, or a copy of an EVT3 file with the words by which faery knows a wrap-around.

    It takes the clock, of 16.8 s, to start again only where a word of 4095 is followed by one of 0,
    and a sensor that writes the time only when it changes may see nothing just then.
    """
    at = np.flatnonzero(words >> 12 == 0x8)
    high = (words[at] & 0xFFF).astype(np.int64)
    wraps = high[1:] - high[:-1] < -0x800
    untold = at[1:][wraps & ((high[:-1] != 0xFFF) | (high[1:] != 0))]
    if len(untold) == 0:
        return path
    mended = folder / path.name
    header = path.read_bytes()[: path.stat().st_size - words.nbytes - n_rest]
    told = np.insert(words, np.repeat(untold, 2), np.tile([0x8FFF, 0x8000], len(untold)))
    mended.write_bytes(header + told.tobytes())
    return mended


def _evt_version(path: Path) -> str:
    """Read a RAW file's encoding from its header; SsacError unless it is "evt2" or "evt3"."""
    import faery

    kind = "a complete .raw file"
    with readable(path, kind), silenced(), faery.evt.Decoder(path, UNKNOWN_SIZE, None) as decoder:
        version = str(decoder.version)
    if version not in ("evt2", "evt3"):
        raise SsacError(f"{path}: its encoding is {version}: convert it to EVT2 or EVT3")
    return version


def _words(path: Path, dtype: np.dtype[Any], n_about: int) -> tuple[Words, int]:
    """Read all words after the header and `n_about` more bytes; also count the bytes left over."""
    with readable(path, "a readable file"), path.open("rb") as file:
        start = 0
        while (line := file.readline()).startswith(b"%"):
            start = file.tell()
            if line.startswith(b"% end"):
                break
        n_bytes = max(0, path.stat().st_size - start - n_about)
        words = np.fromfile(path, dtype, n_bytes // dtype.itemsize, offset=start + n_about)
    return words, n_bytes % dtype.itemsize


def _signs_of_evt2(words: Words) -> tuple[int, int, int, Mask]:
    """Count the signs of damage of the first three `_KINDS`; also tell which words are events."""
    kinds = words >> 28
    is_event, is_high = kinds <= 1, kinds == 0x8
    falls = -np.diff((words[is_high] & 0xFFFFFFF).astype(np.int64))
    n_back = np.count_nonzero((falls > 0) & (falls <= 1 << 27))  # a larger fall is a wrap-around
    low, n_high = words[is_event] >> 22 & 0x3F, np.cumsum(is_high)[is_event]
    under_one = (n_high[1:] == n_high[:-1]) & (n_high[1:] > 0)
    n_back += np.count_nonzero((low[1:] < low[:-1]) & under_one)
    n_invalid = _meaningless(kinds, (0x0, 0x1, 0x8, 0xA, 0xE), (0xF,))
    return n_invalid, n_back, 0, is_event


def _signs_of_evt3(words: Words) -> tuple[int, int, int, Mask]:
    kinds = words >> 12
    steps = np.diff((words[kinds == 0x8] & 0xFFF).astype(np.int64)) & 0xFFF
    n_leaps = np.count_nonzero((steps > _SLACK_EVT3) & (steps < 0x800))
    if np.count_nonzero(steps == 0) * 10 < len(steps):
        n_leaps = 0  # the sensor writes time only when it changes: gaps are pauses
    n_invalid = _meaningless(kinds, (0x0, 0x2, 0x3, 0x4, 0x5, 0x6, 0x8, 0xA, 0xE), (0x7, 0xF))
    is_event = np.isin(kinds, (0x0, 0x2, 0x3, 0x6))  # y, x, x, time
    return n_invalid, np.count_nonzero(steps >= 0x800), n_leaps, is_event


def _signs_of_dat(words: Words) -> tuple[int, int, int, Mask]:
    steps_us = np.diff((words & np.uint64(0xFFFFFFFF)).astype(np.int64))
    n_invalid = np.count_nonzero(words >> np.uint64(60) > 1)
    # After a larger fall the counter has wrapped around.
    n_back = np.count_nonzero((steps_us < 0) & (steps_us >= -(1 << 31)))
    return n_invalid, n_back, 0, np.ones(len(words), np.bool_)


def _meaningless(kinds: Words, alone: tuple[int, ...], going_on: tuple[int, ...]) -> int:
    """Count words of unknown kinds, and continuation words that follow no word to continue."""
    goes_on = np.isin(kinds, going_on)
    goes_on[:1] = False
    goes_on[1:] &= np.isin(kinds[:-1], (0xE, *going_on))
    return np.count_nonzero(~(np.isin(kinds, alone) | goes_on))


def _signs_of_packets(path: Path) -> list[str]:
    """List the damage to an AEDAT 4 file's packets; SsacError if its header is damaged."""
    kind = f"a complete {path.suffix} file"
    with readable(path, kind), path.open("rb") as file:
        size = path.stat().st_size
        if file.read(len(_MAGIC)) != _MAGIC:
            raise ValueError("its first line is none")
        (n_header,) = struct.unpack("<I", file.read(4))
        if not 16 <= n_header <= min(1 << 24, size - file.tell()):
            raise ValueError(f"its header says that it has {n_header} bytes")
        header = file.read(n_header)
        _check_description(header)
        n_streams = header.count(b">EVTS<")
        if n_streams > 1:
            raise SsacError(
                f"{path}: holds {n_streams} streams of events: write each to a file of its own"
            )
        streams = {int(number) for number in _STREAM.findall(header)}
        place = _field_place(header, 1)  # position of the packet table, after the packets
        table = struct.unpack_from("<q", header, place)[0] if place else 0
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


def _check_description(header: bytes) -> None:
    """Raise ValueError unless the header's XML can be parsed, as the library might abort."""
    place = _field_place(header, 2)
    start = place + struct.unpack_from("<I", header, place)[0] if place else 0
    (length,) = struct.unpack_from("<I", header, start) if place else (0,)
    text = header[start + 4 : start + 4 + length] if place else b""
    try:
        if len(text) < length or b"<!" in text:  # an entity may stand for gigabytes
            raise ValueError("its description of streams is cut off, or no plain one")
        ElementTree.fromstring(text.decode("utf-8"))
    except (ValueError, ElementTree.ParseError) as error:
        raise ValueError(f"its header's XML: {error}") from error


def _field_place(header: bytes, number: int) -> int:
    """Return the byte of the header, a FlatBuffer, where a field begins; 0 if it is absent."""
    (root,) = struct.unpack_from("<I", header)
    fields = root - struct.unpack_from("<i", header, root)[0]
    (length,) = struct.unpack_from("<H", header, fields)
    place = 4 + 2 * number
    if place + 2 > length:
        return 0
    (offset,) = struct.unpack_from("<H", header, fields + place)
    return root + offset if offset else 0
