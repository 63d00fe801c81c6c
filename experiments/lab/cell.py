"""The cells of a study, which are its single runs, and the measure that turns each into a row.

A cell is any one run: of a method on a flight, of a variant, of a comparison. One cell gives one
row; a cell that cannot be measured gives a row with a status and a reason.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from typing import Any

from sim.recording import SimConfig
from ssac.pipeline.registry import METHODS

CRASHED = "crashed"  # status of a run whose simulation or measure raised no SsacError but another
UNUSABLE = "unusable"  # status of a run on data that the method refuses with an SsacError

Flight = tuple[SimConfig, int]  # the arguments of `simulate`: a configuration and a seed
Rows = list[dict[str, Any]]


@dataclass(frozen=True)
class PlainCell:
    """A run without a recording: its fields are its inputs, and texts and numbers are columns."""

    @property
    def recordings(self) -> tuple[Flight, ...]:
        """Flights that the cell is measured on; cells with the same flights share a task."""
        return ()

    @property
    def own(self) -> dict[str, Any]:
        """Fields by name, without those that identify the flight."""
        return {one.name: getattr(self, one.name) for one in fields(self)}

    @property
    def columns(self) -> dict[str, Any]:
        """Columns that identify the run in its row of the runs' file."""
        return {name: v for name, v in self.own.items() if isinstance(v, str | int | float)}

    @property
    def inputs(self) -> Any:
        """All that the row depends on besides recordings and code, for `cache.content`."""
        method = METHODS.get(getattr(self, "method", ""))
        return *self.own.values(), method.version if method else None


@dataclass(frozen=True)
class FlightCell(PlainCell):
    """One run on one flight; a study adds the fields that tell its runs apart."""

    sim: SimConfig
    flight: int  # number among the flights of its duration and angle
    seed: int  # from `grid.flight_seed`

    @property
    def recordings(self) -> tuple[Flight, ...]:
        """The one flight."""
        return ((self.sim, self.seed),)

    @property
    def own(self) -> dict[str, Any]:
        """Fields by name, without those of the flight."""
        return {one.name: getattr(self, one.name) for one in fields(self)[3:]}

    @property
    def flown(self) -> dict[str, Any]:
        """Columns that identify the flight."""
        return {
            "duration_s": self.sim.spline.duration_s, "angle_deg": self.sim.angle_deg,
            "flight": self.flight, "seed": self.seed,
        }  # fmt: skip

    @property
    def columns(self) -> dict[str, Any]:
        """Columns that identify the run, those of the flight first."""
        return {**self.flown, **super().columns}

    @property
    def inputs(self) -> Any:
        """All that the row depends on besides code and recording; no recording holds the offset."""
        return self.sim.t_d_s, *super().inputs


@dataclass(frozen=True)
class RunRow:
    """How a run ended; subclasses add the measured values, with defaults where there are none."""

    status: str
    reason: str = ""


def load_nothing(cells: Sequence[Any], cache: Any) -> Any:
    """Return the cache: the `load` of a measure whose cells share nothing else."""
    del cells
    return cache


@dataclass(frozen=True)
class Measure:
    """How the cells of one task become rows; module-level functions, which workers can import."""

    load: Callable[[Sequence[Any], Any], Any]  # cells of a task, and the cache -> what they share
    row: Callable[[Any, Any], Any]  # a cell and what was loaded -> a `row_type`
    row_type: type  # a dataclass: status, reason, then fields with defaults
