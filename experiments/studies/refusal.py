"""What methods say of flights that leave something open (docs/refusal.md).

A method may refuse, in whole or in part; what it must not do is to give a confident wrong answer.
Flight 1000 + 100 k + i is the i-th of the k-th kind of flight: those of no table and of no other
study, and no threshold was set on them. The angles change from flight to flight.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import pandas as pd

from experiments.lab.cache import Cache
from experiments.lab.cell import Measure, RunRow
from experiments.lab.recorded import Flown
from experiments.lab.results import Results
from experiments.lab.score import kept, scored
from experiments.lab.study import Runs, Study
from experiments.lab.summary import by_group, made_of
from experiments.paper.grids import ANGLES_DEG
from experiments.worlds import open_flights
from experiments.worlds.open_flights import KINDS_OF_FLIGHT, OpenCase, flight_config
from experiments.worlds.spoilt import KindCell, kind_cells
from ssac.estimate import Estimate
from ssac.pipeline.chain import Chain
from ssac.pipeline.registry import METHODS

METHOD_NAMES = ("ssac", "joint", "tangency", "ssac-known", "joint-known", "tangency-known")
N_FLIGHTS = 2  # of each kind of flight
FIRST_FLIGHT, KIND_STEP = 1000, 100
OTHER_FLIGHT = 50_000  # added to the number, for the flight that only camera 2 sees

MAX_SIGMAS = 5.0  # a larger error, with status "ok", is a confident wrong answer
MAX_ERROR_MS, MAX_ERROR_DEG = 5.0, 5.0  # the same for methods that state no deviation
_LISTED_MS = 10.0  # a listed offset is the true one when it is as near


@dataclass(frozen=True)
class RefusalRow(RunRow):
    """What was said, its errors, and whether it is a confident wrong answer."""

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


def refusal_cells() -> list[KindCell]:
    """List every method on every kind that is made of each flight."""
    cells = []
    for index in range(N_FLIGHTS):
        for number, (of_flight, kinds) in enumerate(KINDS_OF_FLIGHT.items()):
            flight = FIRST_FLIGHT + KIND_STEP * number + index
            sim = flight_config(of_flight, ANGLES_DEG[(2 * index + number) % len(ANGLES_DEG)])
            cells += kind_cells(sim, (flight, flight + OTHER_FLIGHT), kinds, METHOD_NAMES, KindCell)
    return cells


def load_kinds(cells: Sequence[KindCell], cache: Cache) -> Flown:
    """Name the flight, and the other one."""
    first = cells[0]
    load = partial(
        open_flights.flight_of, open_flights.FLIGHT_OF[first.kind], first.sim, cache=cache
    )
    return Flown(load, first.seed, first.other_seed)


def refusal_row(cell: KindCell, flown: Flown) -> RefusalRow:
    """Run one method on one kind, and judge what it says."""

    def make() -> tuple[OpenCase, Chain]:
        case = open_flights.open_case(cell.kind, flown.flight, lambda: flown.other)
        return case, Chain((case.cam1, case.cam2), case.rig, case.config)

    case, chain = flown.made(cell.kind, make)
    return judged(chain.estimate(cell.method), case)


def judged(estimate: Estimate, case: OpenCase) -> RefusalRow:
    """Judge what was said."""
    gives_pose = not METHODS[estimate.method].needs_extrinsics and estimate.R is not None
    columns = scored(estimate, case.truth, gives_pose)
    pairs = [(columns["t_d_error_ms"], columns["t_d_std_ms"], MAX_ERROR_MS)]
    if gives_pose:
        of_pose = ((columns[f"{p}_error_deg"], columns[f"{p}_std_deg"]) for p in "rt")
        pairs += [(error_deg, std_deg, MAX_ERROR_DEG) for error_deg, std_deg in of_pose]
    sigmas = [error / std for error, std, _ in pairs if np.isfinite(std)]
    if sigmas:
        is_wrong = estimate.has_offset and not max(sigmas) <= MAX_SIGMAS
    else:
        is_wrong = estimate.status == "ok" and not all(error <= most for error, _, most in pairs)
    offsets_s = np.append(estimate.alternatives_s, estimate.t_d_s)
    listed = np.abs(offsets_s - case.truth.t_d_s) < 1e-3 * _LISTED_MS
    return RefusalRow(
        **kept(RefusalRow, columns),
        offset_given=estimate.has_offset,
        pose_given=estimate.status == "ok" and gives_pose,
        alternatives=len(estimate.alternatives_s),
        truth_among_offsets=bool(listed.any()),
        error_sigmas=max(sigmas, default=np.nan),
        confident_wrong=bool(is_wrong),
    )


def refusal_table(runs: pd.DataFrame) -> pd.DataFrame:
    """Count what each method says of each kind.

    `truth_among_offsets` is how often the true offset is the one given or one of the alternatives;
    the worst errors are of what was given: of t_d, and of any of t_d, R and t over its deviation.
    """

    def row(group: pd.DataFrame) -> dict[str, Any]:
        given, statuses = group[group["offset_given"]], group["status"].value_counts()
        return {
            "runs": len(group),
            "statuses": " ".join(f"{status}:{count}" for status, count in statuses.items()),
            "offset_given": len(given),
            "pose_given": int(group["pose_given"].sum()),
            "truth_among_offsets": int(group["truth_among_offsets"].sum()),
            "t_d_error_ms_worst": given["t_d_error_ms"].max(),
            "error_sigmas_worst": given["error_sigmas"].max(),
            "confident_wrong": int(group["confident_wrong"].sum()),
        }

    return by_group(runs, ("kind", "method"), row)


def wrong(results: Results, method: str) -> str:
    """Count the confident wrong answers of one method."""
    return f"{results.column('refusal', 'confident_wrong', method=method).sum():.0f}"


def ordinary_answered(results: Results) -> str:
    """Say how many runs on ordinary flights gave an offset."""
    rows = results.rows("refusal", kind="ordinary")
    return f"{int(rows['offset_given'].sum())} of {int(rows['runs'].sum())}"


STUDIES = (
    Study(
        "refusal",
        "What methods say of flights that leave offset or pose open",
        refusal_cells,
        Measure(load_kinds, refusal_row, RefusalRow),
        Runs("refusal_runs.csv", ("kind", "flight", "method")),
        (made_of("refusal.csv", refusal_table, "refusal_runs"),),
        numbers={
            "refusal.recordings": lambda of: str(len(of.rows("refusal_runs", method="joint"))),
            "refusal.ordinary": ordinary_answered,
            **{f"refusal.wrong.{m}": partial(wrong, method=m) for m in METHOD_NAMES},
        },
        config={"n_flights": N_FLIGHTS, "first_flight": FIRST_FLIGHT, "angles_deg": ANGLES_DEG},
    ),
)
