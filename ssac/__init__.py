"""Synchronise and calibrate two event cameras from the motion of one object.

Events and intrinsics in, time offset and relative pose out; nothing here knows the truth. All that
a method of your own needs is here too: see docs/methods.md.

A name is imported when it is first asked for, so that a command line that only prints its help, or
a caller that only reads files, does not wait for compilers and solvers.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ssac.baselines.albl import albl
    from ssac.baselines.correlation import (
        Signal,
        binned,
        correlation_estimate,
        counted,
        lags_of,
        zncc,
    )
    from ssac.baselines.event_rate import event_rate
    from ssac.baselines.zncc_e import zncc_e
    from ssac.baselines.zncc_f import zncc_f
    from ssac.camera import Camera, Rig
    from ssac.clock import Clock
    from ssac.config import Config, checked
    from ssac.errors import SsacError
    from ssac.estimate import ClockJump, Estimate, Status
    from ssac.events import EVENT_DTYPE
    from ssac.methods.algorithms import ssac, ssac_known
    from ssac.methods.joint import joint, joint_from, joint_known
    from ssac.methods.tangency import tangency, tangency_from, tangency_known
    from ssac.search.one_object import OneObject, one_object
    from ssac.search.two_views import Pairs, PairsAt, TwoViews, two_views
    from ssac.track.motion import ObjectMotion
    from ssac.track.observation import Observation, prepare, usable_events

__all__ = [
    "EVENT_DTYPE",
    "Camera",
    "Clock",
    "ClockJump",
    "Config",
    "Estimate",
    "ObjectMotion",
    "Observation",
    "OneObject",
    "Pairs",
    "PairsAt",
    "Rig",
    "Signal",
    "SsacError",
    "Status",
    "TwoViews",
    "albl",
    "binned",
    "checked",
    "correlation_estimate",
    "counted",
    "event_rate",
    "joint",
    "joint_from",
    "joint_known",
    "lags_of",
    "one_object",
    "prepare",
    "ssac",
    "ssac_known",
    "tangency",
    "tangency_from",
    "tangency_known",
    "two_views",
    "usable_events",
    "zncc",
    "zncc_e",
    "zncc_f",
]

_HOMES = {
    "ssac.baselines.albl": "albl",
    "ssac.baselines.correlation": "Signal binned correlation_estimate counted lags_of zncc",
    "ssac.baselines.event_rate": "event_rate",
    "ssac.baselines.zncc_e": "zncc_e",
    "ssac.baselines.zncc_f": "zncc_f",
    "ssac.camera": "Camera Rig",
    "ssac.clock": "Clock",
    "ssac.config": "Config checked",
    "ssac.errors": "SsacError",
    "ssac.estimate": "ClockJump Estimate Status",
    "ssac.events": "EVENT_DTYPE",
    "ssac.methods.algorithms": "ssac ssac_known",
    "ssac.methods.joint": "joint joint_from joint_known",
    "ssac.methods.tangency": "tangency tangency_from tangency_known",
    "ssac.search.one_object": "OneObject one_object",
    "ssac.search.two_views": "Pairs PairsAt TwoViews two_views",
    "ssac.track.motion": "ObjectMotion",
    "ssac.track.observation": "Observation prepare usable_events",
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
