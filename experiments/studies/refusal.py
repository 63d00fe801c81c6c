"""What methods say of flights that leave something open, and whether they say why.

A method may refuse, in whole or in part; what it must not do is to give a confident wrong answer.
Flight 1000 + 100 k + i is the i-th of the k-th kind of flight: these are in no table and no other
study, and no threshold was set on them. The angles change from flight to flight.

The phrases of advice in a reason are tried in order, as by a user, until there is an answer, which
must be right. Recording i of base b is flight 60,000 + 100 b + i, in no table and no other study.
Words and rules were settled on bases 1, 2 and 20.
"""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import Any

import numpy as np
import pandas as pd

from experiments.lab.cache import Cache
from experiments.lab.cell import Measure, RunRow, load_nothing
from experiments.lab.results import Results
from experiments.lab.score import kept, scored
from experiments.lab.study import Runs, Study
from experiments.lab.summary import by_group, made_of, quoted, quoted_of
from experiments.paper.esim import ANGLES_DEG
from experiments.studies.by_hand import right
from experiments.studies.imperfect import ALL, ImperfectRow, counted, given_columns
from experiments.worlds import open_flights
from experiments.worlds.open_flights import CAUSES, KINDS, Cause, OpenCase, Scene
from experiments.worlds.spoilt import ORDINARY, KindCell, kind_cells
from ssac.errors import SsacError
from ssac.estimate import Estimate, Status
from ssac.pipeline.chain import Chain
from ssac.pipeline.registry import METHODS

METHOD_NAMES = ("ssac", "joint", "tangency", "ssac-known", "joint-known", "tangency-known")
N_FLIGHTS = 2  # of each kind of flight
FIRST_FLIGHT, KIND_STEP = 1000, 100
OTHER_FLIGHT = 50_000  # added to the number, for the flight that only camera 2 sees

MAX_SIGMAS = 5.0  # a larger error, with status "ok", is a confident wrong answer
MAX_ERROR_MS, MAX_ERROR_DEG = 5.0, 5.0  # the same for methods that state no deviation
_LISTED_MS = 10.0  # a listed offset counts as the true one if it is nearer


@dataclass(frozen=True)
class RefusalRow(RunRow):
    """An answer or refusal, its errors, and whether it is confidently wrong."""

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
    error_sigmas: float = np.nan  # largest error over its deviation, of what is given
    confident_wrong: bool = False


def refusal_cells() -> list[KindCell]:
    """List every method on every kind that is made of each flight."""
    cells = []
    for index in range(N_FLIGHTS):
        for k, path in enumerate(dict.fromkeys(kind.path for kind in KINDS.values())):
            flight = FIRST_FLIGHT + KIND_STEP * k + index
            angle_deg = ANGLES_DEG[(2 * index + k) % len(ANGLES_DEG)]
            sim = open_flights.flight_config(path, angle_deg)
            kinds = [name for name, kind in KINDS.items() if kind.path == path]
            cells += kind_cells(sim, flight, OTHER_FLIGHT, kinds, METHOD_NAMES)
    return cells


def refusal_row(cell: KindCell, cache: Cache) -> RefusalRow:
    """Run one method on one kind, and judge what it says."""
    case, chain = _made(replace(cell, method=""), cache)
    return judged(chain.estimate(cell.method), case)


@lru_cache(maxsize=1)  # of all methods, whose cells follow each other
def _made(cell: KindCell, cache: Cache) -> tuple[OpenCase, Chain]:
    case = Scene(KINDS[cell.kind], cell, cache).made()
    return case, case.chain


def judged(estimate: Estimate, case: OpenCase) -> RefusalRow:
    """Score an estimate, and judge whether it is confidently wrong."""
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


@by_group("kind", "method")
def refusal_table(group: pd.DataFrame) -> dict[str, Any]:
    """Count what each method says of each kind.

    `truth_among_offsets` is how often the true offset is the one given or one of the alternatives;
    the worst errors are of what was given: of t_d, and of any of t_d, R and t over its deviation.
    """
    given = group[group["offset_given"]]
    return {
        "runs": len(group),
        "statuses": counted(group["status"].value_counts()),
        "offset_given": len(given),
        **group[["pose_given", "truth_among_offsets"]].sum(),
        "t_d_error_ms_worst": given["t_d_error_ms"].max(),
        "error_sigmas_worst": given["error_sigmas"].max(),
        "confident_wrong": group["confident_wrong"].sum(),
    }


