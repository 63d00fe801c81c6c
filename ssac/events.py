"""The event array: one structured dtype, its checks, and slices of it by time."""

from bisect import bisect_left
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numba
import numpy as np
from numpy.typing import ArrayLike, NDArray

from ssac.arrays import Array, Events, Indices, IntArray
from ssac.errors import SsacError

EVENT_DTYPE = np.dtype([("t", "<i8"), ("x", "<u2"), ("y", "<u2"), ("p", "u1")])
"""One event: `t` [us], pixel column `x`, pixel row `y`, polarity `p` (1 = brighter)."""

US_PER_S = 1_000_000
LONGEST_GAP_US = 3600 * US_PER_S  # longest pause between two events of a recording
WRAP_S = 2**24 * 1e-6  # after which a 24-bit counter of microseconds wraps around
QUANTA_S = (0.010, 0.001)  # steps to which some recorders round times

SizePx = tuple[int | None, int | None]
"""A sensor's width and height [px]; None where it is not known."""


@dataclass(frozen=True)
class EventFile:
    """What an event file holds: the events and, where the file says so, the sensor's size."""

    events: Events  # EVENT_DTYPE, shape (N,), sorted by t
    width: int | None  # [px]
    height: int | None  # [px]


def events_from_arrays(
    t: ArrayLike, x: ArrayLike, y: ArrayLike, p: ArrayLike, name: str = "events"
) -> Events:
    """Build the event array from whole times [us], pixel columns, rows and polarities (N,).

    The polarity of a darker event may be 0 or -1. SsacError, led by `name`, if the lengths differ
    or a value does not fit its field; `check_events` checks the rest.
    """
    columns = {field: np.asarray(one) for field, one in zip("txyp", (t, x, y, p), strict=True)}
    check_lengths({field: column.shape for field, column in columns.items()}, name)
    events = np.empty(len(columns["t"]), dtype=EVENT_DTYPE)
    for field, column in columns.items():
        events[field] = field_values(field, column, name)
    return events


def events_of_array(array: NDArray[Any], name: str = "events") -> Events:
    """Convert a structured array, with fields t [us], x, y, p of any order and width, to events."""
    if array.dtype == EVENT_DTYPE:
        return array
    missing = [field for field in EVENT_DTYPE.names or () if field not in (array.dtype.names or ())]
    if missing:
        raise SsacError(
            f"{name}: expected a structured array with the fields t [us], x, y and p, got"
            f" {array.dtype}, without {', '.join(missing)}: build it with"
            " ssac.events.events_from_arrays"
        )
    return events_from_arrays(array["t"], array["x"], array["y"], array["p"], name)


def check_lengths(shapes: Mapping[str, tuple[int, ...]], name: str) -> None:
    """Raise SsacError, starting with `name`, unless the shapes are 1-D and of one length."""
    if len(set(shapes.values())) != 1 or len(shapes["t"]) != 1:
        raise SsacError(
            f"{name}: t, x, y and p must be of one length, got the shapes {dict(shapes)}: "
            "the file is incomplete, record or convert it again"
        )


def field_values(field: str, column: NDArray[Any], name: str) -> NDArray[Any]:
    """Values (N,) of a field t, x, y or p, -1 being 0; SsacError where one does not fit."""
    if column.dtype.kind not in "iub":
        raise SsacError(
            f"{name}: {field} must hold whole numbers (t in microseconds), got values of type "
            f"{column.dtype}: convert the file"
        )
    if field == "p" and column.dtype.kind == "i":
        column = np.where(column == -1, 0, column)
    target = EVENT_DTYPE[field]
    if not np.can_cast(column.dtype, target) and len(column):
        low, high = int(column.min()), int(column.max())
        if low < np.iinfo(target).min or high > np.iinfo(target).max:
            raise SsacError(
                f"{name}: {field} must lie in {np.iinfo(target).min} to {np.iinfo(target).max}, "
                f"got {low} to {high}: the file is damaged or is read in the wrong layout"
            )
    return column


def check_event_array(events: Any, name: str) -> None:
    """Raise SsacError, starting with `name`, unless this is a 1-D array of EVENT_DTYPE."""
    is_array = isinstance(events, np.ndarray)
    if not is_array or events.ndim != 1 or events.dtype != EVENT_DTYPE:
        what = f"{events.ndim}-D {events.dtype}" if is_array else type(events).__name__
        raise SsacError(
            f"{name}: events must be a 1-D array of {EVENT_DTYPE.descr}, got {what}: build it with"
            " ssac.events.events_from_arrays"
        )


