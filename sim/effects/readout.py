"""Events as pixels raise them in, events as the readout delivers them out."""

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray


def without_gaps(
    events: NDArray[Any], starts_us: NDArray[np.float64], gap_us: float
) -> NDArray[Any]:
    """Lose the events during gaps.

    Parameters
    ----------
    events
        EVENT_DTYPE, sorted by time.
    starts_us
        When each gap begins, shape (n,) [us], increasing.
    gap_us
        How long each lasts; less than from one to the next.
    """
    if not len(starts_us):
        return events
    gap = np.searchsorted(starts_us, events["t"], side="right") - 1
    is_lost = (gap >= 0) & (events["t"] < starts_us[gap] + gap_us)
    return events[~is_lost]


def queued(events: NDArray[Any], readout_hz: float, queue: int) -> NDArray[Any]:
    """Read events out one at a time, first come, first served; each is stamped when its turn comes.

    Parameters
    ----------
    events
        EVENT_DTYPE, sorted by time.
    readout_hz
        Events that are read out per second.
    queue
        How many wait at most, beside the one that is read out; one that finds as many is lost.
    """
    stamps_us, is_read = _serve(events["t"], 1e6 / readout_hz, queue)
    delivered: NDArray[Any] = events[is_read]
    delivered["t"] = stamps_us[is_read]
    return delivered


@njit(cache=True, nogil=True)
def _serve(t_us, service_us, queue):  # type: ignore[no-untyped-def]
    stamps_us = np.empty(t_us.size, np.int64)
    is_read = np.zeros(t_us.size, np.bool_)
    free_us = -np.inf  # when all that waits has been read out
    for i in range(t_us.size):
        wait_us = free_us - t_us[i]
        if wait_us > (queue + 1e-6) * service_us:
            continue
        stamp_us = max(free_us, np.float64(t_us[i]))
        stamps_us[i], is_read[i] = np.int64(np.floor(stamp_us + 1e-6)), True
        free_us = stamp_us + service_us
    return stamps_us, is_read
