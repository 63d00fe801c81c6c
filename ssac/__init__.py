"""Synchronise and calibrate two event cameras from the motion of one object.

Events and intrinsics in, time offset and relative pose out; nothing here knows the truth.

A name is imported when it is first asked for, so that a command line that only prints its help, or
a caller that only reads files, does not wait for compilers and solvers.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ssac.baselines.albl import albl
    from ssac.baselines.event_rate import event_rate
    from ssac.baselines.zncc_e import zncc_e
    from ssac.baselines.zncc_f import zncc_f
    from ssac.camera import Camera, Rig
    from ssac.config import Config
    from ssac.errors import SsacError
    from ssac.estimate import Estimate
    from ssac.events import EVENT_DTYPE
    from ssac.methods.algorithms import ssac, ssac_known
    from ssac.methods.joint import joint, joint_from, joint_known, joint_known_from
    from ssac.methods.tangency import tangency, tangency_from, tangency_known, tangency_known_from
    from ssac.track.observation import Observation, prepare

__all__ = [
    "EVENT_DTYPE",
    "Camera",
    "Config",
    "Estimate",
    "Observation",
    "Rig",
    "SsacError",
    "albl",
    "event_rate",
    "joint",
    "joint_from",
    "joint_known",
    "joint_known_from",
    "prepare",
    "ssac",
    "ssac_known",
    "tangency",
    "tangency_from",
    "tangency_known",
    "tangency_known_from",
    "zncc_e",
    "zncc_f",
]

_HOMES = {
    "ssac.baselines.albl": "albl",
    "ssac.baselines.event_rate": "event_rate",
    "ssac.baselines.zncc_e": "zncc_e",
    "ssac.baselines.zncc_f": "zncc_f",
    "ssac.camera": "Camera Rig",
    "ssac.config": "Config",
    "ssac.errors": "SsacError",
    "ssac.estimate": "Estimate",
    "ssac.events": "EVENT_DTYPE",
    "ssac.methods.algorithms": "ssac ssac_known",
    "ssac.methods.joint": "joint joint_from joint_known joint_known_from",
    "ssac.methods.tangency": "tangency tangency_from tangency_known tangency_known_from",
    "ssac.track.observation": "Observation prepare",
}
"""Where the public names are defined, as above."""


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


if not TYPE_CHECKING:  # where types are checked, a name that is not above is an error

    def __getattr__(name: str) -> object:
        for home, names in _HOMES.items():
            if name in names.split():
                return getattr(import_module(home), name)
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
