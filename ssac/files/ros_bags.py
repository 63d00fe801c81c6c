"""ROS 1 and ROS 2 bags, which the library rosbags opens; their messages are decoded here.

A path may lead into a bag: BAG/TOPIC is one topic of it, where BAG is a file (.bag, .db3, .mcap) or
the folder of a ROS 2 bag. If the path names no topic, the only topic with events is taken; if none
has events, the only one with points, which is a track (x and y [px], at the header's time). Each
event has its own time: the times at which messages were sent or written are ignored.

The library's own decoding makes an object of each event, which is some 40 times as slow, and runs
code that it generates from definitions in the bag.
"""

import re
import struct
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ssac.arrays import Events, IntArray
from ssac.errors import SsacError
from ssac.events import EVENT_DTYPE, EventFile, events_from_arrays
from ssac.files.damage import STRICT, Reading, checked_file, readable, refuse_damaged, side_px
from ssac.points import PointTrack

BAG_SUFFIXES = (".bag", ".db3", ".mcap")

_ARRAYS = ("dvs_msgs/msg/EventArray", "prophesee_event_msgs/msg/EventArray")
_PACKETS = "event_camera_msgs/msg/EventPacket"
_POINTS = "geometry_msgs/msg/PointStamped"
_KINDS = (*_ARRAYS, _PACKETS, _POINTS)

_METADATA = "metadata.yaml"  # of a ROS 2 bag's folder
_COMPRESSED = ".zstd"  # follows the suffix of a compressed file of a ROS 2 bag
_READABLE = "a readable ROS bag"
_EVT = {"evt2": ("u4", 28), "evt3": ("u2", 12)}  # a word's type; bits below its 4-bit kind
_TIME_HIGH = 0x8
_EVENT_BYTES = 13  # of ROS 1; ROS 2 aligns numbers, so that events begin 16 bytes apart


class SeveralTopicsError(SsacError):
    """A bag has several topics that can be used, and none was named."""

    def __init__(self, bag: Path, names: list[str]) -> None:
        super().__init__(
            f"{bag}: events or points are on {len(names)} topics, {', '.join(names)}: name one "
            f"behind the bag, as {bag}{names[0]}"
        )
        self.names = names


@dataclass(frozen=True)
class Topic:
    """One topic of a bag."""

    path: Path  # as the caller gave it, for error messages
    bag: Path
    name: str
    kind: str  # type of its messages

    @property
    def is_track(self) -> bool:
        """Whether the topic holds points, not events."""
        return self.kind == _POINTS


def bag_of(path: Path) -> tuple[Path, str] | None:
    """Split a path into an existing bag and a topic, "" if none is named; None if it has no bag."""
    for bag in (path,) if path.exists() else path.parents:
        is_named = bag.name.lower().removesuffix(_COMPRESSED).endswith(BAG_SUFFIXES)
        if (is_named and bag.is_file()) or _metadata(bag):
            return bag, "/".join(path.relative_to(bag).parts)
    return None


def file_of(path: Path) -> Path:
    """Return the bag that a path leads into, or the path itself if there is none."""
    found = bag_of(path)
    return path if found is None else found[0]


@cache
def _kinds(bag: Path, written_ns: int) -> dict[str, str]:
    """Types of all topics; a compressed bag is decompressed as a whole each time it is opened."""
    del written_ns  # one that is written anew is read anew
    with readable(bag, _READABLE), _reader(bag) as reader:
        return {str(one.topic): str(one.msgtype) for one in reader.connections}


def topic_of(path: Path) -> Topic:
    """Find the topic that a path names, or the only one that can be used; SsacError if none can."""
    found = bag_of(path)
    if found is None:
        raise SsacError(f"{path}: there is no such bag: check the path")
    bag, wanted = found
    about = bag / _METADATA if bag.is_dir() else bag
    kinds = _kinds(bag, about.stat().st_mtime_ns)
    of_events = [name for name, kind in kinds.items() if kind in _KINDS and kind != _POINTS]
    usable = of_events or [name for name, kind in kinds.items() if kind == _POINTS]
    if wanted:
        usable = [name for name in kinds if name.strip("/") == wanted]
    if len(usable) == 1 and kinds[usable[0]] in _KINDS:
        return Topic(path, bag, usable[0], kinds[usable[0]])
    there = ", ".join(f"{name} ({kinds[name]})" for name in sorted(kinds)[:10]) or "none"
    if len(usable) > 1:
        raise SeveralTopicsError(bag, sorted(usable))
    if wanted and not usable:
        raise SsacError(f"{bag}: there is no topic /{wanted}, only {there}: name one of these")
    what = f"these on the topic /{wanted}" if wanted else "a topic of events or points"
    raise SsacError(f"{bag}: expected {what} ({', '.join(_KINDS)}), got the topics {there}")


