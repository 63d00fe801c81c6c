"""What becomes of event files that are damaged, or out of order.

A file with signs of damage is refused: what is left of it is not what was recorded. Whoever wants
that nevertheless says so (`Reading.allow_damaged`), and is told how much was lost. Events that are
out of order by microseconds, as some cameras' drivers write them, are another matter: they are
sorted where that is asked for (`Reading.sort`).
"""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numba
import numpy as np
from numpy.typing import NDArray

from ssac.errors import SsacError
from ssac.events import US_PER_S, EventFile, check_events, wrap_message, wrapped

REPEATED = 32
"""So many equal words, or events, in a row are none of a sensor: a block was overwritten."""

_LONGEST_GAP_US = 3600 * US_PER_S  # without an event in one file: no recording pauses for longer


@dataclass(frozen=True)
class Reading:
    """What may be made of an event file that is not as it should be."""

    allow_damaged: bool = False  # read what is left, and warn
    sort: bool = False  # put events in order that are out of it by less than 1 ms


STRICT = Reading()


def refuse_damaged(path: Path, signs: Sequence[str], reading: Reading) -> None:
    """Raise SsacError for a file with signs of damage, or warn where it is to be read anyway."""
    if not signs:
        return
    found = "; ".join(signs)
    if not reading.allow_damaged:
        raise SsacError(
            f"{path}: is damaged: {found}: copy or record it again, or read what is left of it "
            "with --allow-damaged"
        )
    warnings.warn(f"{path} is damaged, and what is left of it is read: {found}", stacklevel=3)


def checked_file(
    events: NDArray[np.void],
    size_px: tuple[int | None, int | None],
    path: Path,
    reading: Reading,
    is_text: bool = False,
) -> EventFile:
    """Give the events of a file as they are if it is whole, else what `reading` makes of them.

    In text, whose times may be rounded, one event may stand often. SsacError if time runs back or
    leaps, one event stands there many times, or events lie outside the sensor (of a size that may
    be None), and that is not allowed; or if there are none.
    """
    t, x, y, p = (events[field] for field in ("t", "x", "y", "p"))
    width, height = (1 << 16 if size is None else size for size in size_px)  # all that fits
    most_equal = len(events) if is_text else REPEATED - 1
    if _is_whole(t, x, y, p, width, height, _LONGEST_GAP_US, most_equal):
        return EventFile(events, *size_px)
    events = _in_order(events, path, reading, is_text)
    if reading.allow_damaged:
        events = _inside(events, size_px, path)
    check_events(events, *size_px, name=str(path))
    return EventFile(events, *size_px)


def _in_order(
    events: NDArray[np.void], path: Path, reading: Reading, is_text: bool
) -> NDArray[np.void]:
    n_back, first_back, most_back_us, n_leaps, n_repeated = _order(events, _LONGEST_GAP_US)
    if n_back and not n_leaps and most_back_us < 1000:  # as a driver mixes events up
        events = _sorted(events, path, n_back, most_back_us, reading)
        n_back = 0
    elif n_back and not reading.allow_damaged:
        _refuse_unsorted(events["t"], first_back, path)
    signs: list[str] = []
    if n_leaps:
        signs.append(f"{n_leaps} leaps of time by more than {_LONGEST_GAP_US / US_PER_S:g} s")
    if n_repeated and not is_text:
        signs.append(f"{n_repeated} events stand there {REPEATED} times in a row or more")
    if n_back or n_leaps:
        kept = _longest(events, _LONGEST_GAP_US) if reading.allow_damaged else events
        if len(kept) < len(events):
            lost = len(events) - len(kept)
            signs.append(
                f"time runs back or leaps: {lost} of {len(events)} events "
                f"({100.0 * lost / len(events):.2g} %) are left out"
            )
        events = kept
    refuse_damaged(path, signs, reading)
    return events


def _inside(
    events: NDArray[np.void], size_px: tuple[int | None, int | None], path: Path
) -> NDArray[np.void]:
    """Leave out events that lie outside the sensor, or of no polarity, and warn."""
    keep = events["p"] <= 1
    for field, size in zip("xy", size_px, strict=True):
        if size is not None:
            keep &= events[field] < size
    n_lost = len(events) - int(np.count_nonzero(keep))
    if not n_lost:
        return events
    warnings.warn(
        f"{path}: {n_lost} of {len(events)} events lie outside the sensor, or have no polarity, "
        "and are left out",
        stacklevel=4,
    )
    return events[keep]


