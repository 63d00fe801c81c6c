"""Synchronise and calibrate two event cameras from the motion of one object.

    import ssac

    result = ssac.sync("cam1.h5", "cam2.h5", "rig.yaml")
    print(result.summary())
    result.t_d_s, result.R, result.t

Nothing here knows the truth. All that a method of your own needs is here too: see docs/methods.md.

A name is imported when it is first asked for, so that a command line that only prints its help, or
a caller that only reads files, does not wait for compilers and solvers.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    __version__: str
    from ssac.camera import Camera, Cameras, Rig
    from ssac.clock import Clock
    from ssac.config import Config, checked
    from ssac.errors import PluginError, SsacError
    from ssac.estimate import ClockJump, Estimate, Status
    from ssac.events import EVENT_DTYPE, EventFile
    from ssac.files.damage import Reading
    from ssac.files.event_files import load_events
    from ssac.files.rigs import load_rig
    from ssac.files.track_files import load_track
    from ssac.methods.correlations import (
        Signal,
        binned,
        correlation_estimate,
        counted,
        lags_of,
        zncc,
    )
    from ssac.pipeline.answer import Answer
    from ssac.pipeline.api import (
        Result,
        albl,
        event_rate,
        joint,
        joint_known,
        ssac_known,
        sync,
        tangency,
        tangency_known,
        two_views,
        usable_events,
        zncc_e,
        zncc_f,
    )
    from ssac.pipeline.api import (
        ssac as ssac,
    )
    from ssac.pipeline.chain import Chain
    from ssac.pipeline.many_report import NetworkResult
    from ssac.pipeline.opened import Known
    from ssac.pipeline.registry import Input, Method
    from ssac.points import PointTrack
    from ssac.search.two_views import Pairs, PairsAt, TwoViews
    from ssac.track.motion import ObjectMotion
    from ssac.track.observation import Observation

__all__ = [
    "EVENT_DTYPE",
    "Answer",
    "Camera",
    "Cameras",
    "Chain",
    "Clock",
    "ClockJump",
    "Config",
    "Estimate",
    "EventFile",
    "Input",
    "Known",
    "Method",
    "NetworkResult",
    "ObjectMotion",
    "Observation",
    "Pairs",
    "PairsAt",
    "PluginError",
    "PointTrack",
    "Reading",
    "Result",
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
    "joint_known",
    "lags_of",
    "load_events",
    "load_rig",
    "load_track",
    "ssac_known",
    "sync",
    "tangency",
    "tangency_known",
    "two_views",
    "usable_events",
    "zncc",
    "zncc_e",
    "zncc_f",
]
"""The module's own name is left alone: the paper's method is `ssac.ssac`."""

_HOMES = {
    "ssac.methods.correlations": "Signal binned correlation_estimate counted lags_of zncc",
    "ssac.camera": "Camera Cameras Rig",
    "ssac.clock": "Clock",
    "ssac.config": "Config checked",
    "ssac.errors": "PluginError SsacError",
    "ssac.estimate": "ClockJump Estimate Status",
    "ssac.events": "EVENT_DTYPE EventFile",
    "ssac.files.damage": "Reading",
    "ssac.files.event_files": "load_events",
    "ssac.files.rigs": "load_rig",
    "ssac.files.track_files": "load_track",
    "ssac.pipeline.answer": "Answer",
    "ssac.pipeline.api": "Result albl event_rate joint joint_known ssac ssac_known"
    " sync tangency tangency_known two_views usable_events zncc_e zncc_f",
    "ssac.pipeline.chain": "Chain",
    "ssac.pipeline.opened": "Known",
    "ssac.pipeline.many_report": "NetworkResult",
    "ssac.pipeline.registry": "Input Method",
    "ssac.points": "PointTrack",
    "ssac.search.two_views": "Pairs PairsAt TwoViews",
    "ssac.track.motion": "ObjectMotion",
    "ssac.track.observation": "Observation",
}
"""Where the public names are defined, as above."""


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


if not TYPE_CHECKING:  # where types are checked, a name that is not above is an error

    def __getattr__(name: str) -> object:
        if name == "__version__":
            return import_module("importlib.metadata").version("ssac-suite")
        for home, names in _HOMES.items():
            if name in names.split():
                return getattr(import_module(home), name)
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
