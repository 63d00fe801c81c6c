"""The registry of methods: by a name, what runs, and what it must be given.

To add a method of ours is to add one line to OURS, and one to `summaries.SUMMARIES`. Any installed
package adds its own by an entry point of the group `ssac.methods` (docs/methods.md). What runs is
imported when it is asked for, so that nobody waits for the others.
"""

import hashlib
import inspect
import re
import sys
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from functools import cached_property
from importlib import import_module
from importlib.machinery import EXTENSION_SUFFIXES, SOURCE_SUFFIXES
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any

import numpy as np

from ssac.camera import Rig
from ssac.config import Config
from ssac.errors import PluginError, SsacError
from ssac.estimate import Estimate, Status
from ssac.pipeline.summaries import DEFAULT, ENTRY_POINTS, OF_TRACKS, SUMMARIES
from ssac.track.observation import Observation

EstimateFunction = Callable[[Observation, Observation, Rig, Config | None], Estimate]

_STATUS = re.compile(r"[a-z][a-z0-9_]*")
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]*")  # what a CSV column and a file name can hold


class Input(Enum):
    """What a method looks at."""

    TRACKS = "object tracks"
    RATES = "event rates"
    FRAMES = "intensity frames"


@dataclass(frozen=True)
class Method:
    """One way to find the offset, and perhaps the pose."""

    name: str
    estimate: EstimateFunction | None  # another package's; None: ours, which `runs` names
    input: Input
    summary: str  # for lists and error messages
    needs_extrinsics: bool = False  # the rig must have T_2_1, which no other method is shown
    known_variant: str = ""  # name of the method to take in its place when the extrinsics are known
    version: str = ""  # of another package's code, for keys of cached results; empty for ours
    runs: str = ""
    """Ours, as "module:function": of an estimate and the views that it was found in, where it
    `starts_from` another method; else of the views, or of both cameras and the config."""
    starts_from: str = ""  # method whose estimate it refines
    keeps_start: str = ""  # "module:function": of which views that estimate is the answer
    takes_means: bool = False  # of the frames: images of one pixel give the same estimate
    follows_clock: bool = False  # what camera 2's clock shows more, t_d gains: nothing else changes
    counts: str = "pairs of positions"  # what an estimate's `n_samples` are
    needs_events: bool = False  # a track of points in their place is not enough
    finds_readout: bool = False  # of a rolling shutter that the rig does not state
    of_one_object: bool = False  # of several things that move, it is given the events of one

    def rig_of(self, rig: Rig) -> Rig:
        """Give the rig as the method may see it: only one that needs the extrinsics gets them."""
        return rig if self.needs_extrinsics else rig.unposed

    @property
    def function(self) -> Callable[..., Estimate]:
        """What `runs` names."""
        found: Callable[..., Estimate] = _named(self.runs)
        return found

    def load(self) -> None:
        """Import what runs, of this method and of those that it starts from."""
        if self.runs:
            _named(self.runs)
        if self.starts_from:
            METHODS[self.starts_from].load()

    def keeps(self, views: Any) -> bool:
        """Whether the answer for these views is the estimate that it starts from."""
        return bool(self.keeps_start and _named(self.keeps_start)(views))

    @property
    def without_tracks(self) -> str:
        """Say why the method cannot use a track of points; empty when it can."""
        if self.input is Input.TRACKS and not self.needs_events:
            return ""
        needs = "events" if self.input is Input.TRACKS else self.input.value
        return f"{self.name} needs {needs}, which a track has not: use {OF_TRACKS}"

    def lacks(
        self, seen: Sequence[tuple[str, bool]], rig: Rig, rig_name: str, config: Config
    ) -> str:
        """Say what the method lacks to run at all; empty when it can.

        Parameters
        ----------
        seen
            Of both cameras a name, and whether it gave a track of points.
        rig, rig_name
            Theirs, and what to call it.
        config
            Of the method.
        """
        for name, has_track in seen:
            if has_track and self.without_tracks:
                return f"{name}: is a track of points; {self.without_tracks}"
        if self.needs_extrinsics and rig.T_2_1 is None:
            return (
                f"{rig_name}: {self.name} needs the extrinsics (T_cn_cnm1 of cam1 in a Kalibr file,"
                " R and T in OpenCV's): add them, or leave --known-extrinsics out"
            )
        for (_, has_track), camera in zip(seen, (rig.cam1, rig.cam2), strict=True):
            if has_track and camera.readout_std_s and not self.finds_readout:
                asked = "a readout is to be estimated (--estimate-readout)"
                return f"{asked}, and {self.name} takes shutters as the rig says: use {OF_TRACKS}"
        if (config.search == "all" or config.rates) and self.input is not Input.TRACKS:
            return (
                f"{self.name} compares {self.input.value}, and all offsets are searched with the"
                " object's path: give an interval (--search), or another method"
            )
        return ""

    def without_frames(self, name: str) -> str:
        """Say that a camera of that name has no intensity frames."""
        return (
            f"{name}: {self.name} compares intensity frames, and there are none: use a method for"
            f" events, such as {DEFAULT}"
        )


