"""The progress of long work: a bar on stderr, or lines where stderr is no terminal."""

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from tqdm import tqdm

EVERY_S = 30.0
"""Time after which the next line is due; it is printed when the next item of work is done."""

Advance = Callable[[int], object]
"""A function that takes the number of items done so far."""


@contextmanager
def progress(
    total: int, label: str, is_brief: bool = False, is_shown: bool = True
) -> Iterator[Advance]:
    """Show the progress of some work; yield the function to call with the number of items done.

    Nothing is shown if `total` is 0 or `is_shown` is False. For brief work, which mostly takes
    seconds, the bar appears after half a second, or the first line after `EVERY_S`.
    """
    if not (total and is_shown):
        yield lambda n_done: None
    elif not sys.stderr.isatty():
        yield _lines(total, label, is_brief)
    else:
        style, delay_s = ("{l_bar}{bar}| {remaining} left", 0.5) if is_brief else (None, 0.0)
        with tqdm(total=total, desc=label, bar_format=style, delay=delay_s) as bar:
            yield lambda n_done: bar.update(n_done - bar.n)


def _lines(total: int, label: str, is_brief: bool) -> Advance:
    """Print a line at each tenth of the work, and when the last line is `EVERY_S` old."""
    says_tenths, n_tenths = not is_brief, 0
    begun_s = said_s = time.monotonic()

    def advance(n_done: int) -> None:
        nonlocal says_tenths, n_tenths, said_s
        now_s, tenths = time.monotonic(), 10 * n_done // total
        if now_s - said_s < EVERY_S and not (says_tenths and tenths > n_tenths):
            return
        says_tenths, n_tenths, said_s = True, tenths, now_s
        taken_s = now_s - begun_s
        line = f"{label}: {n_done} of {total} done after {tqdm.format_interval(taken_s)}"
        if 0 < n_done < total:
            line += f", {tqdm.format_interval(taken_s / n_done * (total - n_done))} left"
        say(line)

    return advance


@contextmanager
def compilation_told() -> Iterator[None]:
    """Say once if the block compiles kernels, which makes an installation's first run slower."""
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
    """Print a line on stderr, above the bar if there is one."""
    tqdm.write(line, file=sys.stderr)
