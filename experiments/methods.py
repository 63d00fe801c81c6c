"""The registry of methods: a name in; the callable, and what it must be given, out.

To add a method is to add one line to METHODS. All callables have the signature of
`ssac.interface`: `estimate(cam1, cam2, rig, config) -> Estimate`.
"""

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

from ssac import (
    Config,
    Estimate,
    Observation,
    Rig,
    SsacError,
    albl,
    event_rate,
    joint,
    joint_known,
    ssac,
    ssac_known,
    zncc_e,
    zncc_f,
)


class Input(Enum):
    """What a method looks at."""

    TRACKS = "object tracks"
    RATES = "event rates"
    FRAMES = "intensity frames"


@dataclass(frozen=True)
class Method:
    """One way to find the offset, and perhaps the pose."""

    name: str
    estimate: Callable[[Observation, Observation, Rig, Config | None], Estimate]
    input: Input
    summary: str  # for lists and error messages
    needs_extrinsics: bool = False  # the rig must have T_2_1
    known_variant: str = ""  # name of the method to take in its place when the extrinsics are known

    def skip_reason(self, cam1: Observation, cam2: Observation, rig: Rig) -> str:
        """Say why the method cannot run on these data; empty when it can."""
        if self.needs_extrinsics and rig.T_2_1 is None:
            return f"{self.name} needs the extrinsics, but the rig has none"
        for number, observation in enumerate((cam1, cam2), start=1):
            if self.input is Input.FRAMES and observation.frames is None:
                return f"{self.name} compares intensity frames, but camera {number} has none"
        return ""


_ALL = (
    Method("joint", joint, Input.TRACKS, "ssac, then offset and pose refined together",
           known_variant="joint-known"),
    Method("joint-known", joint_known, Input.TRACKS, "ssac-known, then the offset refined",
           needs_extrinsics=True),
    Method("ssac", ssac, Input.TRACKS, "the paper's Algorithm 2", known_variant="ssac-known"),
    Method("ssac-known", ssac_known, Input.TRACKS, "the paper's Algorithm 1",
           needs_extrinsics=True),
    Method("albl", albl, Input.TRACKS, "eigenvalue solver of Albl et al. (2017)"),
    Method("zncc_e", zncc_e, Input.RATES, "correlation of event rates, offset only"),
    Method("zncc_f", zncc_f, Input.FRAMES, "correlation of frame changes, offset only"),
    Method("event_rate", event_rate, Input.RATES, "event rates, Censi and Scaramuzza (2014)"),
)  # fmt: skip

METHODS: dict[str, Method] = {method.name: method for method in _ALL}

DEFAULT = "joint"
"""The most accurate method for unknown extrinsics; its `known_variant` is that for known ones."""


def choose_method(name: str | None = None, known_extrinsics: bool = False) -> Method:
    """Look up a method.

    Parameters
    ----------
    name
        Of the registry; None for the best one.
    known_extrinsics
        Take the variant of the method that is given the extrinsics.

    Raises
    ------
    SsacError
        If there is no such method, or no variant of it that is given the extrinsics.
    """
    method = METHODS.get(DEFAULT if name is None else name)
    if method is None:
        raise SsacError(f"unknown method {name!r}: use one of {', '.join(METHODS)}")
    if not known_extrinsics or method.needs_extrinsics:
        return method
    if not method.known_variant:
        usable = [other.name for other in _ALL if other.needs_extrinsics]
        raise SsacError(
            f"{method.name} makes no use of known extrinsics: leave --known-extrinsics out, or use "
            f"one of {', '.join(usable)}"
        )
    return METHODS[method.known_variant]
