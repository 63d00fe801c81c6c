"""One line of the benchmark, and how its time and memory are taken.

Little is imported here: `ssac simulate` is measured in a process that loads what that command does.
"""

import resource
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

Result = TypeVar("Result")


@dataclass(frozen=True)
class Measurement:
    """A figure, what it is held against, and the mark to reach."""

    name: str
    value: float
    unit: str
    mark: float | None = None  # of the value; None: for information
    higher_is_better: bool = False

    @property
    def verdict(self) -> str:
        """Return "meets", "misses", or nothing where there is no mark."""
        if self.mark is None:
            return ""
        met = self.value >= self.mark if self.higher_is_better else self.value <= self.mark
        return "meets" if met else "misses"


def best_rate(work: Callable[[], int], repeats: int) -> float:
    """Return how much work is done per second of processor time, at best, after a warm-up."""
    work()
    rates = []
    for _ in range(repeats):
        start = time.process_time()
        done = work()
        rates.append(done / (time.process_time() - start))
    return max(rates)


def best_seconds(work: Callable[[], Result], repeats: int) -> tuple[float, Result]:
    """Least processor time [s] of a few runs after a warm-up, and the result."""
    result = work()
    seconds = []
    for _ in range(repeats):
        start = time.process_time()
        result = work()
        seconds.append(time.process_time() - start)
    return min(seconds), result


def peak_memory_mb() -> float:
    """Return the most memory that this process has had."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