# --- Whether refusals name their causes, and whether their advice works ---


BASE = 61  # some choices were made on its recordings, and on those of 62
N_RECORDINGS = 20  # of each cause
REASONS_FIRST_FLIGHT, BASE_STEP = 60_000, 100


@dataclass(frozen=True)
class ReasonRow(ImperfectRow):
    """An answer or refusal, whether it is right, and what became of the advice."""

    is_right: bool = False  # all that is given is right
    is_named: bool = False
    advice: str = ""  # its phrases in the reason
    works: bool = False
    then: str = ""  # statuses after each phrase was followed


Follow = Callable[[Scene, OpenCase, Estimate], list[OpenCase]]
"""Follows an advice on a refused recording: gives the new recordings, all of which must be answered
rightly, or none where the advice does not mend what is wrong."""


def _filmed(**fields: Any) -> Follow:
    """Film again, with some of the cause's fields changed."""
    return lambda scene, case, estimate: [scene.changed(**fields).made()]


def _mended(phrase: str) -> Follow:
    """Film again without what spoilt the recording, if that is what the advice is about."""
    return lambda scene, *_: [scene.plain()] if scene.cause.mended_by == phrase else []


def _asked(**fields: Any) -> Follow:
    """Ask again, with some options changed."""
    return lambda scene, case, estimate: [replace(case, config=replace(case.config, **fields))]


def _longer(scene: Scene, case: OpenCase, estimate: Estimate) -> list[OpenCase]:
    is_longer = scene.cause.path == ORDINARY and scene.cause.duration_s < open_flights.LONG_S
    return [scene.changed(duration_s=open_flights.LONG_S).made()] if is_longer else []


def _cut(scene: Scene, case: OpenCase, estimate: Estimate) -> list[OpenCase]:
    """Cut both recordings where the clock is said to jump; each part has an offset of its own."""
    jump, t_d_s = estimate.jump, case.truth.t_d_s
    assert jump is not None
    ends_s = (
        (-np.inf, jump.at_s, jump.before_s, t_d_s),
        (jump.at_s, np.inf, jump.after_s, t_d_s + open_flights.jump_of(scene)[1]),
    )
    return [
        replace(
            case,
            cam1=open_flights.cut(case.cam1, from_s, to_s),
            cam2=open_flights.cut(case.cam2, from_s + shown_s, to_s + shown_s),
            truth=replace(case.truth, t_d_s=true_s),
        )
        for from_s, to_s, shown_s, true_s in ends_s
    ]


ADVICE: Mapping[str, Follow] = {
    "leave out --search": _asked(interval_s=None),
    "record longer": _longer,
    "a livelier flight": _filmed(path=ORDINARY, duration_s=open_flights.DURATION_S),
    "in all directions": _filmed(path=ORDINARY, scale=1.0),
    "record one flight": _mended("record one flight"),
    "cut the recordings": _cut,
    "--rate-range": _asked(rates=(0.5, 2.0)),
    "--clock pieces": _asked(clock="pieces"),
    "calibrate again": _mended("calibrate again"),
    "give its inverse": lambda scene, case, estimate: [open_flights.inverted(case)],
    "exchange them": lambda scene, case, estimate: [open_flights.exchanged(case)],
    "record one object": _mended("record one object"),
}
"""What each phrase of advice in a reason asks for."""


def reason_cells(base: int = BASE, recordings: int = N_RECORDINGS) -> list[KindCell]:
    """List the recordings of all causes, those of one flight together."""
    cells = []
    for index in range(recordings):
        flight = REASONS_FIRST_FLIGHT + BASE_STEP * base + index
        sim = open_flights.flight_config(ORDINARY, ANGLES_DEG[index % len(ANGLES_DEG)])
        cells += kind_cells(sim, flight, OTHER_FLIGHT, CAUSES, ["tangency"])
    return cells


