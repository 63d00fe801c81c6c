"""Flights that leave something open in, what each method says of them out.

A method may refuse, in whole or in part; what it must not do is to give a confident wrong answer.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from experiments.lab.cache import Cache
from experiments.lab.cell import FlightCell, Measure
from experiments.lab.recorded import Pair
from experiments.lab.score import score
from experiments.measures.refusal_flights import (
    RefusalCase,
    flight_of,
    refusal_case,
)
from ssac.estimate import Estimate
from ssac.pipeline.chain import Chain
from ssac.pipeline.registry import METHODS

MAX_SIGMAS = 5.0
"""A larger error, with status "ok", is a confident wrong answer."""

MAX_ERROR_MS, MAX_ERROR_DEG = 5.0, 5.0
"""The same for methods that state no deviation."""

OTHER_OBJECT = "other-object"
"""The kind of which camera 2 sees another flight."""

_LISTED_MS = 10.0  # a listed offset is the true one when it is as near


@dataclass(frozen=True)
class RefusalCell(FlightCell):
    """A method on a kind of recording that is made of a flight, whose path may be one of its own.

    Its configuration is that of `flight_config`.
    """

    kind: str  # of KINDS_OF_FLIGHT[of_flight]
    of_flight: str  # kind of the flight
    other_seed: int  # of the flight that only camera 2 sees, in the kind "other-object"
    method: str

    @property
    def columns(self) -> dict[str, Any]:
        """Columns that say which run it is."""
        return {"kind": self.kind, **self.flown, "method": self.method}

    @property
    def inputs(self) -> tuple[Any, ...]:
        """What the row depends on beside the recording."""
        return self.kind, self.of_flight, self.other_seed, self.method, METHODS[self.method].version


@dataclass(frozen=True)
class RefusalRow:
    """What was said, its errors, and whether it is a confident wrong answer."""

    status: str
    reason: str = ""
    offset_given: bool = False
    pose_given: bool = False
    alternatives: int = 0
    truth_among_offsets: bool = False
    t_d_error_ms: float = np.nan
    r_error_deg: float = np.nan
    t_error_deg: float = np.nan
    t_d_std_ms: float = np.nan
    r_std_deg: float = np.nan
    t_std_deg: float = np.nan
    error_sigmas: float = np.nan  # the largest of what is given
    confident_wrong: bool = False


@dataclass(frozen=True)
class FlownKinds:
    """A flight, and the kinds that were made of it so far."""

    flight: Pair
    other: Pair | None
    made: dict[str, tuple[RefusalCase, Chain]] = field(default_factory=dict)


def load_kinds(cells: Sequence[RefusalCell], cache: Cache) -> FlownKinds:
    """Load the flight, and the other one where a kind needs it."""
    first = cells[0]
    flight = flight_of(first.of_flight, first.sim, first.seed, cache)
    if all(cell.kind != OTHER_OBJECT for cell in cells):
        return FlownKinds(flight, None)
    return FlownKinds(flight, flight_of(first.of_flight, first.sim, first.other_seed, cache))


def refusal_row(cell: RefusalCell, flown: FlownKinds) -> RefusalRow:
    """Run one method on one kind, and judge what it says."""
    if cell.kind not in flown.made:
        case = refusal_case(cell.kind, flown.flight, flown.other)
        flown.made.clear()  # the cells of a kind follow each other
        flown.made[cell.kind] = case, Chain((case.cam1, case.cam2), case.rig, case.config)
    case, chain = flown.made[cell.kind]
    return judged(chain.estimate(cell.method), case)


REFUSALS = Measure(load_kinds, refusal_row, RefusalRow)


def judged(estimate: Estimate, case: RefusalCase) -> RefusalRow:
    """Judge what was said."""
    errors = score(estimate, case.t_d_s, case.R, case.t)
    t_d_std_ms = 1e3 * estimate.t_d_std_s
    gives_pose = not METHODS[estimate.method].needs_extrinsics and estimate.R is not None
    r_std_deg = estimate.r_std_deg if gives_pose else np.nan
    t_std_deg = estimate.t_std_deg if gives_pose else np.nan
    pairs = [(errors.t_d_error_ms, t_d_std_ms, MAX_ERROR_MS)]
    if gives_pose:
        pairs.append((errors.r_error_deg, r_std_deg, MAX_ERROR_DEG))
        pairs.append((errors.t_error_deg, t_std_deg, MAX_ERROR_DEG))
    sigmas = [error / std for error, std, _ in pairs if np.isfinite(std)]
    if sigmas:
        is_wrong = estimate.has_offset and not max(sigmas) <= MAX_SIGMAS
    else:
        is_wrong = estimate.status == "ok" and not all(error <= most for error, _, most in pairs)
    offsets_s = np.append(estimate.alternatives_s, estimate.t_d_s)
    listed = np.abs(offsets_s - case.t_d_s) < 1e-3 * _LISTED_MS
    return RefusalRow(
        status=str(estimate.status),
        reason=estimate.reason,
        offset_given=estimate.has_offset,
        pose_given=estimate.status == "ok" and gives_pose,
        alternatives=len(estimate.alternatives_s),
        truth_among_offsets=bool(listed.any()),
        t_d_error_ms=errors.t_d_error_ms,
        r_error_deg=errors.r_error_deg if gives_pose else np.nan,
        t_error_deg=errors.t_error_deg if gives_pose else np.nan,
        t_d_std_ms=t_d_std_ms,
        r_std_deg=r_std_deg,
        t_std_deg=t_std_deg,
        error_sigmas=max(sigmas, default=np.nan),
        confident_wrong=bool(is_wrong),
    )
