"""Jobs in, what became of each out as it ends: what a crew is, and the smallest one."""

from collections.abc import Callable
from types import TracebackType
from typing import Any, NamedTuple, Protocol

Job = Callable[[], Any]
"""With what it returns, something that pickle takes: a `functools.partial` of a function."""


class DiedError(Exception):
    """The worker of a job ended in the middle of it."""


class Ended(NamedTuple):
    """What became of a job."""

    number: int  # as it was given
    value: Any  # that it returned
    error: Exception | None = None  # that it raised, or a DiedError


class Crew(Protocol):
    """Workers; when its block is left, none of them is on a job."""

    def has_room(self) -> bool:
        """Whether it takes a job now."""

    def give(self, number: int, job: Job) -> None:
        """Have a job done."""

    def ended(self, timeout_s: float | None) -> list[Ended]:
        """Wait until jobs have ended, one or more, or for some seconds; None: for ever."""

    def __enter__(self) -> "Crew":
        """Begin."""

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """End what is still being done."""


class Alone:
    """The crew of this process: a job that takes it down takes everything down."""

    def __init__(self) -> None:
        self._job: tuple[int, Job] | None = None

    def has_room(self) -> bool:
        """Whether there is no job."""
        return self._job is None

    def give(self, number: int, job: Job) -> None:
        """Take a job."""
        self._job = number, job

    def ended(self, timeout_s: float | None) -> list[Ended]:
        """Do it now, however long it takes."""
        del timeout_s
        if self._job is None:
            return []
        (number, job), self._job = self._job, None
        return [done(number, job)]

    def __enter__(self) -> "Alone":
        return self

    def __exit__(self, *_: object) -> None:
        self._job = None


def done(number: int, job: Job) -> Ended:
    """Do a job here."""
    try:
        return Ended(number, job())
    except Exception as error:
        return Ended(number, None, error)
