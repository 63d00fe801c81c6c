"""Recordings as they come, each kind beside what is required of `tangency`: the study `marks`.

The kinds form three groups: clutter in view, clocks that drift or jump, and wrong intrinsics.
Flight 40000 + 100 k + i is the i-th of the k-th scene: these are in no table and no other study,
and no threshold was set on them.
"""

import re
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd

from experiments.lab.cell import CRASHED, Measure
from experiments.lab.grid import changed
from experiments.lab.recorded import Flown
from experiments.lab.results import Results
from experiments.lab.score import Truth, scored
from experiments.lab.study import Runs, Study
from experiments.lab.summary import made_of, quoted, records, shown_table, statistics
from experiments.paper.esim import ANGLES_DEG
from experiments.studies import imperfect
from experiments.studies.coverage import QUANTITIES, Quantity
from experiments.worlds import spoilt
from experiments.worlds.spoilt import CARELESS, GOOD, ORDINARY, RIGHT, SCENES, T_D_S, Errors, Kind
from sim.disturb import DisturbConfig
from sim.recording import SimConfig
from sim.scene.trajectory import SplineConfig
from ssac.config import Config
from ssac.estimate import Estimate

METHOD = "tangency"  # the default of `ssac sync`
FIRST_FLIGHT, SCENE_STEP = 40_000, 100
OTHER_FLIGHT = 50  # added to the number, for the other flight

FLIGHTS: Mapping[str, int] = {"10 s": 5, "20 s": 20, "5 px, davis346": 3, "82 s": 2}
"""Number of flights of each scene."""

FEW = 2  # flights of kinds with noise of 10 Hz/px: 18 M events a camera in 20 s

FILMED: Mapping[str, SimConfig] = {
    "10 s": replace(SCENES[ORDINARY], spline=SplineConfig(10.0)),
    "20 s": SCENES[ORDINARY],
    "5 px, davis346": SCENES["5 px, davis346"],
    "82 s": replace(SCENES[ORDINARY], spline=SplineConfig(82.0)),
}

JUMP_AT_S = 8.0


@dataclass(frozen=True)
class Requirement:
    """The largest errors that answers of a kind may have, and whether refusal is allowed or due."""

    t_d_ms: float = np.inf
    r_deg: float = np.inf
    skew_ppm: float = np.inf
    may_refuse: bool = False  # a refusal that says why is as good
    must_refuse: bool = False  # no answer is right


@dataclass(frozen=True)
class Required:
    """One kind of recording, and what is required of it."""

    group: str
    kind: Kind
    requirement: Requirement | None = None
    skew_prior_ppm: float | None = None  # that the method is given; None: its default


_NEAR = Requirement(t_d_ms=0.3, may_refuse=True)
_EXACT = Requirement(t_d_ms=0.1, skew_ppm=3.0)
_REFUSED = Requirement(must_refuse=True)
_SMALL = "5 px, davis346"


def _clutter(
    requirement: Requirement = _NEAR, scene: str = "10 s", others: bool = False, **disturb: Any
) -> Required:
    kind = Kind(scene, DisturbConfig(**disturb), others, skew_ppm=0.0)
    return Required("clutter", kind, requirement)


def _clocks(
    scene: str,
    requirement: Requirement | None = None,
    skew_ppm: float = 0.0,
    jump_s: float = 0.0,
    skew_prior_ppm: float | None = None,
) -> Required:
    kind = Kind(scene, skew_ppm=skew_ppm, jump=(JUMP_AT_S, jump_s) if jump_s else None)
    return Required("clocks", kind, requirement, skew_prior_ppm)


def _intrinsics(drawn: tuple[float, float] = (0.0, 0.0), **rig: Any) -> Required:
    disturb = DisturbConfig(intrinsics_error=drawn)
    return Required("intrinsics", Kind("10 s", disturb, skew_ppm=0.0, **rig))


_LONG: Errors = (0.01, 0.01, 0.0, 0.0)
_OFF: Errors = (0.0, 0.0, 3.0, 2.0)
_ONE, _BOTH = "of one camera", "of both cameras"

