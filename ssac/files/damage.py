"""Files that cannot be read; event files that are damaged, unsorted, or in another unit of time.

Each exception of a library becomes an SsacError that names the file. An event file with signs of
damage is refused; if the caller allows damage, it is read as far as possible, with a warning.
Events that are out of order by less than 1 ms, as some cameras' drivers write them, are no damage:
they are sorted if the caller asks for it.
"""

import os
import warnings
from codecs import BOM_UTF16_BE, BOM_UTF16_LE
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from threading import RLock
from typing import Any

import numba
import numpy as np

from ssac.arrays import Events, IntArray, Mask, Pixels
from ssac.errors import SsacError
from ssac.events import LONGEST_GAP_US, US_PER_S, EventFile, SizePx, check_events

REPEATED = 32
"""Fewest equal words or events in a row that no sensor writes: a block was overwritten."""

# A moving object gives thousands of events a second, for minutes. A lower rate over more than
# LONGEST_S, or over 1000 events within _SHORTEST_S, suggest times in another unit.
_LEAST_HZ, LONGEST_S, _SHORTEST_S = 1000.0, 1000.0, 0.1

_OURS = (SsacError, KeyboardInterrupt, SystemExit, GeneratorExit)


def check_is_file(path: Path) -> None:
    """Raise SsacError when there is no such file."""
    if not path.is_file():
        raise SsacError(f"{path}: there is no such file: check the path")


@contextmanager
def readable(path: Path, kind: str, remedy: str = "copy or record it again") -> Iterator[None]:
    """Turn whatever a library raises in the block, even a panic, into one SsacError.

    `kind` says what the file should be, as in "a readable HDF5 file".
    """
    try:
        yield
    except _OURS:
        raise
    except BaseException as error:
        raise SsacError(f"{path}: not {kind} ({brief(error)}): {remedy}") from error


def brief(error: BaseException) -> str:
    """Return an exception's message on one line, cut to 200 characters."""
    if isinstance(error, MemoryError):  # of a library that believes a size it reads
        return "a size in it is larger than the memory here"
    words = " ".join(str(error).split()) or type(error).__name__
    return words if len(words) <= 200 else f"{words[:200]}..."


_SILENCE = RLock()  # stderr is the whole process's: another thread would restore the silence


@contextmanager
def silenced() -> Iterator[None]:
    """Discard what compiled code writes to stderr in the block, as a panic prints its own lines."""
    with _SILENCE:
        try:
            kept = os.dup(2)
        except OSError:  # there is no stderr
            yield
            return
        try:
            with suppress(OSError), open(os.devnull, "wb") as nowhere:
                os.dup2(nowhere.fileno(), 2)
            yield
        finally:
            os.dup2(kept, 2)
            os.close(kept)


def check_text(path: Path) -> None:
    """Raise SsacError if a file has a zero byte, which a text reader takes for the file's end."""
    with readable(path, "a readable file"), path.open("rb") as file:
        while block := file.read(1 << 22):
            if file.tell() == len(block) and block.startswith((BOM_UTF16_LE, BOM_UTF16_BE)):
                raise SsacError(f"{path}: its text is UTF-16: save it as UTF-8")
            at = block.find(b"\0")
            if at >= 0:
                raise SsacError(
                    f"{path}: not a text file: byte {file.tell() - len(block) + at} is zero, as "
                    "where a disk was full or a copy broke off: copy or record it again"
                )


def is_number(word: str) -> bool:
    """Return whether `float` can parse a word."""
    try:
        float(word)
    except ValueError:
        return False
    return True


def side_px(value: Any, said: str, path: Path) -> int:
    """Return a sensor's width or height [px] that a file states; SsacError, with `said`, if bad."""
    most = (1 << 16) - 1  # largest value of an event's field x or y
    try:
        number = np.asarray(value).astype(np.float64).item()  # of an array of one number too
        side = int(number) if number.is_integer() else 0
    except (TypeError, ValueError, OverflowError):
        side = 0
    if not 1 <= side <= most:
        raise SsacError(
            f"{path}: {said} 1 to {most} px, got {str(value)[:40]!r}: correct it, or leave it out"
        )
    return side


@dataclass(frozen=True)
class Reading:
    """How an event file that is damaged or out of order may be read."""

    allow_damaged: bool = False  # read the undamaged part, and warn
    sort: bool = False  # sort events that are out of order by less than 1 ms


STRICT = Reading()


def refuse_damaged(path: Path, signs: Sequence[str], reading: Reading) -> bool:
    """Raise SsacError if there are signs of damage; only warn if `reading` allows damage.

    Return whether there are any.
    """
    if not signs:
        return False
    found = "; ".join(signs)
    if not reading.allow_damaged:
        raise SsacError(
            f"{path}: is damaged: {found}: copy or record it again, or read what is left of it "
            "with --allow-damaged"
        )
    warnings.warn(f"{path} is damaged, and what is left of it is read: {found}", stacklevel=3)
    return True


def count_repeated(is_same: Mask) -> int:
    """Count the items in runs of at least `REPEATED`; is_same (n - 1,): equal to the one before."""
    if not is_same.any():
        return 0
    runs = np.diff(np.flatnonzero(~is_same), prepend=-1, append=len(is_same))
    return int(runs[runs >= REPEATED].sum())