def _named(place: str) -> Any:
    """Import what "module:function" names."""
    module, _, name = place.partition(":")
    return getattr(import_module(module), name)


def _ours(name: str, runs: str, **says: Any) -> Method:
    return Method(name, None, says.pop("input", Input.TRACKS), SUMMARIES[name], runs=runs, **says)


_TRACKS: dict[str, Any] = {"follows_clock": True, "of_one_object": True}
_KNOWN = {**_TRACKS, "needs_extrinsics": True}
_TANGENTS: dict[str, Any] = {
    "counts": "pairs of tangents to the object's outline",
    "needs_events": True,
    "keeps_start": "ssac.methods.tangency:is_tiny",
}
_REFINED = "ssac.methods.joint:joint_from"
_TANGENCY = "ssac.methods.tangency:tangency_from"

OURS = (
    _ours("ssac", "ssac.methods.algorithms:algorithm_2", known_variant="ssac-known", **_TRACKS),
    _ours("ssac-known", "ssac.methods.algorithms:algorithm_1", **_KNOWN),
    _ours("joint", _REFINED, known_variant="joint-known", starts_from="ssac",
          finds_readout=True, **_TRACKS),
    _ours("joint-known", _REFINED, starts_from="ssac-known", finds_readout=True, **_KNOWN),
    _ours("tangency", _TANGENCY, known_variant="tangency-known", starts_from="joint",
          **_TRACKS, **_TANGENTS),
    _ours("tangency-known", _TANGENCY, starts_from="joint-known", **_KNOWN, **_TANGENTS),
    _ours("albl", "ssac.methods.albl:albl_of_views"),
    _ours("zncc_e", "ssac.methods.correlations:zncc_e_of_events", input=Input.RATES),
    _ours("zncc_f", "ssac.methods.correlations:zncc_f_of_frames", input=Input.FRAMES,
          takes_means=True),
    _ours("event_rate", "ssac.methods.correlations:event_rate_of_events", input=Input.RATES),
)  # fmt: skip


class Registry(Mapping[str, Method]):
    """Our methods in their order, then those of other packages by name.

    A package is imported when its method is looked up, so that a broken one stops nobody who does
    not ask for it. The lookup raises SsacError when it is broken or its name is taken.
    """

    def __init__(self) -> None:
        self._ours = {method.name: method for method in OURS}
        self._loaded: dict[str, Method] = {}

    def __iter__(self) -> Iterator[str]:
        yield from self._ours
        yield from sorted(self._entry_points.keys() - self._ours.keys())

    def __len__(self) -> int:
        return len(self._ours.keys() | self._entry_points.keys())

    def __contains__(self, name: object) -> bool:
        return name in self._ours or name in self._entry_points

    def __getitem__(self, name: str) -> Method:
        if name not in self._loaded:
            self._loaded[name] = self._load(name)
        return self._loaded[name]

    @cached_property
    def _entry_points(self) -> dict[str, list[EntryPoint]]:
        found: dict[str, list[EntryPoint]] = {}
        for entry in entry_points(group=ENTRY_POINTS):
            found.setdefault(entry.name, []).append(entry)
        return found

    def _load(self, name: str) -> Method:
        entries = self._entry_points.get(name, [])
        owners = ["this suite"] * (name in self._ours) + sorted(map(_origin, entries))
        if not owners:
            raise KeyError(name)
        if len(owners) > 1:
            raise SsacError(
                f"the method name {name!r} is taken twice, by {' and by '.join(owners)}: "
                "uninstall one, or change its entry point's name"
            )
        return self._ours[name] if name in self._ours else _method_from(entries[0])


METHODS: Mapping[str, Method] = Registry()


def choose_method(
    name: str | None = None, known_extrinsics: bool = False, has_track: bool = False
) -> Method:
    """Look up a method.

    Parameters
    ----------
    name
        Of the registry; None for the best one.
    known_extrinsics
        Take the variant of the method that is given the extrinsics.
    has_track
        A camera gave a track of points: the best one is another then.

    Raises
    ------
    SsacError
        If there is no such method, or no variant of it that is given the extrinsics, or the package
        that it comes from is broken.
    """
    name = (OF_TRACKS if has_track else DEFAULT) if name is None else name
    method = METHODS.get(name) if isinstance(name, str) else None
    if method is None:
        raise SsacError(f"unknown method {name!r}: use one of {', '.join(METHODS)}")
    if not known_extrinsics or method.needs_extrinsics:
        return method
    if not method.known_variant:
        usable = [other.name for other in OURS if other.needs_extrinsics]
        raise SsacError(
            f"{method.name} makes no use of known extrinsics: leave --known-extrinsics out, or use "
            f"one of {', '.join(usable)}"
        )
    variant = METHODS.get(method.known_variant)
    if variant is None or not variant.needs_extrinsics:
        raise SsacError(
            f"{method.name} names {method.known_variant!r} as its variant for known extrinsics, "
            "which is no method with needs_extrinsics"
        )
    return variant


