"""Kinds in, the runs that measure them, and what these come to beside each kind's mark, out.

Flight 40000 + 100 k + i is the i-th of the k-th scene: of no table and of no other study, and no
threshold was set on them.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import chi2

from experiments.lab.cell import CRASHED
from experiments.lab.grid import flight_seed
from experiments.lab.study import summed_study
from experiments.marks.kinds import FILMED, KINDS, Kind, Mark
from experiments.marks.measure import MARKED, METHOD, MarkCell
from experiments.paper.grids import ANGLES_DEG

FIRST_FLIGHT, SCENE_STEP = 40_000, 100
OTHER_FLIGHT = 50  # added to the number, for the other flight

FLIGHTS: Mapping[str, int] = {"10 s": 5, "20 s": 20, "5 px, davis346": 3, "82 s": 2}
"""Of each scene."""

FEW = 2
"""Flights of kinds with noise of 10 Hz/px: 18 M events a camera in 20 s."""

LEVEL, MAX_SIGMAS = 0.95, 3.5

HELD = {
    "t_d_normalised": 1,
    "skew_normalised": 1,
    "ends_normalised": 1,
    "r_mahalanobis": 3,
    "t_mahalanobis": 2,
}
"""By column of the runs: degrees of freedom."""

_ERRORS = ("t_d_error_ms", "skew_error_ppm", "ends_error_ms", "r_error_deg", "t_error_deg")
_STATED = ("t_d_std_ms", "skew_std_ppm", "r_std_deg", "t_std_deg")
_JUMPS = ("jump_ms", "jump_at_s")
_MOVED = ("t_d_moved_ms", "r_moved_deg", "t_moved_deg")


def mark_cells() -> list[MarkCell]:
    """List every kind on the flights of its scene."""
    cells = []
    for number, (scene, sim) in enumerate(FILMED.items()):
        for index in range(FLIGHTS[scene]):
            flight = FIRST_FLIGHT + SCENE_STEP * number + index
            # The angles in the middle first, for scenes of few flights.
            angle_deg = ANGLES_DEG[(2 + index) % len(ANGLES_DEG)]
            of_angle = replace(sim, angle_deg=angle_deg)
            seed, other_seed = (
                flight_seed(sim.spline.duration_s, angle_deg, one)
                for one in (flight, flight + OTHER_FLIGHT)
            )
            cells += [
                MarkCell(of_angle, flight, seed, name, other_seed)
                for name, kind in KINDS.items()
                if kind.scene == scene and index < flights_of(kind)
            ]
    return cells


def flights_of(kind: Kind) -> int:
    """Say on how many flights a kind is measured."""
    return FEW if kind.disturb.noise_hz > 0.0 else FLIGHTS[kind.scene]


def marks_table(runs: pd.DataFrame) -> pd.DataFrame:
    """Sum the runs up by kind.

    Parameters
    ----------
    runs
        One row per kind and flight: `mark_cells`.

    Returns
    -------
    pd.DataFrame
        One row per kind, in their order: `runs`, `answered` (with an offset), `refused` (statuses
        of the others with their counts), `reached`, how many meet the kind's mark (NaN: it has
        none); of the answers the largest errors (`_most`; of t_d the rms too), the medians of the
        stated deviations, how many of the intervals and regions of 95 % hold the truth (`_held`)
        of those `_given`, and how many are over 3.5 deviations off; the least and the largest jumps
        that are told; medians and largest of how far wrong intrinsics move the estimate, and of the
        time.
    """
    table: pd.DataFrame = pd.DataFrame(
        [
            {"group": kind.group, "kind": name, **_summed(runs[runs["kind"] == name], kind.mark)}
            for name, kind in KINDS.items()
        ]
    )
    return table


def _summed(runs: pd.DataFrame, mark: Mark | None) -> dict[str, Any]:
    given = runs["offset_given"].astype(bool)
    answers = runs[given]
    refused = runs.loc[~given, "status"].value_counts()
    row: dict[str, Any] = {
        "runs": len(runs),
        "answered": len(answers),
        "refused": " ".join(f"{status}:{count}" for status, count in sorted(refused.items())),
        "reached": np.nan,
    }
    if mark is not None:
        row["reached"] = sum(_reaches(one, mark) for one in runs.to_dict("records"))
    row |= {f"{name}_most": answers[name].max() for name in _ERRORS}
    row["t_d_error_ms_rms"] = np.sqrt((answers["t_d_error_ms"] ** 2).mean())
    row |= {name: _median(answers[name]) for name in _STATED}
    wrong = np.zeros(len(runs), bool)
    for name, free in HELD.items():
        squares = runs[name].to_numpy(np.float64) ** 2
        of = name.rpartition("_")[0]
        row[f"{of}_given"] = int(np.isfinite(squares).sum())
        row[f"{of}_held"] = int(np.sum(squares <= chi2.ppf(LEVEL, free)))
        wrong |= squares > chi2.isf(chi2.sf(MAX_SIGMAS**2, 1), free)
    row["confident_wrong"] = int(wrong.sum())
    for name in _JUMPS:
        row |= {f"{name}_least": runs[name].min(), f"{name}_most": runs[name].max()}
    for name in (*_MOVED, "cpu_s"):
        row |= {f"{name}_median": _median(runs[name]), f"{name}_most": runs[name].max()}
    return row


def _median(values: "pd.Series[Any]") -> float:
    """Give the median of what is known; NaN of nothing, without a warning."""
    known = values.dropna()
    return float(known.median()) if len(known) else np.nan


def _reaches(run: Mapping[Any, Any], mark: Mark) -> bool:
    """Whether a run meets a mark."""
    if not bool(run["offset_given"]):
        is_told = run["status"] != CRASHED and bool(run["reason"])
        return is_told and (mark.may_refuse or mark.must_refuse)
    errors = (run["t_d_error_ms"], run["r_error_deg"], run["skew_error_ppm"])
    limits = (mark.t_d_ms, mark.r_deg, mark.skew_ppm)
    near = (error <= limit for error, limit in zip(errors, limits, strict=True) if limit < np.inf)
    return not mark.must_refuse and all(near)


MARKS = summed_study(
    "marks",
    "Clutter, clocks and intrinsics of real recordings, each kind beside its mark",
    mark_cells,
    MARKED,
    marks_table,
    keys=("kind", "flight"),
    took=("cpu_s",),
    config={"flights": dict(FLIGHTS), "few": FEW, "first_flight": FIRST_FLIGHT,
            "angles_deg": ANGLES_DEG, "kinds": list(KINDS), "method": METHOD},
)  # fmt: skip

STUDIES = (MARKS,)
