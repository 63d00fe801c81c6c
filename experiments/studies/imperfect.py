"""Imperfect recordings in, how often the stated intervals hold all the same out, kind by kind.

Flight 31000 + 30 k + i is the i-th of the k-th round: of no table and of no other study, and no
threshold was set on them. The angles change from flight to flight.
"""

from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import chi2

from experiments.lab.grid import flight_seed
from experiments.lab.study import summed_study
from experiments.measures.imperfect import IMPERFECT_RUNS, ImperfectCell
from experiments.measures.imperfect_kinds import KINDS, ORDINARY, SCENES
from experiments.paper.esim import method_order
from experiments.paper.grids import ANGLES_DEG
from experiments.studies.coverage import QUANTITIES, Quantity, confidence

METHOD_NAMES = ("joint", "tangency", "joint-known", "tangency-known")
N_ROUNDS = 3
"""Of all kinds, on new flights: 162 recordings, 648 runs."""

N_ORDINARY = 2
"""Ordinary flights of a round, each of which has all their kinds; of the other scenes one."""

FIRST_FLIGHT, ROUND_STEP = 31_000, 30
OTHER_FLIGHT = 20  # added to the number, for the flight of the second object

HELD = {name: QUANTITIES[name] for name in ("t_d", "skew", "R", "t")}
"""Quantities whose intervals of 95 % are counted, and whose errors may be confidently wrong."""

LEVEL = 0.95
MAX_SIGMAS = 3.5
"""A larger error of any quantity that is given is a confident wrong answer; of several angles
together, one that is as improbable."""

ALL = "all"
"""Kind of the rows of the summary over all kinds."""


def imperfect_cells(n_rounds: int = N_ROUNDS) -> list[ImperfectCell]:
    """List every method on every kind that is made of each flight."""
    scenes = [*[ORDINARY] * (N_ORDINARY - 1), *SCENES]
    cells = []
    for number in range(n_rounds):
        for index, scene in enumerate(scenes):
            flight = FIRST_FLIGHT + ROUND_STEP * number + index
            angle_deg = ANGLES_DEG[(2 * index + number) % len(ANGLES_DEG)]
            sim = replace(SCENES[scene], angle_deg=angle_deg)
            seed, other_seed = (
                flight_seed(sim.spline.duration_s, angle_deg, one)
                for one in (flight, flight + OTHER_FLIGHT)
            )
            cells += [
                ImperfectCell(sim, flight, seed, name, other_seed, method)
                for name, kind in KINDS.items()
                if kind.scene == scene
                for method in METHOD_NAMES
            ]
    return cells


def imperfect_table(runs: pd.DataFrame) -> pd.DataFrame:
    """Count what was answered, what held, and what was confidently wrong.

    Parameters
    ----------
    runs
        One row per flight, kind and method: `imperfect_cells`.

    Returns
    -------
    pd.DataFrame
        One row per kind and method, in their order, those of all kinds together first: runs,
        `answered` (with an offset), `refused` (statuses of the others with their counts),
        `pose_given`, for each quantity how often it was given with a deviation and the share of
        these whose interval or region of 95 % holds the truth, and the confident wrong answers.
    """
    kinds = {ALL: runs} | {kind: runs[runs["kind"] == kind] for kind in dict.fromkeys(runs["kind"])}
    table: pd.DataFrame = pd.DataFrame(
        [
            {"kind": kind, "method": method, **_counts(part[part["method"] == method])}
            for kind, part in kinds.items()
            for method in method_order(part["method"])
        ]
    )
    return table


def _counts(runs: pd.DataFrame) -> dict[str, Any]:
    """Row of the table for runs of one kind and method."""
    given = runs["offset_given"].astype(bool)
    refused = runs.loc[~given, "status"].value_counts()
    row: dict[str, Any] = {
        "runs": len(runs),
        "answered": int(given.sum()),
        "refused": " ".join(f"{status}:{count}" for status, count in sorted(refused.items())),
        "pose_given": int(runs["pose_given"].astype(bool).sum()),
    }
    wrong = np.zeros(len(runs), bool)
    for name, quantity in HELD.items():
        levels = _levels(runs, quantity)
        n_given = int(np.isfinite(levels).sum())
        row[f"{name}_given"] = n_given
        row[f"{name}_held"] = np.sum(levels <= LEVEL) / n_given if n_given else np.nan
        wrong |= levels > chi2.cdf(MAX_SIGMAS**2, 1)
    row["confident_wrong"] = int(wrong.sum())
    return row


def _levels(runs: pd.DataFrame, quantity: Quantity) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Level (n,) of the interval on whose border the truth lies; NaN where none is given."""
    values = runs[quantity.column].to_numpy(np.float64)
    return confidence(values, quantity.parameters)


IMPERFECT = summed_study(
    "imperfect",
    "Coverage of the stated intervals on imperfect recordings",
    imperfect_cells,
    IMPERFECT_RUNS,
    imperfect_table,
    keys=("kind", "flight", "method"),
    config={"n_rounds": N_ROUNDS, "n_ordinary": N_ORDINARY, "first_flight": FIRST_FLIGHT,
            "kinds": list(KINDS), "methods": METHOD_NAMES, "angles_deg": ANGLES_DEG},
)  # fmt: skip

STUDIES = (IMPERFECT,)
