"""An AEDAT 4 file in; the signs of damage in what holds its packets together out.

A size in it that is nonsense makes its library take as much memory, and ends the process when there
is none; a packet of a stream that is none is passed over. So both are looked at before.
"""

import re
import struct
from pathlib import Path
from typing import BinaryIO
from xml.etree import ElementTree

from ssac.errors import SsacError
from ssac.files.net import brief, readable

_MAGIC = b"#!AER-DAT4.0\r\n"
_STREAM = re.compile(rb'<node name="(\d+)"')
_TABLE_FIELD = 1  # of the header: where the table of packets begins, behind the last of them
_DESCRIPTION_FIELD = 2  # of the header: the streams, as XML
_MAX_HEADER = 1 << 24  # bytes


def check_packets(path: Path) -> list[str]:
    """Walk from packet to packet.

    Returns
    -------
    list of str
        What is wrong that still leaves packets to read; empty for a file that is whole.

    Raises
    ------
    SsacError
        If its header is none.
    """
    kind = f"a complete {path.suffix} file"
    with readable(path, kind), path.open("rb") as file:
        size = path.stat().st_size
        if file.read(len(_MAGIC)) != _MAGIC:
            raise SsacError(f"{path}: not {kind} (its first line is none): copy it again")
        (n_header,) = struct.unpack("<I", file.read(4))
        if not 16 <= n_header <= min(_MAX_HEADER, size - file.tell()):
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
    place = _field_place(header, _DESCRIPTION_FIELD)
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
    """Read where the table of packets begins off the header; 0 where it does not say."""
    place = _field_place(header, _TABLE_FIELD)
    position: int = struct.unpack_from("<q", header, place)[0] if place else 0
    return position


def _field_place(header: bytes, number: int) -> int:
    """Find a field of the header; 0 where it is left out.

    The header is a flat buffer: a table begins with the distance back to the list of where its
    fields are.
    """
    (root,) = struct.unpack_from("<I", header)
    fields = root - struct.unpack_from("<i", header, root)[0]
    (length,) = struct.unpack_from("<H", header, fields)
    place = 4 + 2 * number
    if place + 2 > length:
        return 0
    (offset,) = struct.unpack_from("<H", header, fields + place)
    return root + offset if offset else 0
