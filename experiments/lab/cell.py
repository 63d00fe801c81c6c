"""What a study measures: its cells, and the measure that makes a row of each.

A cell is one run of anything: a method on a flight, a variant, a comparison. One cell gives one
row; a cell that cannot be measured gives a row with a status and a reason.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from typing import Any

from sim.recording import SimConfig

CRASHED = "crashed"
"""Status of a run that could not be simulated, or whose measure raised what is not an SsacError."""

UNUSABLE = "unusable"
"""Status of a run on data that the method refuses with an SsacError."""

Flight = tuple[SimConfig, int]
"""What `simulate` takes: a configuration and a seed."""

Rows = list[dict[str, Any]]


@dataclass(frozen=True)
class PlainCell:
    """One run on no recording: its fields are its inputs, words and numbers its columns too."""

    @property
    def recordings(self) -> tuple[Flight, ...]:
        """Flights that it is measured on: cells of the same ones share a task."""
        return ()

    @property
    def own(self) -> dict[str, Any]:
        """Fields by name, but for those that say which flight it is."""
        return {one.name: getattr(self, one.name) for one in fields(self)}

    @property
    def columns(self) -> dict[str, Any]:
        """Columns of its row in the runs' file that say which run it is."""
        return {name: v for name, v in self.own.items() if isinstance(v, str | int | float)}

    @property
    def inputs(self) -> Any:
        """Everything beside recordings and code that its row depends on (`cache.content`)."""
        return tuple(self.own.values())


@dataclass(frozen=True)
class FlightCell(PlainCell):
    """One run on one flight; what a study adds to say which, it adds as fields."""

    sim: SimConfig
    flight: int  # its number among those of its duration and angle
    seed: int  # as of `grid.flight_seed`

    @property
    def recordings(self) -> tuple[Flight, ...]:
        """The one flight."""
        return ((self.sim, self.seed),)

    @property
    def own(self) -> dict[str, Any]:
        """Fields by name, but for those of the flight."""
        return {one.name: getattr(self, one.name) for one in fields(self)[3:]}

    @property
    def flown(self) -> dict[str, Any]:
        """Columns that say which flight it is."""
        return {
            "duration_s": self.sim.spline.duration_s, "angle_deg": self.sim.angle_deg,
            "flight": self.flight, "seed": self.seed,
        }  # fmt: skip

    @property
    def columns(self) -> dict[str, Any]:
        """Columns that say which run it is: those of the flight first."""
        return {**self.flown, **super().columns}

    @property
    def inputs(self) -> Any:
        """What its row depends on beside recording and code; offsets are added to recordings."""
        return self.sim.t_d_s, *super().inputs


@dataclass(frozen=True)
class RunRow:
    """How a run ended; what was measured are more fields, with defaults for where it was not."""

    status: str
    reason: str = ""


def load_nothing(cells: Sequence[Any], cache: Any) -> Any:
    """Give the cache to cells that share nothing else: a `load` of a measure."""
    del cells
    return cache


@dataclass(frozen=True)
class Measure:
    """How the cells of one task become rows: functions of modules, which other processes find."""

    load: Callable[[Sequence[Any], Any], Any]  # cells of a task, and the cache -> what they share
    row: Callable[[Any, Any], Any]  # a cell and what was loaded -> a `row_type`
    row_type: type  # a dataclass: status, reason, then fields with defaults
