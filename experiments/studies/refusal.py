"""Flights that leave something open in, what each method says of them counted (docs/refusal.md).

Flight 1000 + 100 k + i is the i-th of the k-th kind of flight: those of no table and of no other
study, and no threshold was set on them. The angles change from flight to flight.
"""

import pandas as pd

from experiments.lab.grid import flight_seed
from experiments.lab.study import summed_study
from experiments.measures.refusal import REFUSALS, RefusalCell
from experiments.measures.refusal_flights import DURATION_S, KINDS_OF_FLIGHT, flight_config
from experiments.paper.grids import ANGLES_DEG

METHOD_NAMES = ("ssac", "joint", "tangency", "ssac-known", "joint-known", "tangency-known")
N_FLIGHTS = 2
"""Of each kind of flight."""

FIRST_FLIGHT, KIND_STEP = 1000, 100
OTHER_FLIGHT = 50_000  # added to the number, for the flight that only camera 2 sees


def refusal_cells() -> list[RefusalCell]:
    """List every method on every kind that is made of each flight."""
    cells = []
    for index in range(N_FLIGHTS):
        for number, (of_flight, kinds) in enumerate(KINDS_OF_FLIGHT.items()):
            flight = FIRST_FLIGHT + KIND_STEP * number + index
            angle_deg = ANGLES_DEG[(2 * index + number) % len(ANGLES_DEG)]
            sim = flight_config(of_flight, angle_deg)
            seed, other_seed = (
                flight_seed(DURATION_S, angle_deg, one) for one in (flight, flight + OTHER_FLIGHT)
            )
            cells += [
                RefusalCell(sim, flight, seed, kind, of_flight, other_seed, method)
                for kind in kinds
                for method in METHOD_NAMES
            ]
    return cells


def refusal_table(runs: pd.DataFrame) -> pd.DataFrame:
    """Count what each method says of each kind.

    Parameters
    ----------
    runs
        One row per flight, kind and method: `refusal_cells`.

    Returns
    -------
    pd.DataFrame
        One row per kind and method, in their order: runs, `statuses` with their counts, how often
        the offset and the pose were given, how often the true offset is the one given or one of the
        alternatives, the largest error of what was given (t_d in ms, and in stated deviations of
        any of t_d, R and t), and the confident wrong answers.
    """
    rows = []
    for (kind, method), group in runs.groupby(["kind", "method"], sort=False):
        given = group[group["offset_given"]]
        counts = group["status"].value_counts()
        rows.append(
            {
                "kind": kind,
                "method": method,
                "runs": len(group),
                "statuses": " ".join(f"{status}:{count}" for status, count in counts.items()),
                "offset_given": len(given),
                "pose_given": int(group["pose_given"].sum()),
                "truth_among_offsets": int(group["truth_among_offsets"].sum()),
                "t_d_error_ms_worst": given["t_d_error_ms"].max(),
                "error_sigmas_worst": given["error_sigmas"].max(),
                "confident_wrong": int(group["confident_wrong"].sum()),
            }
        )
    table: pd.DataFrame = pd.DataFrame(rows)
    return table


REFUSAL = summed_study(
    "refusal",
    "What methods say of flights that leave offset or pose open",
    refusal_cells,
    REFUSALS,
    refusal_table,
    keys=("kind", "flight", "method"),
    config={"n_flights": N_FLIGHTS, "first_flight": FIRST_FLIGHT, "angles_deg": ANGLES_DEG},
)

STUDIES = (REFUSAL,)