def reason_row(cell: KindCell, cache: Cache) -> ReasonRow:
    """Judge the estimate of a recording, and those after following the advice of a refusal."""
    cause = CAUSES[cell.kind]
    scene = Scene(cause, cell, cache)
    case = scene.made()
    estimate, row = said(cause, case)
    if row.status == Status.OK:
        return row
    there = [phrase for phrase in ADVICE if phrase in estimate.reason]
    phrases, then = sorted(there, key=estimate.reason.index), []
    for phrase in phrases:
        rows = [said(cause, one)[1] for one in ADVICE[phrase](scene, case, estimate)]
        then.append(",".join(str(one.status) for one in rows))
        if rows and all(one.offset_given for one in rows):
            row = replace(row, works=all(one.is_right for one in rows))
            break
    return replace(row, advice="; ".join(phrases), then="; ".join(then))


def said(cause: Cause, case: OpenCase) -> tuple[Estimate, ReasonRow]:
    """Run the cause's method, or else the best one, and judge its estimate."""
    try:
        chain = case.chain
        estimate = chain.estimate(cause.method) if cause.method else chain.answer().estimate
    except SsacError as error:
        return Estimate("", "unusable", str(error)), ReasonRow("unusable", str(error))
    row = ReasonRow(**given_columns(estimate, case.truth))
    names = estimate.status in cause.named_by and re.search(cause.words, estimate.reason)
    is_right = bool(right(pd.DataFrame([vars(row)]))[0])
    return estimate, replace(row, is_right=is_right, is_named=bool(names))


@by_group("kind", of_all=ALL)
def reasons_table(group: pd.DataFrame) -> dict[str, Any]:
    """Count by cause the refusals and answers, and how often advice works.

    `named` are refusals that name the cause, `right` and `wrong` what was answered in spite of it,
    offsets without a pose among them. `advised` are refusals with an advice, and `works` those of
    them that following it mended.
    """
    unnamed = group[~group["is_named"]]
    return {
        "recordings": len(group),
        "named": len(group) - len(unnamed),
        "right": unnamed["is_right"].sum(),
        "wrong": (group["offset_given"] & ~group["is_right"]).sum(),
        "advised": (group["advice"].fillna("") != "").sum(),
        "works": group["works"].sum(),
        "not_named": counted(unnamed["status"].value_counts()),
    }


def share(results: Results, columns: Sequence[str], of: str) -> str:
    """Give the sum of some counts as a share [%] of another count, over all causes."""
    row = results.one("reasons", kind=ALL)
    return f"{100 * sum(row[column] for column in columns) / row[of]:.0f}"


_WRONG = partial(quoted_of, "refusal", "confident_wrong", "{total:.0f}")

STUDIES = (
    Study(
        "refusal",
        "What methods say of flights that leave offset or pose open",
        refusal_cells,
        Measure(load_nothing, refusal_row, RefusalRow),
        Runs("refusal_runs.csv", ("kind", "flight", "method")),
        (made_of("refusal.csv", refusal_table, "refusal_runs"),),
        numbers={
            "refusal.recordings": lambda of: str(len(of.rows("refusal_runs", method="joint"))),
            "refusal.ordinary": lambda of: "{offset_given} of {runs}".format(
                **of.rows("refusal", kind=ORDINARY)[["offset_given", "runs"]].sum()
            ),
            **{f"refusal.wrong.{m}": _WRONG(method=m) for m in METHOD_NAMES},
        },
        config={"n_flights": N_FLIGHTS, "first_flight": FIRST_FLIGHT, "angles_deg": ANGLES_DEG},
    ),
    Study(
        "reasons",
        "Whether refusals name their causes, and whether their advice works",
        reason_cells,
        Measure(load_nothing, reason_row, ReasonRow),
        Runs("reasons_runs.csv", ("kind", "flight")),
        (made_of("reasons.csv", reasons_table, "reasons_runs"),),
        numbers={
            "reasons.recordings": quoted("reasons", "{recordings:.0f}", kind=ALL),
            "reasons.wrong": quoted("reasons", "{wrong:.0f} of {recordings:.0f}", kind=ALL),
            "reasons.named": partial(share, columns=("named", "right"), of="recordings"),
            "reasons.works": partial(share, columns=("works",), of="advised"),
        },
        config={"base": BASE, "recordings": N_RECORDINGS, "causes": list(CAUSES)},
        shows="reasons",
    ),
)
