"""Text recordings: ESIM text, and comma-separated values (docs/sync.md).

The names of a csv file's columns may include the sensor's size as faery writes it (`x@346`), and
`p` may be called `on`. The polarity of a darker event is 0 or -1.
"""

import csv
import warnings
from pathlib import Path

import numpy as np

from ssac.arrays import Array, Events, IntArray
from ssac.errors import SsacError
from ssac.events import EVENT_DTYPE, US_PER_S, EventFile, events_from_arrays
from ssac.files.damage import LONGEST_S, Reading, check_text, checked_file, readable, side_px
from ssac.files.whole_file import whole_file

_SIZE = "the sensor's size in the first line must be"

LINES_PER_BLOCK = 1_000_000  # so that reading needs little more memory than the events


def load_events_text(path: Path, reading: Reading) -> EventFile:
    """Read ESIM text."""
    first_line = _first_line(path).split()
    width, height = None, None
    if len(first_line) == 2 and all(map(_is_whole_number, first_line)):
        width, height = (side_px(word, _SIZE, path) for word in first_line)
    elif len(first_line) not in (0, 4):
        raise SsacError(
            f"{path}: the first line must be four numbers t x y p, or `width height`, got "
            f"{' '.join(first_line)[:60]!r}: convert the file"
        )
    events = _read_table(path, r"\s+", list("txyp"), has_header=width is not None, in_seconds=True)
    return checked_file(events, (width, height), path, reading, "seconds", is_text=True)


def load_events_csv(path: Path, reading: Reading) -> EventFile:
    """Read comma-separated events whose first line names the columns t, x, y and p."""
    columns, sizes = [], {}
    for word in _first_line(path).lower().split(","):
        name, _, size = word.strip().strip('"').partition("@")
        columns.append("p" if name == "on" else name)
        if _is_whole_number(size):
            sizes[name] = side_px(size, _SIZE, path)
    if {"t_s", "x_px", "y_px"} <= set(columns):
        raise SsacError(f"{path}: is a track of points, not events: load_track reads it")
    if not set("txyp") <= set(columns):
        raise SsacError(
            f"{path}: the first line must name the columns t,x,y,p (t in microseconds) of events, "
            f"or t_s,x_px,y_px of a track, got {','.join(columns)[:60]!r}: "
            "add that line, with commas"
        )
    events = _read_table(path, ",", columns, has_header=True, in_seconds=False)
    size_px = sizes.get("x"), sizes.get("y")
    return checked_file(events, size_px, path, reading, "microseconds", is_text=True)


def save_events_text(path: Path, events: Events, width: int | None, height: int | None) -> None:
    """Write ESIM text, exact to the microsecond, with the sensor's size [px] where it is known."""
    with whole_file(path) as temporary, temporary.open("w", encoding="utf-8") as file:
        if width is not None and height is not None:
            file.write(f"{width} {height}\n")
        for first in range(0, len(events), LINES_PER_BLOCK):
            block = events[first : first + LINES_PER_BLOCK].tolist()
            file.writelines(f"{t / US_PER_S:.6f} {x} {y} {p}\n" for t, x, y, p in block)


def _first_line(path: Path) -> str:
    check_text(path)
    with readable(path, "a text file"), path.open(encoding="utf-8-sig") as file:
        return file.readline(4096)


def _is_whole_number(word: str) -> bool:
    return word.isascii() and word.isdigit()  # isdigit accepts "³" too


def _read_table(
    path: Path, separator: str, columns: list[str], has_header: bool, in_seconds: bool
) -> Events:
    """Read the events of a table; times in seconds are rounded to whole microseconds."""
    import pandas as pd  # here, as it takes long: other formats do without it

    blocks: list[Events] = [np.empty(0, EVENT_DTYPE)]
    numbers = "in whole numbers, t in " + ("seconds" if in_seconds else "microseconds")
    form = f"a table of events: every line must be {', '.join(columns)[:60]} {numbers}"
    with (
        readable(path, form, "complete or remove the line"),
        np.errstate(invalid="ignore"),  # the error says the same
        warnings.catch_warnings(),
        pd.read_csv(
            path,
            sep=separator,
            names=columns,  # all are read: with a selection, fields beyond them would be lost
            dtype=dict.fromkeys("xyp", np.int64) | {"t": np.float64 if in_seconds else np.int64},
            skiprows=int(has_header),
            chunksize=LINES_PER_BLOCK,
            quoting=csv.QUOTE_NONE,  # else a stray quotation mark swallows lines
            index_col=False,
        ) as reader,
    ):
        warnings.simplefilter("error", pd.errors.ParserWarning)  # a longer first line
        warnings.simplefilter("ignore", pd.errors.DtypeWarning)  # of further columns
        for table in reader:
            t, x, y, p = (table[field].to_numpy() for field in "txyp")
            if in_seconds:
                t = _microseconds_from_seconds(t, path)
            blocks.append(events_from_arrays(t, x, y, p, name=str(path)))
    return np.concatenate(blocks)


def _microseconds_from_seconds(t_s: Array, path: Path) -> IntArray:
    """Round to whole microseconds; SsacError for nan, inf and times apparently not in seconds."""
    most_s = 2.0**62 / US_PER_S  # so that whole microseconds fit in 64 bits
    if not (np.abs(t_s) < most_s).all():  # true of NaN too
        raise SsacError(
            f"{path}: times must be finite, got nan, inf or more than {most_s:g} s: convert the "
            "file again"
        )
    span_s = t_s[-1] - t_s[0] if len(t_s) > 1 else 0.0
    if span_s > LONGEST_S and np.array_equal(t_s, np.rint(t_s)):
        raise SsacError(
            f"{path}: t must be in seconds, but all times are whole numbers, up to {t_s[-1]:.0f}, "
            "as of milliseconds or finer: convert them"
        )
    return np.rint(t_s * US_PER_S).astype(np.int64)