UNSTATED: Mapping[str, tuple[Errors, Errors]] = {
    f"focal lengths {_BOTH} 1 % long": (_LONG, _LONG),
    f"focal lengths {_ONE} 1 % long": (_LONG, RIGHT),
    f"fu {_ONE} 1 % long": ((0.01, 0.0, 0.0, 0.0), RIGHT),
    f"fv {_ONE} 1 % long": ((0.0, 0.01, 0.0, 0.0), RIGHT),
    f"centres {_BOTH} 1 px right": ((0.0, 0.0, 1.0, 0.0), (0.0, 0.0, 1.0, 0.0)),
    f"centres {_BOTH} 1 px down": ((0.0, 0.0, 0.0, 1.0), (0.0, 0.0, 0.0, 1.0)),
    f"centre {_ONE} 1 px right": ((0.0, 0.0, 1.0, 0.0), RIGHT),
    f"centre {_ONE} 1 px down": ((0.0, 0.0, 0.0, 1.0), RIGHT),
}
"""Errors of intrinsics that the rig file does not state, by a description."""


KINDS: Mapping[str, Required] = {
    "nothing": _clutter(),
    "lamp 6 px": _clutter(lamp_px=6),
    "lamp 12 px": _clutter(lamp_px=12),
    "5 hot clusters": _clutter(hot_clusters=5),
    "branches, 0.5 M events": _clutter(branches=500_000),
    "second drone 10 %": _clutter(second_object=0.1),
    "second drone 20 %": _clutter(second_object=0.2),
    "second drone 100 %": _clutter(second_object=1.0),
    "noise 10 Hz/px": _clutter(noise_hz=10.0),
    "5 px drone, davis346": _clutter(Requirement(t_d_ms=0.1, r_deg=0.3), _SMALL),
    "5 px drone, davis346, noise 10 Hz/px": _clutter(_NEAR, _SMALL, noise_hz=10.0),
    "other flights, noise 10 Hz/px": _clutter(_REFUSED, "20 s", others=True, noise_hz=10.0),
    "20 s, clocks alike": _clocks("20 s"),
    "20 s, clocks alike, no skew looked for": _clocks("20 s", skew_prior_ppm=0.0),
    "82 s, skew 20 ppm": _clocks("82 s", _EXACT, 20.0),
    "82 s, skew 50 ppm": _clocks("82 s", _EXACT, 50.0),
    "82 s, skew 50 ppm, none looked for": _clocks("82 s", skew_ppm=50.0, skew_prior_ppm=0.0),
    "20 s, jump of 5 ms": _clocks("20 s", _REFUSED, jump_s=0.005),
    "20 s, jump of 20 ms": _clocks("20 s", _REFUSED, jump_s=0.02),
    "right, stated 0.1 %, 0.3 px": _intrinsics(stated=GOOD),
    "focal lengths 1 % long, stated 1 %, 3 px": _intrinsics(errors=(_LONG, _LONG), stated=CARELESS),
    "focal lengths 1 % long, stated 0.1 %, 0.3 px": _intrinsics(errors=(_LONG, _LONG), stated=GOOD),
    "centres (3, 2) px off, stated 1 %, 3 px": _intrinsics(errors=(_OFF, _OFF), stated=CARELESS),
    "centres (3, 2) px off, stated 0.1 %, 0.3 px": _intrinsics(errors=(_OFF, _OFF), stated=GOOD),
    "drawn from 0.1 %, 0.3 px": _intrinsics(GOOD),
    "drawn from 1 %, 3 px": _intrinsics(CARELESS),
    **{name: _intrinsics(errors=errors) for name, errors in UNSTATED.items()},
}
"""Kinds by name, group by group; those of one scene are made of the same flights."""


@dataclass(frozen=True)
class RequiredCell(spoilt.KindCell):
    """`tangency` on a kind of recording that is made of a flight."""

    method: str = METHOD

    @property
    def columns(self) -> dict[str, Any]:
        """Columns that say which run it is."""
        return {"group": KINDS[self.kind].group, "kind": self.kind, **self.flown}


@dataclass(frozen=True)
class RequiredRow(imperfect.ImperfectRow):
    """An answer, its errors and its CPU time; NaN for what is not given."""

    ends_error_ms: float = np.nan  # larger error of the offset at the ends of the recording
    ends_normalised: float = np.nan  # larger ratio of such an error to its deviation
    t_d_moved_ms: float = np.nan  # from the estimate with exact intrinsics
    r_moved_deg: float = np.nan
    t_moved_deg: float = np.nan
    jump_ms: float = np.nan  # estimated size of the jump of a clock
    jump_at_s: float = np.nan  # camera 1's clock
    cpu_s: float = np.nan  # all but reading, on the machine that measured