def checked_file(
    events: Events,
    size_px: SizePx,
    path: Path,
    reading: Reading,
    unit: str = "",
    is_text: bool = False,
) -> EventFile:
    """Return a file's events, checked, and sorted or freed of damage as `reading` allows.

    SsacError for signs of damage that are not allowed, and if there are no events. Repeated events
    are no sign of damage in text, whose times may be rounded. Where the file's times must be in a
    `unit`, times that seem to be in another one give a warning.
    """
    events = within(_in_order(events, path, reading, is_text), size_px, str(path), reading)
    check_events(events, *size_px, name=str(path))
    if unit:
        note_unit(events, str(path), unit)
    return EventFile(events, *size_px)


def within(events: Events, size_px: SizePx, name: str, reading: Reading) -> Events:
    """Leave out, with a warning, events outside the sensor, if `reading` allows damage."""
    if not reading.allow_damaged:
        return events
    is_inside = events["p"] <= 1
    for field, size in zip("xy", size_px, strict=True):
        is_inside &= events[field] < (1 << 16 if size is None else size)
    n_lost = len(events) - np.count_nonzero(is_inside)
    if not n_lost:
        return events
    warnings.warn(
        f"{name}: {n_lost} of {len(events)} events lie outside the sensor, or have no polarity,"
        " and are left out",
        stacklevel=4,
    )
    return events[is_inside]


@numba.njit(cache=True)
def _disorder(t: IntArray, x: Pixels, y: Pixels) -> tuple[int, int, int, int]:
    """Count steps back in time, the furthest [us], leaps ahead, and events that are repeated."""
    n_back = most_back_us = n_leaps = n_repeated = 0
    latest_us, n_same = t[:1].sum(), 1
    for i in range(1, len(t)):
        step_us = t[i] - t[i - 1]
        if t[i] < t[i - 1]:
            n_back += 1
            most_back_us = max(most_back_us, latest_us - t[i])
        elif step_us > LONGEST_GAP_US or step_us < 0:  # < 0 on overflow of 64 bits
            n_leaps += 1
        latest_us = max(latest_us, t[i])
        n_same = n_same + 1 if step_us == 0 and x[i] == x[i - 1] and y[i] == y[i - 1] else 1
        if n_same >= REPEATED:
            n_repeated += REPEATED if n_same == REPEATED else 1
    return n_back, most_back_us, n_leaps, n_repeated


def _in_order(events: Events, path: Path, reading: Reading, is_text: bool) -> Events:
    """Sort or cut events whose times run back or leap; look for repeated events."""
    t = events["t"]
    n_back, most_back_us, n_leaps, n_repeated = _disorder(t, events["x"], events["y"])
    if n_back and most_back_us < 1000:  # the disorder that drivers cause
        late = f"{n_back} of {len(events)}", f"up to {most_back_us} us too late"
        if not reading.sort:
            raise SsacError(
                f"{path}: events must be sorted by time, but {late[0]} come {late[1]}: sort them "
                "with --sort"
            )
        warnings.warn(f"{path}: {late[0]} events came {late[1]} and were sorted", stacklevel=3)
        events, n_back = events[np.argsort(t, kind="stable")], 0
        t = events["t"]
    elif n_back and not reading.allow_damaged:
        return events  # `check_events` refuses them
    signs: list[str] = []
    if n_leaps:
        signs.append(f"{n_leaps} leaps of time by more than {LONGEST_GAP_US / US_PER_S:g} s")
    if n_repeated and not is_text:
        signs.append(f"{n_repeated} events stand there {REPEATED} times in a row or more")
    if reading.allow_damaged and (n_back or n_leaps):
        steps_us, n_events = np.diff(t), len(events)
        is_cut = (steps_us > LONGEST_GAP_US) | (steps_us < (-999 if reading.sort else 0))
        events = max(np.split(events, np.flatnonzero(is_cut) + 1), key=len)
        events = events[np.argsort(events["t"], kind="stable")]
        lost = n_events - len(events)
        signs.append(
            f"time runs back or leaps: {lost} of {n_events} events "
            f"({100.0 * lost / n_events:.3g} %) are left out"
        )
    refuse_damaged(path, signs, reading)
    return events


def note_unit(events: Events, name: str, unit: str) -> None:
    """Warn where times, taken to be in `unit`, look as if they were in another one."""
    n, said = len(events), ""
    span_s = float(np.ptp(events["t"])) / US_PER_S if n else 0.0
    if span_s > LONGEST_S and n < _LEAST_HZ * span_s:
        finer = {"seconds": "milliseconds", "microseconds": "nanoseconds"}[unit]
        said = f"{finer}, divide it by 1000"
    elif unit == "microseconds" and span_s < _SHORTEST_S and n > _LEAST_HZ:
        said = "milliseconds, multiply it by 1000"
    if said:
        warnings.warn(
            f"{name}: t must be in {unit}, by which its {n} events last {span_s:.6g} s: if it is in"
            f" {said}",
            stacklevel=5,
        )