def load_events_bag(path: Path, reading: Reading) -> EventFile:
    """Read the events of a topic, message by message."""
    topic = topic_of(path)
    if topic.is_track:
        raise SsacError(f"{path}: {topic.name} holds points, a track: expected a topic of events")
    forms: set[tuple[int, int, str]] = set()  # width, height and encoding
    blocks: list[Events] = [np.empty(0, EVENT_DTYPE)]
    words: list[NDArray[Any]] = []  # evt2 or evt3 words, which are decoded together at the end

    def take(message: _Message) -> None:
        message.header_ns()
        height, width = message.number("I"), message.number("I")
        if topic.kind != _PACKETS:
            forms.add((width, height, "events"))
            blocks.append(message.events(str(path)))
            return
        message.number("Q")  # the packet's number in the sequence
        base_ns = message.number("Q")
        encoding = message.text().rstrip(b"\0").decode("ascii", "replace")
        order = ">" if message.number("B") else "<"
        forms.add((width, height, encoding))
        if encoding == "mono":  # p (1 bit), y (15), x (16) and the time since `base_ns` (32) [ns]
            bits = np.frombuffer(message.text(), order + "u8").astype(np.int64)
            t_us = _us_from_ns(base_ns + (bits & 0xFFFFFFFF))
            x, y = bits >> 32 & 0xFFFF, bits >> 48 & 0x7FFF
            blocks.append(events_from_arrays(t_us, x, y, bits < 0, str(path)))
        elif encoding in _EVT:
            code = _EVT[encoding][0]
            words.append(np.frombuffer(message.text(), order + code).astype("<" + code))
        else:
            raise SsacError(
                f"{path}: expected the encoding mono, evt2 or evt3, got {encoding[:40]!r}: "
                "record or convert it to one of them"
            )

    _for_each(topic, take, reading)
    if len(forms) > 1:
        got = ", ".join(f"{w} x {h} px of {form}" for w, h, form in sorted(forms)[:5])
        raise SsacError(f"{path}: expected one camera's events on a topic, got {got}: split it")
    if words:
        return _of_words(np.concatenate(words), *max(forms), path, reading)
    sides = max(forms)[:2] if forms else (0, 0)
    said = "a message's width and height must be"
    width, height = (side_px(side, said, path) if side else None for side in sides)
    return checked_file(np.concatenate(blocks), (width, height), path, reading)


def load_track_bag(path: Path) -> PointTrack:
    """Read the points of a topic; `ssac.points.check_track` checks them."""
    rows: list[tuple[float, float, float]] = []

    def take(message: _Message) -> None:
        time_s = 1e-9 * message.header_ns()
        rows.append((time_s, message.number("d"), message.number("d")))

    _for_each(topic_of(path), take, STRICT)
    table = np.array(rows, np.float64).reshape(-1, 3)
    return PointTrack(table[:, 0], table[:, 1:])


def _reader(bag: Path) -> Any:
    try:
        from rosbags import rosbag1, rosbag2
    except ImportError as error:
        raise SsacError(
            f"{bag}: ROS bags need the package rosbags, which is not installed: pip install "
            '"ssac-suite[ros]"'
        ) from error
    if _is_ros1(bag):
        return rosbag1.Reader(bag)
    mode = r"compression_mode: *\W?message"  # which the metadata beside a file may say
    if bag.is_file() and (
        bag.suffix == _COMPRESSED or re.search(mode, _metadata(bag.parent), re.IGNORECASE)
    ):
        raise SsacError(f"{bag}: is compressed: give its folder with {_METADATA}, or decompress it")
    return rosbag2.Reader(bag)


def _metadata(folder: Path) -> str:
    """Return the metadata of a ROS 2 bag's folder; empty if it has none of a bag."""
    about = folder / _METADATA
    with readable(about, _READABLE):
        text = about.read_text(encoding="utf-8", errors="replace") if about.is_file() else ""
    return text if "rosbag2_bagfile_information" in text else ""


def _is_ros1(bag: Path) -> bool:
    return bag.suffix.lower() == ".bag" and bag.is_file()


