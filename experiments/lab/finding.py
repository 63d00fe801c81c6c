"""What was checked and what is wrong with it in, lines for the terminal out."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import zip_longest

from sim.errors import SimError
from ssac.errors import SsacError

_SHOWN = 5  # faults of one kind

_UNLIKE = (
    OSError,
    SimError,
    SsacError,
    ValueError,
    KeyError,
    IndexError,
    TypeError,
    AttributeError,
)
"""What a check raises where a file is not there, or has another shape than it expects."""


@dataclass(frozen=True)
class Finding:
    """One thing that was checked."""

    what: str
    faults: tuple[str, ...] = ()  # none: all right

    def lines(self) -> Iterator[str]:
        """Show it: one line, and one more for each of the first faults."""
        yield f"{'differs' if self.faults else 'ok':8}{self.what}"
        yield from (f"        - {fault}" for fault in self.faults[:_SHOWN])
        if len(self.faults) > _SHOWN:
            yield f"        - and {len(self.faults) - _SHOWN} more"


def found(what: str, check: Callable[[], tuple[str, ...]]) -> Finding:
    """Make a check; a file that is missing, or not what it should be, is a fault."""
    try:
        return Finding(what, check())
    except _UNLIKE as error:
        return Finding(what, (f"{type(error).__name__}: {' '.join(str(error).split())}",))


def text_difference(committed: str, made: str) -> tuple[str, ...]:
    """Say where two texts first differ."""
    pairs = zip_longest(committed.splitlines(), made.splitlines(), fillvalue="nothing")
    for number, (old, new) in enumerate(pairs, start=1):
        if old != new:
            return (f"line {number} is {_short(old)}", f"line {number} should be {_short(new)}")
    return () if committed == made else ("the ends of lines are not the same",)


def _short(line: str) -> str:
    return line if len(line) <= 160 else f"{line[:157]}..."