def check_events(events: Events, width: int | None, height: int | None, name: str) -> None:
    """Raise SsacError unless events are there, sorted, within the sensor, of p 0 or 1."""
    check_event_array(events, name)
    if len(events) == 0:
        raise SsacError(f"{name}: there are no events: record again, or check the right file")
    t = events["t"]
    is_back = t[1:] < t[:-1]
    if is_back.any():
        i = int(np.argmax(is_back)) + 1
        if wrapped(t[i - 1] / US_PER_S, t[i] / US_PER_S):
            raise SsacError(f"{name}: {wrap_message(f'event {i}')}")
        raise SsacError(
            f"{name}: events must be sorted by time, but event {i} is at {t[i]} us, after one at "
            f"{t[i - 1]} us: copy or record it again if it is damaged, and sort it if it is not"
        )
    if t[-1] - t[0] > LONGEST_GAP_US and (steps_us := np.diff(t)).max() > LONGEST_GAP_US:
        i = int(np.argmax(steps_us)) + 1
        raise SsacError(
            f"{name}: the clock leaps by {steps_us[i - 1] / US_PER_S:.0f} s at event {i}: cut the"
            " recording there"
        )
    for field, size in (("x", width), ("y", height)):
        if size is not None and (most := events[field].max()) >= size:
            raise SsacError(
                f"{name}: the sensor is {width} x {height} px, but there is an event at {field} = "
                f"{most}: give the size of the camera that recorded the events"
            )
    if (most := events["p"].max()) > 1:
        raise SsacError(f"{name}: polarity must be 0 or 1, got {most}: convert the file")


def copied(events: Events) -> Events:
    """Copy events (n,) as whole records: four times as fast as NumPy, which copies fields."""
    whole = np.dtype((np.void, events.dtype.itemsize))
    return events.view(whole).copy().view(events.dtype)


@numba.njit(cache=True)
def first_from(times_us: IntArray, bounds_us: NDArray[Any]) -> Indices:
    """Index (m,) of the first time (n,) [us] at or after each bound (m,), without copies."""
    return np.searchsorted(times_us, bounds_us)


def no_gaps() -> IntArray:
    """Return the gaps (0, 2) [us] of a recording from which nothing was removed."""
    return np.empty((0, 2), np.int64)


def wrapped(earlier_s: float, later_s: float) -> bool:
    """Whether a clock goes back between two times as a 24-bit counter that wraps around does."""
    return 0.5 * WRAP_S < earlier_s - later_s <= WRAP_S


def wrap_message(place: str) -> str:
    """Say what to do about a counter that wraps around."""
    return (
        f"the clock begins anew at {place}, as a counter of 24 bits does every {WRAP_S:.3f} s: add "
        f"{2**24} us to all times from there on, and so at each further one; do not sort"
    )


def is_whole(values: Array, rounding: Array | float = 1e-6) -> bool:
    """Whether all values (n,) are whole numbers, but for rounding."""
    return bool(np.all(np.abs(values - np.rint(values)) < rounding))


def time_quantum_s(times_s: Array) -> float:
    """Step [s] of QUANTA_S to which times (n,) were rounded; 0 if they are finer."""
    enough = 20  # times: as many lie on a grid by more than chance
    last_digits_s = 8.0 * np.spacing(np.abs(times_s))  # large after days, and far below any step

    def is_on_grid(step_s: float, n: int) -> bool:
        return is_whole(times_s[:n] / step_s, np.clip(last_digits_s[:n] / step_s, 1e-6, 0.05))

    if len(times_s) < enough or not is_on_grid(QUANTA_S[-1], enough):
        return 0.0
    quantum_s = next((step_s for step_s in QUANTA_S if is_on_grid(step_s, len(times_s))), 0.0)
    gaps_s = np.diff(times_s)
    least_s = float(np.min(gaps_s))
    if least_s <= 0.0:
        return quantum_s
    steps = gaps_s / least_s
    rounding = max(1e-6, float(last_digits_s[-1]) / least_s)
    is_cut = least_s < 1.5 * quantum_s and _alternate(np.rint(steps))
    return quantum_s if is_cut or not is_whole(steps, rounding * steps) else 0.0


def _alternate(steps: Array) -> bool:
    """Whether gaps (n,) [steps] of one and two alternate, as those of 50 to 100 fps cut to 10 ms.

    Such gaps alternate so evenly that ten last alike to a step. Where frames are lost by chance,
    the variance of the sum of ten is ten times that of one.
    """
    gaps = np.minimum(steps, 3.0)  # two and a lost frame: longer pauses would outweigh all others
    several = 10
    sums = np.convolve(gaps, np.ones(several), "valid")
    is_steady = np.var(sums) < 0.5 * several * np.var(gaps)  # half of what chance gives
    some = 0.1  # share of long gaps: below it (over 91 fps) a few lost frames would look steady too
    return bool(is_steady and np.mean(gaps > 1.0) > some)


def rounding_variance_s2(*quanta_s: float) -> float:
    """Variance [s^2] of an offset between clocks whose times were rounded to steps.

    Times truncated to a step of q are off by q / 2 on average, rounded ones are not: +-1.96
    deviations of a uniform distribution of width q cover both.
    """
    return sum(step_s**2 for step_s in quanta_s) / 12.0


def slice_time(events: Events, start_us: int, end_us: int) -> Events:
    """View of sorted events with start_us <= t < end_us, found by bisection; may be empty."""
    t = events["t"]
    first = bisect_left(t, start_us)
    return events[first : bisect_left(t, end_us, lo=first)]
