"""How much of some work is done: a bar on stderr, or lines where that is no terminal."""

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from tqdm import tqdm

EVERY_S = 30.0
"""Time after which a line is due, at the next thing that is done."""

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
        yield _lines(total, label, is_brief)
    else:
        style, delay_s = ("{l_bar}{bar}| {remaining} left", 0.5) if is_brief else (None, 0.0)
        with tqdm(total=total, desc=label, bar_format=style, delay=delay_s) as bar:
            yield lambda n_done: bar.update(n_done - bar.n)


def _lines(total: int, label: str, is_brief: bool) -> Advance:
    """Say it in a line at each tenth that is done, and `EVERY_S` after the last line."""
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
