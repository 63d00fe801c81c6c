"""How often the stated intervals hold on imperfect recordings, kind by kind.

Kinds of one scene are made of the same flight. Flight 31000 + 30 k + i is the i-th of the k-th
round: these are in no table and no other study, and no threshold was set on them. The angles change
from flight to flight.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import pandas as pd
from scipy.special import chdtr

from experiments.lab.cache import Cache
from experiments.lab.cell import Measure, RunRow
from experiments.lab.recorded import Flown, recorded_pair
from experiments.lab.results import Results
from experiments.lab.score import Truth, kept, scored
from experiments.lab.study import Runs, Study
from experiments.lab.summary import made_of, records, shown_table
from experiments.paper.esim import ANGLES_DEG, method_order
from experiments.studies.coverage import QUANTITIES, Quantity, sampling_bounds
from experiments.worlds import spoilt
from experiments.worlds.spoilt import CARELESS, GOOD, ORDINARY, SCENES, T_D_S, Kind, KindCell
from sim.disturb import DisturbConfig
from ssac.arrays import IntArray, Mask
from ssac.camera import known_pose
from ssac.estimate import Estimate
from ssac.pipeline.registry import METHODS

METHOD_NAMES = ("joint", "tangency", "joint-known", "tangency-known")
N_ROUNDS = 3  # of all kinds, on new flights: 162 recordings, 648 runs
N_ORDINARY = 2
"""Ordinary flights of a round, each with all ordinary kinds; other scenes have one flight."""

FIRST_FLIGHT, ROUND_STEP = 31_000, 30
OTHER_FLIGHT = 20  # added to the number, for the flight of the second object

SKEW_STD_PPM = 50.0  # of clocks with oscillators; also the prior of the methods
_TYPICAL = DisturbConfig(noise_hz=1.0, hot_clusters=2, intrinsics_error=GOOD)
_ALL = DisturbConfig(
    lamp_px=6, hot_clusters=5, noise_hz=1.0, branches=100_000, people=1, second_object=0.1,
    intrinsics_error=GOOD,
)  # fmt: skip


def _ordinary(skew_std_ppm: float = 0.0, **disturb: Any) -> Kind:
    return Kind(ORDINARY, DisturbConfig(**disturb), skew_std_ppm=skew_std_ppm)


KINDS: dict[str, Kind] = {
    ORDINARY: _ordinary(),
    **{f"noise {hz:g} Hz/px": _ordinary(noise_hz=hz) for hz in (1.0, 3.0, 10.0)},
    "good calibration": _ordinary(intrinsics_error=GOOD),
    "careless calibration": _ordinary(intrinsics_error=CARELESS),
    "skew": _ordinary(SKEW_STD_PPM),
    **{f"second object {100 * one:g} %": _ordinary(second_object=one) for one in (0.1, 0.2, 1.0)},
    "lamp 6 px": _ordinary(lamp_px=6),
    "lamp 12 px": _ordinary(lamp_px=12),
    "hot clusters": _ordinary(hot_clusters=5),
    "branches": _ordinary(branches=500_000),
    "people": _ordinary(people=2),
    "all at once": Kind(ORDINARY, _ALL, skew_std_ppm=SKEW_STD_PPM),
}
"""By name. "Typical" is noise of 1 Hz/px, two hot clusters, a good calibration and a skew."""

for _scene in [*SCENES][1:]:
    KINDS[_scene] = Kind(_scene)
    KINDS[f"{_scene}, typical"] = Kind(_scene, _TYPICAL, skew_std_ppm=SKEW_STD_PPM)

HELD = {name: QUANTITIES[name] for name in ("t_d", "skew", "R", "t")}
"""Quantities whose intervals of 95 % are counted, and whose errors may be confidently wrong."""

LEVEL = 0.95
MAX_SIGMAS = 3.5
"""A larger error of any quantity that is given is a confident wrong answer; of several angles
together, one that is as improbable."""

ALL = "all"  # kind of the rows of the summary over all kinds


@dataclass(frozen=True)
class ImperfectRow(RunRow):
    """An answer, its errors, and these over their stated deviations; NaN for what is not given."""

    offset_given: bool = False
    pose_given: bool = False
    t_d_error_ms: float = np.nan
    r_error_deg: float = np.nan
    t_error_deg: float = np.nan
    skew_error_ppm: float = np.nan
    t_d_std_ms: float = np.nan
    r_std_deg: float = np.nan
    t_std_deg: float = np.nan
    skew_std_ppm: float = np.nan
    t_d_normalised: float = np.nan  # of an offset that is given; the skew's likewise
    skew_normalised: float = np.nan
    r_mahalanobis: float = np.nan  # of a pose that is given, as in `score.POSE_SCORES`
    t_mahalanobis: float = np.nan
    true_skew_ppm: float = np.nan
    n_samples: int = 0
    n_events_cam1: int = 0  # as recorded, clutter included
    n_events_cam2: int = 0


def imperfect_cells() -> list[KindCell]:
    """List every method on every kind that is made of each flight."""
    cells = []
    for number in range(N_ROUNDS):
        for index, scene in enumerate([*[ORDINARY] * (N_ORDINARY - 1), *SCENES]):
            flight = FIRST_FLIGHT + ROUND_STEP * number + index
            angle_deg = ANGLES_DEG[(2 * index + number) % len(ANGLES_DEG)]
            sim = replace(SCENES[scene], angle_deg=angle_deg)
            kinds = [name for name, kind in KINDS.items() if kind.scene == scene]
            cells += spoilt.kind_cells(sim, flight, OTHER_FLIGHT, kinds, METHOD_NAMES)
    return cells


def load_flown(cells: Sequence[KindCell], cache: Cache) -> Flown:
    """Give the flight, with equal clocks, and the other one; each is loaded when it is needed."""
    sim = replace(cells[0].sim, t_d_s=0.0)
    return Flown(partial(recorded_pair, cache, sim), cells[0].seed, cells[0].other_seed)


def imperfect_row(cell: KindCell, flown: Flown) -> ImperfectRow:
    """Run one method on one kind, and score what it says."""
    kind, duration_s = KINDS[cell.kind], cell.sim.spline.duration_s
    chain = flown.made(cell.kind, lambda: spoilt.spoilt_pair(flown, kind, duration_s).chain())
    truth = truth_of(flown, kind, duration_s)
    columns = given_columns(chain.estimate(cell.method), truth)
    n_cam1, n_cam2 = (chain.clean(k).n_recorded for k in range(2))
    return ImperfectRow(**columns, n_events_cam1=n_cam1, n_events_cam2=n_cam2)


def truth_of(flown: Flown, kind: Kind, duration_s: float) -> Truth:
    """Return the ground truth of a recording of a kind."""
    pose = known_pose(flown.flight.rig)
    return Truth(T_D_S, *pose, kind.skew_of(flown.seed), 0.5 * duration_s)


def given_columns(estimate: Estimate, truth: Truth) -> dict[str, Any]:
    """Return the scores of an offset that is given, and of a pose that was estimated."""
    pose_given = estimate.status == "ok" and not METHODS[estimate.method].needs_extrinsics
    columns = kept(ImperfectRow, scored(estimate, truth, pose_given))
    if not estimate.has_offset:
        columns = {name: columns[name] for name in columns if not name.startswith(("t_d", "skew"))}
    elif not columns["skew_std_ppm"]:
        columns["skew_std_ppm"] = np.nan  # the skew was not estimated
    given = {"offset_given": estimate.has_offset, "pose_given": pose_given}
    return columns | given | {"true_skew_ppm": truth.skew_ppm}


def imperfect_table(runs: pd.DataFrame) -> pd.DataFrame:
    """Count what was answered, what held, and what was confidently wrong, by kind and method.

    All kinds together come first. Runs with an offset are answered; `<name>_held` is the share of
    the stated intervals that hold the truth.
    """
    kinds = {ALL: runs} | dict(list(runs.groupby("kind", sort=False)))
    rows = []
    for kind, of_kind in kinds.items():
        for method in method_order(of_kind["method"]):
            part = of_kind[of_kind["method"] == method]
            posed = {"pose_given": int(part["pose_given"].astype(bool).sum())}
            shares, wrong = held(part, HELD, as_shares=True)
            row = {"kind": kind, "method": method, **answers(part), **posed, **shares}
            rows.append({**row, "confident_wrong": int(wrong.sum())})
    return pd.DataFrame(rows)


def answers(runs: pd.DataFrame) -> dict[str, Any]:
    """Count the runs, those with an offset, and the statuses of the others."""
    given = runs["offset_given"].astype(bool)
    refused = counted(runs["status"][~given].value_counts().sort_index())
    return {"runs": len(runs), "answered": int(given.sum()), "refused": refused}


def counted(counts: "pd.Series[int]", form: str = "{}:{}", between: str = " ") -> str:
    """List words and their counts."""
    return between.join(form.format(word, count) for word, count in counts.items())


def held(
    runs: pd.DataFrame, quantities: Mapping[str, Quantity], as_shares: bool = False
) -> tuple[dict[str, float], Mask]:
    """Count `<name>_given` and `<name>_held`, or its share; mark confidently wrong runs (n,)."""
    levels = pd.DataFrame({name: one.levels(runs) for name, one in quantities.items()})
    given, n_held = levels.notna().sum(), (levels <= LEVEL).sum()
    columns = {"given": given, "held": n_held / given if as_shares else n_held}
    counts = {f"{name}_{what}": of[name] for name in quantities for what, of in columns.items()}
    return counts, (levels > chdtr(1, MAX_SIGMAS**2)).any(axis=1).to_numpy()


def page_table(results: Results) -> str:
    """Say of all kinds together how many were answered, and how many of the answers held."""
    rows, runs = results.rows("imperfect", kind=ALL), results.table("imperfect_runs")
    by_method = [runs[runs["method"] == method] for method in rows["method"]]
    shown = {name: [_share(some, one) for some in by_method] for name, one in HELD.items()}
    columns = {
        "method": "`{method}`",
        "answered": "{answered} of {runs}",
        **{f"{name} [%]": f"{{{name}}}" for name in HELD},
        "confident wrong": "{confident_wrong}",
    }
    return shown_table(rows.assign(**shown), columns)


def _share(runs: pd.DataFrame, quantity: Quantity) -> str:
    levels = quantity.levels(runs)
    given = np.isfinite(levels)
    if not given.any():
        return ""
    share, n = share_by_flight(levels[given] <= LEVEL, runs["seed"].to_numpy()[given])
    low, high = sampling_bounds(share * n, n)
    return f"{100 * share:.0f} ({100 * low:.0f} to {100 * high:.0f})"


def share_by_flight(held: Mask, flights: IntArray) -> tuple[float, float]:
    """Return the share that held (n,), and how many independent runs tell as much of it.

    Runs on one flight err alike. Their number is divided by the design effect: the variance of the
    share between flights over that of independent runs (Korn and Graubard, Survey Methodology 24,
    1998, with 1 as the least).
    """
    share, n = float(np.mean(held)), len(held)
    off = pd.Series(held - share).groupby(flights).sum().to_numpy()
    alone = n * share * (1.0 - share)
    effect = len(off) / (len(off) - 1.0) * float(off @ off) / alone if alone else 1.0
    return share, n / max(1.0, effect)


def kinds(results: Results, column: str) -> str:
    """List the kinds that `tangency` does not answer throughout, or answers wrongly."""
    table = results.rows("imperfect", method="tangency")
    table = table[table["kind"] != ALL].assign(not_answered=table["runs"] - table["answered"])
    listed = records(table[table[column] > 0])
    return "; ".join(f"{one['kind']}: {one[column]} of {one['runs']}" for one in listed) or "none"


STUDIES = (
    Study(
        "imperfect",
        "Coverage of the stated intervals on imperfect recordings",
        imperfect_cells,
        Measure(load_flown, imperfect_row, ImperfectRow),
        Runs("imperfect_runs.csv", ("kind", "flight", "method")),
        (made_of("imperfect.csv", imperfect_table, "imperfect_runs"),),
        numbers={
            "table.imperfect": page_table,
            "imperfect.kinds_not_answered": partial(kinds, column="not_answered"),
            "imperfect.kinds_wrong": partial(kinds, column="confident_wrong"),
        },
        config={"n_rounds": N_ROUNDS, "n_ordinary": N_ORDINARY, "first_flight": FIRST_FLIGHT,
                "kinds": list(KINDS), "methods": METHOD_NAMES, "angles_deg": ANGLES_DEG},
    ),
)  # fmt: skip