def required_cells() -> list[RequiredCell]:
    """List every kind on the flights of its scene."""
    cells = []
    for number, (scene, sim) in enumerate(FILMED.items()):
        for index in range(FLIGHTS[scene]):
            flight = FIRST_FLIGHT + SCENE_STEP * number + index
            # The angles in the middle first, for scenes of few flights.
            of_angle = replace(sim, angle_deg=ANGLES_DEG[(2 + index) % len(ANGLES_DEG)])
            kinds = [
                name
                for name, required in KINDS.items()
                if required.kind.scene == scene
                and (index < FEW or not required.kind.disturb.noise_hz)
            ]
            cells += spoilt.kind_cells(of_angle, flight, OTHER_FLIGHT, kinds, (METHOD,))
    return [RequiredCell(**vars(cell)) for cell in cells]


def required_row(cell: RequiredCell, flown: Flown) -> RequiredRow:
    """Run `tangency` on a recording of a kind, and score what it says."""
    required, duration_s = KINDS[cell.kind], cell.sim.spline.duration_s
    kind, config = required.kind, Config()
    pair = spoilt.spoilt_pair(flown, kind, duration_s)
    if required.skew_prior_ppm is not None:
        config = replace(config, skew_prior_ppm=required.skew_prior_ppm)
    if cell.kind in UNSTATED:  # what these do to an estimate that does not question them
        config = changed(config, {"rules.verdict.max_against": 1e3})
    start_s = time.process_time()
    estimate = pair.chain(config).estimate(METHOD)
    cpu_s = time.process_time() - start_s
    truth = imperfect.truth_of(flown, kind, duration_s)
    columns = imperfect.given_columns(estimate, truth) | ends_of(estimate, truth)
    columns |= {"n_events_cam1": len(pair.cam1.events), "n_events_cam2": len(pair.cam2.events)}
    if estimate.jump is not None:
        columns |= {"jump_ms": 1e3 * estimate.jump.size_s, "jump_at_s": estimate.jump.at_s}
    if kind.errors != Kind.errors:
        columns |= _moved(estimate, flown)
    return RequiredRow(**columns, cpu_s=cpu_s)


def ends_of(estimate: Estimate, truth: Truth) -> dict[str, float]:
    """Return the larger error of the offset at both ends, plain and over its deviation."""
    if not estimate.has_offset:
        return {}
    ends_s = np.array([0.0, 2.0 * truth.t_mid_s])
    found_s = estimate.clock.cam2_from_cam1(ends_s) - ends_s
    true_s = truth.t_d_s + 1e-6 * truth.skew_ppm * (ends_s - truth.t_mid_s)
    errors_s = np.abs(found_s - true_s)
    sigmas = errors_s / estimate.clock_std_s(ends_s)
    return {"ends_error_ms": float(1e3 * np.max(errors_s)), "ends_normalised": float(sigmas.max())}


def _moved(estimate: Estimate, flown: Flown) -> dict[str, float]:
    """Score an estimate against the one with exact intrinsics, as if that were the truth."""

    def exactly() -> Estimate:
        pair = flown.flight._replace(cam2=flown.flight.cam2.delayed(T_D_S))
        return pair.chain().estimate(METHOD)

    exact = flown.made("exact", exactly)
    if estimate.R is None or exact.R is None or estimate.t is None or exact.t is None:
        return {}
    moved = scored(estimate, Truth(exact.t_d_s, exact.R, exact.t))
    return {name: moved[name.replace("moved", "error")] for name in _MOVED}


HELD = {
    "t_d": QUANTITIES["t_d"],
    "skew": QUANTITIES["skew"],
    "ends": Quantity("ends_normalised", 1),
    "r": QUANTITIES["R"],
    "t": QUANTITIES["t"],
}
"""Quantities whose intervals of 95 % are counted."""

_ERRORS = ("t_d_error_ms", "skew_error_ppm", "ends_error_ms", "r_error_deg", "t_error_deg")
_STATED = ("t_d_std_ms", "skew_std_ppm", "r_std_deg", "t_std_deg")
_MOVED = ("t_d_moved_ms", "r_moved_deg", "t_moved_deg")


