"""Events in the order in which pixels are followed in, the same in order of time out."""

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

EVENT_DTYPE = np.dtype([("t", "<i8"), ("x", "<u2"), ("y", "<u2"), ("p", "u1")])
"""One event: `t` [us], pixel column `x`, pixel row `y`, polarity `p` (1 = brighter)."""

Stamps = NDArray[np.float64]
Pixels = NDArray[np.uint16]
Signs = NDArray[np.uint8]


class EventBuffer:
    """Events as they are emitted, in columns that grow."""

    def __init__(self) -> None:
        self.t_s = np.empty(1 << 16, np.float64)
        self.x = np.empty(1 << 16, np.uint16)
        self.y = np.empty(1 << 16, np.uint16)
        self.p = np.empty(1 << 16, np.uint8)
        self.n = 0

    def follow(self, kernel: Any, *arguments: Any) -> None:
        """Let a kernel append its events."""
        self.t_s, self.x, self.y, self.p, self.n = kernel(
            *arguments, self.t_s, self.x, self.y, self.p, self.n
        )

    def take(self, before_us: float, width: int, height: int) -> NDArray[Any]:
        """Take out the events before a time [us], infinity for all, of an image of a size [px].

        Returns
        -------
        NDArray
            EVENT_DTYPE, sorted by time, then row, column and order of emission.
        """
        emitted, key = np.empty(self.n, EVENT_DTYPE), np.empty(self.n, np.int64)
        columns = (self.t_s, self.x, self.y, self.p, self.n)
        n_taken = _move_out(*columns, before_us, width, height, emitted, key)
        self.n -= n_taken
        in_order = np.empty(n_taken, EVENT_DTYPE)
        _gather(emitted, _stable_order(key[:n_taken]), in_order)
        return in_order


@njit(cache=True, nogil=True)
def grown(t_s: Stamps, x: Pixels, y: Pixels, p: Signs) -> tuple[Stamps, Pixels, Pixels, Signs]:
    """Twice the room for events."""
    n = t_s.size
    new_t, new_x = np.empty(2 * n, t_s.dtype), np.empty(2 * n, x.dtype)
    new_y, new_p = np.empty(2 * n, y.dtype), np.empty(2 * n, p.dtype)
    new_t[:n], new_x[:n], new_y[:n], new_p[:n] = t_s, x, y, p
    return new_t, new_x, new_y, new_p


@njit(cache=True, nogil=True)
def _move_out(
    t_s: Stamps,
    x: Pixels,
    y: Pixels,
    p: Signs,
    n: int,
    before_us: float,
    width: int,
    height: int,
    taken: NDArray[Any],
    key: NDArray[np.int64],
) -> int:
    """Move the events before a time from the columns to `taken`; those that stay keep their order.

    `key` takes what they are to be sorted by: one number for time, row and column is far quicker to
    sort by than two. Returns how many they are.
    """
    n_taken = 0
    for i in range(n):
        t_us = np.rint(t_s[i] * 1e6)
        if t_us < before_us:
            event = taken[n_taken]
            event.t, event.x, event.y, event.p = np.int64(t_us), x[i], y[i], p[i]
            key[n_taken] = (event.t * height + event.y) * width + event.x
            n_taken += 1
        else:
            stays = i - n_taken
            t_s[stays], x[stays], y[stays], p[stays] = t_s[i], x[i], y[i], p[i]
    return n_taken


def _stable_order(key: NDArray[np.int64]) -> NDArray[np.int64]:
    """Do what a stable `np.argsort` does, twice as fast where key and index fit one number."""
    bits = len(key).bit_length()
    if not len(key) or int(np.ptp(key)) >> (63 - bits):
        return np.argsort(key, kind="stable")
    return np.sort((key - key.min()) << bits | np.arange(len(key))) & ((1 << bits) - 1)


@njit(cache=True, nogil=True)
def _gather(events: NDArray[Any], order: NDArray[np.int64], gathered: NDArray[Any]) -> None:
    """Do what `events[order]` does, of records of 13 bytes far more quickly."""
    for i in range(order.size):
        gathered[i] = events[order[i]]