def _sorted(
    events: NDArray[np.void], path: Path, n_back: int, most_back_us: int, reading: Reading
) -> NDArray[np.void]:
    """Sort events that are nearly in order, where that is asked for; equal times keep theirs."""
    if not reading.sort:
        raise SsacError(
            f"{path}: events must be sorted by time, but {n_back} of {len(events)} come up to "
            f"{most_back_us} us too late: sort them with --sort"
        )
    warnings.warn(
        f"{path}: {n_back} of {len(events)} events came up to {most_back_us} us too late and were "
        "sorted",
        stacklevel=4,
    )
    return events[np.argsort(events["t"], kind="stable")]


def _refuse_unsorted(t: NDArray[np.int64], i: int, path: Path) -> None:
    if wrapped(t[i - 1] / US_PER_S, t[i] / US_PER_S):
        raise SsacError(f"{path}: {wrap_message(f'event {i}')}")
    raise SsacError(
        f"{path}: events must be sorted by time, but event {i} is at {t[i]} us, after one at "
        f"{t[i - 1]} us: sort the file, or check that it is undamaged (--allow-damaged reads what "
        "is in order)"
    )


@numba.njit(cache=True)
def _is_whole(
    t: NDArray[np.int64],
    x: NDArray[np.uint16],
    y: NDArray[np.uint16],
    p: NDArray[np.uint8],
    width: int,
    height: int,
    longest_us: int,
    most_equal: int,
) -> bool:
    """Whether nothing of all that is looked at is wrong: one pass, for nearly every file."""
    if len(t) == 0:
        return False
    is_bad, run = False, 1
    t_before, x_before, y_before = t[0], -1, -1  # kept: an index less one costs a test of its own
    for i in range(len(t)):
        t_us, column, row = t[i], int(x[i]), int(y[i])
        gap_us = t_us - t_before
        is_bad |= (gap_us < 0) | (gap_us > longest_us)  # none of these branches
        is_bad |= (column >= width) | (row >= height) | (p[i] > 1)
        if gap_us == 0 and column == x_before and row == y_before:
            run += 1
            is_bad |= run > most_equal
        else:
            run = 1
        t_before, x_before, y_before = t_us, column, row
    return not is_bad


def _order(events: NDArray[np.void], longest_us: int) -> tuple[int, int, int, int, int]:
    """Count times that run back, the first of them, by how much [us], leaps, repeated events."""
    t, x, y = (events[field] for field in "txy")
    steps_us, is_back = np.diff(t), t[1:] < t[:-1]
    n_leaps = np.count_nonzero(~is_back & ((steps_us > longest_us) | (steps_us < 0)))  # of int64
    is_same = (steps_us == 0) & (x[1:] == x[:-1]) & (y[1:] == y[:-1])
    runs = np.diff(np.flatnonzero(~is_same), prepend=-1, append=len(t) - 1)
    first_back = int(np.argmax(is_back)) + 1 if is_back.any() else 0
    most_back_us = int(np.max(np.maximum.accumulate(t) - t, initial=0))
    n_repeated = int(runs[runs >= REPEATED].sum())
    return int(np.count_nonzero(is_back)), first_back, most_back_us, int(n_leaps), n_repeated


def _longest(events: NDArray[np.void], longest_us: int) -> NDArray[np.void]:
    """Keep as many events as are in order; of the parts between leaps of time, the largest."""
    if len(events) == 0:
        return events
    events = events[_in_sequence(events["t"])]
    ends = np.append(1 + np.flatnonzero(np.diff(events["t"]) > longest_us), len(events))
    starts = np.append(0, ends[:-1])
    k = int(np.argmax(ends - starts))
    return events[starts[k] : ends[k]]


@numba.njit(cache=True)
def _in_sequence(t: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Mark the longest subsequence of times (n,) that never runs back."""
    n = len(t)
    last = np.empty(n, np.int64)  # of sequences by length: that which ends earliest
    before = np.empty(n, np.int64)
    length = 0
    for i in range(n):
        low, high = 0, length
        while low < high:
            middle = (low + high) // 2
            if t[last[middle]] <= t[i]:
                low = middle + 1
            else:
                high = middle
        before[i] = last[low - 1] if low else -1
        last[low] = i
        length = max(length, low + 1)
    keep = np.zeros(n, np.bool_)
    i = last[length - 1]
    while i >= 0:
        keep[i] = True
        i = before[i]
    return keep