def required_table(runs: pd.DataFrame) -> pd.DataFrame:
    """Sum up the runs by kind; `reached` counts those that do as required (NaN: nothing is).

    Runs with an offset give the largest errors, medians of stated deviations, how many regions of
    95 % hold the truth, and how many runs are over 3.5 deviations off; all runs give the reported
    jumps, how far wrong intrinsics move the estimate, and the CPU time.
    """
    rows = [
        {"group": one.group, "kind": name, **_summed(runs[runs["kind"] == name], one.requirement)}
        for name, one in KINDS.items()
    ]
    return pd.DataFrame(rows)


def _summed(runs: pd.DataFrame, requirement: Requirement | None) -> dict[str, Any]:
    given = runs[runs["offset_given"].astype(bool)]
    row = imperfect.answers(runs) | {"reached": np.nan}
    if requirement is not None:
        row["reached"] = sum(meets(one, requirement) for one in records(runs))
    row |= statistics(given, _ERRORS, "most")
    row["t_d_error_ms_rms"] = np.sqrt((given["t_d_error_ms"] ** 2).mean())
    row |= {name: given[name].dropna().median() for name in _STATED}  # NaN if empty, unwarned
    counts, wrong = imperfect.held(runs, HELD)
    row |= counts | {"confident_wrong": int(wrong.sum())}
    for name in ("jump_ms", "jump_at_s"):
        row |= {f"{name}_least": runs[name].min(), f"{name}_most": runs[name].max()}
    for name in (*_MOVED, "cpu_s"):
        row |= {f"{name}_median": runs[name].dropna().median(), f"{name}_most": runs[name].max()}
    return row


def meets(run: Mapping[str, Any], requirement: Requirement) -> bool:
    """Return whether a run meets a requirement."""
    if not bool(run["offset_given"]):
        says_why = run["status"] != CRASHED and pd.notna(run["reason"]) and run["reason"] != ""
        return says_why and (requirement.may_refuse or requirement.must_refuse)
    errors = (run["t_d_error_ms"], run["r_error_deg"], run["skew_error_ppm"])
    limits = (requirement.t_d_ms, requirement.r_deg, requirement.skew_ppm)
    near = (error <= limit for error, limit in zip(errors, limits, strict=True) if limit < np.inf)
    return not requirement.must_refuse and all(near)


def sensitivity_table(results: Results) -> str:
    """Lay out how far unstated errors of the intrinsics move the estimate."""
    rows = results.table("marks")
    moved = {
        heading: f"{{{column}_median:.2f}}, {{{column}_most:.2f}}"
        for heading, column in zip(("t_d [ms]", "R [deg]", "t [deg]"), _MOVED, strict=True)
    }
    unstated = rows[rows["kind"].isin(UNSTATED)]
    return shown_table(unstated, {"error of the intrinsics": "{kind}", **moved})


_REACHED, _RMS_MS = "{reached:.0f} of {runs:.0f}", "{t_d_error_ms_rms:.3f} ms"
_JUMPS = (
    "{jump_ms_least:.1f} to {jump_ms_most:.1f} ms, at {jump_at_s_least:.1f} to "
    "{jump_at_s_most:.1f} s"
)
_QUOTED = (
    ("jumps", _JUMPS, "20 s, jump of 5 ms"),
    ("reached", _REACHED, "5 px drone, davis346"),
    ("reached", _REACHED, "5 px drone, davis346, noise 10 Hz/px"),
    ("reached", _REACHED, "82 s, skew 50 ppm"),
    ("rms", _RMS_MS, "20 s, clocks alike"),
    ("rms", _RMS_MS, "20 s, clocks alike, no skew looked for"),
)


STUDIES = (
    Study(
        "marks",
        "Clutter, clocks and intrinsics of real recordings, each kind beside its mark",
        required_cells,
        Measure(imperfect.load_flown, required_row, RequiredRow),
        Runs("marks_runs.csv", ("kind", "flight"), took=("cpu_s",)),
        (made_of("marks.csv", required_table, "marks_runs"),),
        numbers={
            "table.marks.sensitivity": sensitivity_table,
            "marks.flights.10_s": lambda _: str(FLIGHTS["10 s"]),
            **{
                f"marks.{what}.{re.sub(',? ', '_', kind)}": quoted("marks", form, kind=kind)
                for what, form, kind in _QUOTED
            },
        },
        config={"flights": dict(FLIGHTS), "few": FEW, "first_flight": FIRST_FLIGHT,
                "angles_deg": ANGLES_DEG, "kinds": list(KINDS), "method": METHOD},
    ),
)  # fmt: skip
