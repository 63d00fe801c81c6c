"""One line of the benchmark."""

from dataclasses import dataclass


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
