"""A process in; the memory that it frees kept for what it allocates next."""

import ctypes
from contextlib import suppress

LARGEST_BYTES = 1 << 25
"""Of what is kept: the most that glibc allows. A camera's events of 20 s are half of it."""

_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3  # parameters of glibc's mallopt
_MOST_KEPT_BYTES = 1 << 30


def keep_freed_memory() -> None:
    """Let arrays take the memory of those before them, where the C library is glibc.

    By default each array of some megabytes is given back to the kernel when it goes, and the next
    one's pages are zeroed anew as they are touched: a fifteenth of the time of cached tables. What
    a process needs at most stays the same.
    """
    with suppress(OSError, AttributeError):  # other C libraries do not have it
        mallopt = ctypes.CDLL(None).mallopt
        mallopt(_MMAP_THRESHOLD, LARGEST_BYTES)
        mallopt(_TRIM_THRESHOLD, _MOST_KEPT_BYTES)
