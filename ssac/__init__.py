"""Synchronise and calibrate two event cameras from the motion of one object.

    import ssac

    result = ssac.sync("cam1.h5", "cam2.h5", "rig.yaml")
    print(result.summary())
    result.t_d_s, result.R, result.t

Nothing here knows the ground truth. A method of your own finds all it needs here: docs/methods.md.

A name is imported when it is first used, so that help texts do not wait for compilers and solvers.
"""

import re
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # the list of public names, which is read below too
    __version__: str
    from ssac.camera import Camera as Camera
    from ssac.camera import Cameras as Cameras
    from ssac.camera import Rig as Rig
    from ssac.clock import Clock as Clock
    from ssac.config import Config as Config
    from ssac.config import checked as checked
    from ssac.errors import PluginError as PluginError
    from ssac.errors import SsacError as SsacError
    from ssac.estimate import ClockJump as ClockJump
    from ssac.estimate import Estimate as Estimate
    from ssac.estimate import Status as Status
    from ssac.events import EVENT_DTYPE as EVENT_DTYPE
    from ssac.events import EventFile as EventFile
    from ssac.files.damage import Reading as Reading
    from ssac.files.event_files import load_events as load_events
    from ssac.files.rigs import load_rig as load_rig
    from ssac.files.track_files import load_track as load_track
    from ssac.methods.correlations import Signal as Signal
    from ssac.methods.correlations import binned as binned
    from ssac.methods.correlations import correlation_estimate as correlation_estimate
    from ssac.methods.correlations import counted as counted
    from ssac.methods.correlations import lags_of as lags_of
    from ssac.methods.correlations import zncc as zncc
    from ssac.methods.method import Input as Input
    from ssac.methods.method import Method as Method
    from ssac.pipeline.answer import Answer as Answer
    from ssac.pipeline.api import Result as Result
    from ssac.pipeline.api import sync as sync
    from ssac.pipeline.api import two_views as two_views
    from ssac.pipeline.api import usable_events as usable_events
    from ssac.pipeline.chain import Chain as Chain
    from ssac.pipeline.many import NetworkResult as NetworkResult
    from ssac.pipeline.opened import Known as Known
    from ssac.pipeline.registry import EstimateFunction as _Function
    from ssac.points import PointTrack as PointTrack
    from ssac.search.two_views import Pairs as Pairs
    from ssac.search.two_views import PairsAt as PairsAt
    from ssac.search.two_views import TwoViews as TwoViews
    from ssac.track.motion import ObjectMotion as ObjectMotion
    from ssac.track.observation import Observation as Observation

    # Functions of these methods, for type checkers; every other method has one too.
    ssac: _Function
    albl: _Function
    event_rate: _Function
    joint: _Function
    joint_known: _Function
    ssac_known: _Function
    tangency: _Function
    tangency_known: _Function
    zncc_e: _Function
    zncc_f: _Function


@cache
def _homes() -> dict[str, str]:
    """Read from this file in which module each public name is defined."""
    text = Path(__file__).read_text(encoding="utf-8")
    return {name: module for module, name in re.findall(r"from (\S+) import (\w+) as \2\n", text)}


def _names() -> list[str]:
    """List all public names, but not the method `ssac.ssac`, which has the package's name."""
    return sorted({*_homes(), *_functions()} - {"ssac"})


def _functions() -> dict[str, Any]:
    from ssac.methods.method import our_methods

    return {method.name.replace("-", "_"): method for method in our_methods()}


def __dir__() -> list[str]:
    return sorted({*globals(), *_names()})


if not TYPE_CHECKING:  # a type checker reports names that are not listed above

    def __getattr__(name: str) -> object:
        if name == "__all__":
            return _names()
        if name == "__version__":
            return import_module("importlib.metadata").version("ssac-suite")
        if name in _homes():
            return getattr(import_module(_homes()[name]), name)
        if name in _functions():
            return import_module("ssac.pipeline.api").function_of(_functions()[name])
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
