"""How much of some work is done: a bar on stderr, or lines where that is no terminal."""

import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from tqdm import tqdm

EVERY_S = 30.0
"""Longest time between two lines, however long one thing takes."""

_LOOK_S = 1.0  # between two looks whether a line is due

_MINUTES = tqdm.format_interval

Advance = Callable[[int], object]
"""Takes how many are done by now."""


@contextmanager
def progress(
    total: int, label: str, is_brief: bool = False, is_shown: bool = True
) -> Iterator[Advance]:
    """Show how much of some work is done while the block runs, which calls what it is given.

    Nothing is shown where `total` is 0. Of brief work, which mostly takes seconds, the bar appears
    after half a second, and no line before `EVERY_S`.
    """
    if not (total and is_shown):
        yield lambda n_done: None
    elif not sys.stderr.isatty():
        lines = Lines(total, label, is_brief)
        with _repeated(lines.look):
            yield lines
    else:
        style, delay_s = ("{l_bar}{bar}| {remaining} left", 0.5) if is_brief else (None, 0.0)
        with tqdm(total=total, desc=label, bar_format=style, delay=delay_s) as bar:
            yield lambda n_done: bar.update(n_done - bar.n)


class Lines:
    """Says it in a line at each tenth that is done, and `EVERY_S` after the last line."""

    def __init__(
        self,
        total: int,
        label: str,
        is_brief: bool = False,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._total, self._label, self._clock = total, label, clock
        self._says_tenths = not is_brief
        self._n_done = self._n_tenths = 0
        self._begun_s = self._said_s = clock()

    def __call__(self, n_done: int) -> None:
        """Say that so many are done by now, if a line is due."""
        self._n_done = n_done
        now_s = self._clock()
        n_tenths = 10 * n_done // self._total
        is_late = now_s - self._said_s >= EVERY_S
        if not (is_late or (self._says_tenths and n_tenths > self._n_tenths)):
            return
        self._says_tenths, self._n_tenths, self._said_s = True, n_tenths, now_s
        taken_s = now_s - self._begun_s
        line = f"{self._label}: {n_done} of {self._total} done after {_MINUTES(taken_s)}"
        if 0 < n_done < self._total:
            line += f", {_MINUTES(taken_s / n_done * (self._total - n_done))} left"
        say(line)

    def look(self) -> None:
        """Say how many are done, if a line is due since none was added."""
        self(self._n_done)


@contextmanager
def _repeated(call: Callable[[], None]) -> Iterator[None]:
    """Call a function every `_LOOK_S`, in a thread, while the block runs."""
    is_over = threading.Event()

    def repeat() -> None:
        while not is_over.wait(_LOOK_S):
            call()

    thread = threading.Thread(target=repeat, daemon=True)
    thread.start()
    try:
        yield
    finally:
        is_over.set()
        thread.join()


@contextmanager
def compilation_told() -> Iterator[None]:
    """Say so, once, where the block compiles kernels: an installation's first run takes longer."""
    from numba.core.event import Event, Listener, install_listener

    class Teller(Listener):
        is_told = False

        def on_start(self, event: Event) -> None:
            if not self.is_told:
                say("compiling kernels for later runs too: this one takes a minute longer")
            self.is_told = True

        def on_end(self, event: Event) -> None:
            del event

    with install_listener("numba:compile", Teller()):
        yield


def say(line: str) -> None:
    """Say something else on stderr, above the bar where there is one."""
    tqdm.write(line, file=sys.stderr)
