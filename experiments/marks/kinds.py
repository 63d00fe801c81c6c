"""A kind of recording by its name in; how it is filmed, spoilt and judged out.

In three groups: what else fires or moves in view, what the clocks do, and what the rig file says of
the cameras. What spoils a recording is the same in all of a kind; where it lies is drawn.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from experiments.measures.imperfect_kinds import CARELESS, GOOD, ORDINARY, SCENES
from sim.disturb import DisturbConfig
from sim.recorded import Jump
from sim.recording import SimConfig
from sim.scene.trajectory import SplineConfig

CLUTTER, CLOCKS, INTRINSICS = "clutter", "clocks", "intrinsics"

Errors = tuple[float, float, float, float]
"""By which a camera's fu and fv are too long, as shares, and its pu and pv too large [px]."""

RIGHT: Errors = (0.0, 0.0, 0.0, 0.0)
_LONG: Errors = (0.01, 0.01, 0.0, 0.0)
_OFF: Errors = (0.0, 0.0, 3.0, 2.0)

JUMP_AT_S = 8.0
LONG_S = 82.0


@dataclass(frozen=True)
class Mark:
    """The largest errors that answers of a kind may have, and whether there may be none."""

    t_d_ms: float = np.inf
    r_deg: float = np.inf
    skew_ppm: float = np.inf
    may_refuse: bool = False  # a refusal that says why is as good
    must_refuse: bool = False  # no answer is right


@dataclass(frozen=True)
class Kind:
    """One kind of recording."""

    group: str
    scene: str  # of FILMED
    disturb: DisturbConfig = field(default_factory=DisturbConfig)
    others: bool = False  # camera 2 sees another flight than camera 1
    skew_ppm: float = 0.0
    jump: Jump | None = None
    skew_prior_ppm: float | None = None  # of the method; None: its own
    errors: tuple[Errors, Errors] = (RIGHT, RIGHT)  # of the rig's intrinsics
    stated: tuple[float, float] | None = None  # deviations of them: focal lengths [%], centres [px]
    mark: Mark | None = None

    @property
    def needs_other(self) -> bool:
        """Whether another flight is in its recordings."""
        return self.others or self.disturb.second_object > 0.0


def _filmed() -> dict[str, SimConfig]:
    """List what is filmed."""
    plain = SCENES[ORDINARY]
    return {
        "10 s": replace(plain, spline=SplineConfig(10.0)),
        "20 s": plain,
        "5 px, davis346": SCENES["5 px, davis346"],
        "82 s": replace(plain, spline=SplineConfig(LONG_S)),
    }


FILMED: Mapping[str, SimConfig] = _filmed()

_NEAR = Mark(t_d_ms=0.3, may_refuse=True)
_TOLD = Mark(t_d_ms=0.1, skew_ppm=3.0)
_REFUSED = Mark(must_refuse=True)

_CLUTTERED = {
    "nothing": DisturbConfig(),
    "lamp 6 px": DisturbConfig(lamp_px=6),
    "lamp 12 px": DisturbConfig(lamp_px=12),
    "5 hot clusters": DisturbConfig(hot_clusters=5),
    "branches, 0.5 M events": DisturbConfig(branches=500_000),
    "second drone 10 %": DisturbConfig(second_object=0.1),
    "second drone 20 %": DisturbConfig(second_object=0.2),
    "second drone 100 %": DisturbConfig(second_object=1.0),
    "noise 10 Hz/px": DisturbConfig(noise_hz=10.0),
}

_ONE = "of one camera"
_BOTH = "of both cameras"

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
"""Errors that the rig file says nothing of, by what they are."""


def _clutter() -> dict[str, Kind]:
    noisy = DisturbConfig(noise_hz=10.0)
    return {
        **{
            name: Kind(
                CLUTTER, "10 s", disturb, mark=_NEAR
            )
            for name, disturb in _CLUTTERED.items()
        },
        "5 px drone, davis346": Kind(
            CLUTTER, "5 px, davis346", mark=Mark(t_d_ms=0.1, r_deg=0.3)
        ),
        "5 px drone, davis346, noise 10 Hz/px": Kind(
            CLUTTER, "5 px, davis346", noisy, mark=_NEAR
        ),
        "other flights, noise 10 Hz/px": Kind(
            CLUTTER, "20 s", noisy, others=True, mark=_REFUSED
        ),
    }  # fmt: skip


def _clocks() -> dict[str, Kind]:
    skews = {
        f"82 s, skew {ppm:g} ppm": Kind(CLOCKS, "82 s", skew_ppm=ppm, mark=_TOLD)
        for ppm in (20.0, 50.0)
    }
    jumps = {
        f"20 s, jump of {ms:g} ms": Kind(CLOCKS, "20 s", jump=(JUMP_AT_S, 1e-3 * ms), mark=_REFUSED)
        for ms in (5.0, 20.0)
    }
    return {
        "20 s, clocks alike": Kind(CLOCKS, "20 s"),
        "20 s, clocks alike, no skew looked for": Kind(CLOCKS, "20 s", skew_prior_ppm=0.0),
        **skews,
        "82 s, skew 50 ppm, none looked for": Kind(
            CLOCKS, "82 s", skew_ppm=50.0, skew_prior_ppm=0.0
        ),
        **jumps,
    }


def _intrinsics() -> dict[str, Kind]:
    def one(errors: tuple[Errors, Errors], stated: tuple[float, float]) -> Kind:
        return Kind(INTRINSICS, "10 s", errors=errors, stated=stated)

    long, off, right = (_LONG, _LONG), (_OFF, _OFF), (RIGHT, RIGHT)
    return {
        "right, stated 0.1 %, 0.3 px": one(right, GOOD),
        "focal lengths 1 % long, stated 1 %, 3 px": one(long, CARELESS),
        "focal lengths 1 % long, stated 0.1 %, 0.3 px": one(long, GOOD),
        "centres (3, 2) px off, stated 1 %, 3 px": one(off, CARELESS),
        "centres (3, 2) px off, stated 0.1 %, 0.3 px": one(off, GOOD),
        **{
            f"drawn from {focal:g} %, {centre:g} px": Kind(
                INTRINSICS, "10 s", DisturbConfig(intrinsics_error=(focal, centre))
            )
            for focal, centre in (GOOD, CARELESS)
        },
        **{name: Kind(INTRINSICS, "10 s", errors=errors) for name, errors in UNSTATED.items()},
    }


KINDS: Mapping[str, Kind] = {**_clutter(), **_clocks(), **_intrinsics()}
"""By name, group by group; kinds of one scene are made of the same flights."""