class _Message:
    """A reader of a message's fields, one after another, in the layout of ROS 1 or ROS 2 (CDR)."""

    def __init__(self, raw: bytes, is_ros1: bool) -> None:
        self.raw, self.is_ros1 = raw, is_ros1
        self.start = 0 if is_ros1 else 4  # after CDR's own header
        self.order = "<" if is_ros1 or raw[1] & 1 else ">"
        self.at = self.start

    def number(self, code: str) -> Any:
        """Read a number, whose type is given as a format character of `struct`."""
        n_bytes = struct.calcsize(f"={code}")
        if not self.is_ros1:
            self.at += (self.start - self.at) % n_bytes
        (value,) = struct.unpack_from(f"{self.order}{code}", self.raw, self.at)
        self.at += n_bytes
        return value

    def text(self) -> bytes:
        """Read a string, or a list of bytes."""
        n_bytes = self.number("I")
        if n_bytes > len(self.raw) - self.at:
            raise ValueError(f"{n_bytes} bytes in a message that has {len(self.raw) - self.at}")
        found = self.raw[self.at : self.at + n_bytes]
        self.at += n_bytes
        return found

    def header_ns(self) -> int:
        """Read a std_msgs/Header; return its time [ns]."""
        if self.is_ros1:
            self.number("I")
        seconds, rest_ns = self.number("I" if self.is_ros1 else "i"), self.number("I")
        self.text()
        return int(seconds) * 10**9 + int(rest_ns)

    def events(self, name: str) -> Events:
        """Read the list of events (x, y, time and polarity) that ends the message."""
        n, first = self.number("I"), self.at
        ends = first + (_EVENT_BYTES * n if self.is_ros1 else 16 * n - 3 * (n > 0))
        # ROS 2 may pad the end to a multiple of four bytes.
        if not 0 <= len(self.raw) - ends < (1 if self.is_ros1 else 4):
            raise ValueError(f"{n} events in a message of {len(self.raw)} bytes")
        gap = 0 if self.is_ros1 else 2
        about: Any = {
            "names": ["x", "y", "s", "ns", "p"],
            "formats": [f"{self.order}{code}" for code in ("u2", "u2", "u4", "u4", "u1")],
            "offsets": [0, 2, 4 + gap, 8 + gap, 12 + gap],
            "itemsize": _EVENT_BYTES if self.is_ros1 else 16,
        }
        # In ROS 2 the first event begins at a multiple of four bytes, others two bytes before one.
        events = np.frombuffer(self.raw + b"\0", np.dtype(about), n, first - gap)
        x, y = events["x"].copy(), events["y"].copy()
        if n:
            x[0], y[0] = struct.unpack_from(f"{self.order}HH", self.raw, first)
        t_us = 1_000_000 * events["s"].astype(np.int64) + _us_from_ns(events["ns"])
        return events_from_arrays(t_us, x, y, events["p"], name)


def _of_words(
    words: NDArray[Any], width: int, height: int, encoding: str, path: Path, reading: Reading
) -> EventFile:
    """Decode EVT words through a temporary RAW file, without those before the first time word."""
    from ssac.files.makers import load_makers_file

    version = encoding.removeprefix("evt")
    size = f"width={width};height={height}"
    header = f"% evt {version}.0\n% format EVT{version};{size}\n% end\n"
    tells = words >> _EVT[encoding][1] == _TIME_HIGH
    first = int(np.argmax(tells)) if tells.any() else len(words)
    with TemporaryDirectory() as folder:
        file = Path(folder) / "events.raw"
        file.write_bytes(header.encode() + words[first:].tobytes())
        return load_makers_file(file, reading, path)


def _us_from_ns(times_ns: NDArray[Any]) -> IntArray:
    return (times_ns.astype(np.int64) + 500) // 1000


def _for_each(topic: Topic, take: Callable[[_Message], None], reading: Reading) -> None:
    """Call `take` with each message of a topic, or with those before the damage, if allowed."""
    n = n_said = 0
    try:
        with readable(topic.path, _READABLE), _reader(topic.bag) as reader:
            chosen = [one for one in reader.connections if one.topic == topic.name]
            n_said = sum(one.msgcount for one in chosen)
            for _, _, raw in reader.messages(chosen):
                take(_Message(bytes(raw), _is_ros1(topic.bag)))
                n += 1
    except SsacError as error:
        if not (n and reading.allow_damaged):
            raise
        said = f"{topic.path} can be read no further than its first {n} messages ({error})"
        warnings.warn(said, stacklevel=4)
    else:
        lost = [f"{n_said - n} of {n_said} messages are missing"] if n < n_said else []
        refuse_damaged(topic.path, lost, reading)