@dataclass(frozen=True, eq=False)  # since the function need not be hashable
class _CheckedFunction:
    """Another package's method; what it raises or returns amiss is said to be that package's."""

    function: EstimateFunction
    origin: str
    home: Path  # folder of the package, or its only file

    def __call__(
        self, cam1: Observation, cam2: Observation, rig: Rig, config: Config | None = None
    ) -> Estimate:
        try:
            estimate = self.function(cam1, cam2, rig, config)
        except SsacError:
            raise
        except Exception as error:
            raise PluginError(
                f"{self.origin}: {type(error).__name__}: {error} ({self._place(error)}): a bug of"
                " that package"
            ) from error
        fault = _fault_of(estimate)
        if fault:
            raise PluginError(f"{self.origin}: {fault} ({self.home}): a bug of that package")
        return estimate

    def _place(self, error: Exception) -> str:
        """Say in which line of that package an error arose, or was let through."""
        frames = traceback.extract_tb(error.__traceback__)
        theirs = [frame for frame in frames if _is_within(Path(frame.filename), self.home)]
        return f"{theirs[-1].filename}, line {theirs[-1].lineno}" if theirs else str(self.home)


def _is_within(file: Path, home: Path) -> bool:
    return file == home or home in file.parents


def _fault_of(estimate: object) -> str:
    """Say what is wrong with what a method returned; it would spoil a table in silence."""
    if not isinstance(estimate, Estimate):
        return f"must return an Estimate, got {type(estimate).__name__}"
    if not _STATUS.fullmatch(estimate.status):
        return (
            f"returned the status {str(estimate.status)!r}: give one word of ssac.Status, or of"
            f" your own, that matches {_STATUS.pattern}"
        )
    if estimate.status == Status.OK and not np.isfinite(estimate.t_d_s):
        return (
            f'returned t_d_s = {estimate.t_d_s} with status "ok": give the reason\'s name as the'
            " status when there is no offset"
        )
    return ""


def _method_from(entry: EntryPoint) -> Method:
    """Import what an entry point names, a Method or a plain function, and make a Method of it."""
    origin = _origin(entry)
    try:
        found = entry.load()
    except Exception as error:  # whatever the import of someone else's code may raise
        raise SsacError(f"{origin}: {type(error).__name__}: {error}") from error
    if not _NAME.fullmatch(entry.name):
        raise SsacError(f"{origin}: a method's name must match {_NAME.pattern}")
    if not isinstance(found, Method):
        summary = (inspect.getdoc(found) or "").partition("\n")[0].strip() or origin
        found = Method(entry.name, found, Input.TRACKS, summary)
    if found.name != entry.name:
        raise SsacError(f"{origin}: the Method is named {found.name!r}: give both one name")
    if not isinstance(found.input, Input):
        raise SsacError(f"{origin}: input must be a member of ssac.Input, got {found.input!r}")
    function = found.estimate
    try:
        inspect.signature(function).bind(None, None, None, None)  # type: ignore[arg-type]
    except (TypeError, ValueError) as error:
        raise SsacError(
            f"{origin}: expected a function of (cam1, cam2, rig, config) or a Method of one, "
            f"got {type(function).__name__} ({error})"
        ) from error
    assert function is not None  # whose signature was bound
    return replace(
        found,
        estimate=_CheckedFunction(function, origin, _home(entry)),
        runs="",  # which are ours alone
        starts_from="",
        keeps_start="",
        version=" ".join(filter(None, (_distribution(entry), _code_hash(entry), found.version))),
    )


def _origin(entry: EntryPoint) -> str:
    """Name an entry point for an error message."""
    return f"{_distribution(entry)} (entry point {entry.name} = {entry.value})"


def _distribution(entry: EntryPoint) -> str:
    return f"{entry.dist.name} {entry.dist.version}" if entry.dist else "an unnamed package"


def _home(entry: EntryPoint) -> Path:
    """Give the folder of an imported entry point's top-level package, or its only file."""
    top = sys.modules[entry.module.partition(".")[0]]
    if getattr(top, "__file__", None) is None:  # a namespace package, which many may share
        top = sys.modules[entry.module]
    file = Path(getattr(top, "__file__", None) or entry.module)
    return file.parent if file.name == "__init__.py" else file


def _code_hash(entry: EntryPoint) -> str:
    """Hash an imported entry point's whole top-level package: its version says nothing of edits."""
    home, suffixes = _home(entry), (*SOURCE_SUFFIXES, *EXTENSION_SUFFIXES)
    within = sorted(home.rglob("*")) if home.is_dir() else [home]
    files = [path for path in within if path.is_file() and path.name.endswith(suffixes)]
    digest = hashlib.sha256()
    for path in files:
        content = path.read_bytes()
        digest.update(f"{path.relative_to(home.parent).as_posix()} {len(content)}\n".encode())
        digest.update(content)
    return digest.hexdigest()[:16] if files else ""
