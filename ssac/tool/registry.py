"""The registry of methods: a name in; the callable, and what it must be given, out.

To add a method of ours is to add one line to OURS, and one to `summaries.SUMMARIES`. Any installed
package adds its own by an entry point of the group `ssac.methods` (docs/methods.md). All callables
are called as `ssac.methods.algorithms.ssac` is: `estimate(cam1, cam2, rig, config) -> Estimate`.
"""

import hashlib
import inspect
import re
import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from enum import Enum
from functools import cached_property
from importlib.machinery import EXTENSION_SUFFIXES, SOURCE_SUFFIXES
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path

import numpy as np

from ssac.baselines.albl import albl
from ssac.baselines.event_rate import event_rate
from ssac.baselines.zncc_e import zncc_e
from ssac.baselines.zncc_f import zncc_f
from ssac.camera import Rig
from ssac.config import Config, checked
from ssac.errors import SsacError
from ssac.estimate import Estimate, Status
from ssac.methods.algorithms import algorithm_1, algorithm_2, ssac, ssac_known
from ssac.methods.joint import joint, joint_from, joint_known
from ssac.methods.tangency import tangency, tangency_from, tangency_known
from ssac.search.one_object import OneObject, one_object
from ssac.search.two_views import TwoViews, two_views
from ssac.tool.summaries import DEFAULT, ENTRY_POINTS, OF_TRACKS, SUMMARIES
from ssac.track.observation import Observation

EstimateFunction = Callable[[Observation, Observation, Rig, Config | None], Estimate]

RefineFunction = Callable[[Estimate, TwoViews], Estimate]
"""An estimate of another method to start from, and the views that it was found in."""

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
    estimate: EstimateFunction
    input: Input
    summary: str  # for lists and error messages
    needs_extrinsics: bool = False  # the rig must have T_2_1
    known_variant: str = ""  # name of the method to take in its place when the extrinsics are known
    version: str = ""  # of another package's code, for keys of cached results; empty for ours
    starts_from: str = ""  # method whose estimate `refine` takes, to give the same as `estimate`
    refine: RefineFunction | None = None
    of_views: Callable[[TwoViews], Estimate] | None = None  # the same as `estimate`, of its views
    takes_means: bool = False  # of the frames: images of one pixel give the same estimate
    follows_clock: bool = False  # what camera 2's clock shows more, t_d gains: nothing else changes
    counts: str = "pairs of positions"  # what an estimate's `n_samples` are
    needs_events: bool = False  # a track of points in their place is not enough
    finds_readout: bool = False  # of a rolling shutter that the rig does not state
    of_one_object: bool = False  # of several things that move, it is given the events of one

    def rig_of(self, rig: Rig) -> Rig:
        """Give the rig as the method may see it: only one that needs the extrinsics gets them."""
        return rig if self.needs_extrinsics else Rig(rig.cam1, rig.cam2)

    @property
    def without_tracks(self) -> str:
        """Say why the method cannot use a track of points; empty when it can."""
        if self.input is Input.TRACKS and not self.needs_events:
            return ""
        needs = "events" if self.input is Input.TRACKS else self.input.value
        return f"{self.name} needs {needs}, which a track has not: use {OF_TRACKS}"

    def skip_reason(self, cam1: Observation, cam2: Observation, rig: Rig) -> str:
        """Say why the method cannot run on these data; empty when it can."""
        if self.needs_extrinsics and rig.T_2_1 is None:
            return f"{self.name} needs the extrinsics, but the rig has none"
        for number, observation in enumerate((cam1, cam2), start=1):
            if observation.track is not None and self.without_tracks:
                return f"camera {number} gave a track of points: {self.without_tracks}"
            if self.input is Input.FRAMES and observation.frames is None:
                return f"{self.name} compares intensity frames, but camera {number} has none"
        return ""


_TANGENTS = "pairs of tangents to the object's outline"

OURS = (
    Method("ssac", ssac, Input.TRACKS, SUMMARIES["ssac"],
           known_variant="ssac-known", of_views=algorithm_2, follows_clock=True,
           of_one_object=True),
    Method("ssac-known", ssac_known, Input.TRACKS, SUMMARIES["ssac-known"],
           needs_extrinsics=True, of_views=algorithm_1, follows_clock=True, of_one_object=True),
    Method("joint", joint, Input.TRACKS, SUMMARIES["joint"], known_variant="joint-known",
           starts_from="ssac", refine=joint_from, follows_clock=True, finds_readout=True,
           of_one_object=True),
    Method("joint-known", joint_known, Input.TRACKS, SUMMARIES["joint-known"],
           needs_extrinsics=True, starts_from="ssac-known", refine=joint_from, follows_clock=True,
           finds_readout=True, of_one_object=True),
    Method("tangency", tangency, Input.TRACKS, SUMMARIES["tangency"],
           known_variant="tangency-known", starts_from="joint", refine=tangency_from,
           follows_clock=True, counts=_TANGENTS, needs_events=True, of_one_object=True),
    Method("tangency-known", tangency_known, Input.TRACKS,
           SUMMARIES["tangency-known"], needs_extrinsics=True, starts_from="joint-known",
           refine=tangency_from, follows_clock=True, counts=_TANGENTS, needs_events=True,
           of_one_object=True),
    Method("albl", albl, Input.TRACKS, SUMMARIES["albl"]),
    Method("zncc_e", zncc_e, Input.RATES, SUMMARIES["zncc_e"]),
    Method("zncc_f", zncc_f, Input.FRAMES, SUMMARIES["zncc_f"],
           takes_means=True),
    Method("event_rate", event_rate, Input.RATES, SUMMARIES["event_rate"]),
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
        If there is no such method, or no variant of it that is given the extrinsics, or the package
        that it comes from is broken.
    """
    method = METHODS.get(DEFAULT if name is None else name)
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


class Chain:
    """Methods on one pair of recordings: what one starts from is found once, for all of them."""

    def __init__(
        self, cam1: Observation, cam2: Observation, rig: Rig, config: Config | None = None
    ) -> None:
        """Take what a method takes; the rig with its extrinsics, where they are known."""
        self._cameras, self._rig, self._config = (cam1, cam2), rig, config
        self._estimates: dict[str, Estimate] = {}
        self._views: TwoViews | None = None

    def estimate(self, name: str) -> Estimate:
        """Give the same as the method's own `estimate`, after those that it starts from.

        Where the cameras saw several things, a method that is `of_one_object` gets one of them.
        """
        if name not in self._estimates:
            self._estimates[name] = self._found(METHODS[name])
        return self._estimates[name]

    def _found(self, method: Method) -> Estimate:
        rig, cameras = method.rig_of(self._rig), self._cameras
        if method.of_one_object:
            refusal = self._one_object.refused(method.name)
            if refusal is not None:
                return refusal
            cameras = self._one_object.cam1, self._one_object.cam2
        if method.refine is None and method.of_views is None:
            return method.estimate(*cameras, rig, self._config)
        if self._views is None:
            self._views = two_views(*cameras, Rig(rig.cam1, rig.cam2), self._config)
        views = self._views.with_pose(rig) if method.needs_extrinsics else self._views
        if method.of_views is not None:
            return method.of_views(views)
        assert method.refine is not None
        return method.refine(self.estimate(method.starts_from), views)

    @cached_property
    def _one_object(self) -> OneObject:
        return one_object(*self._cameras, self._rig, checked(self._config))


@dataclass(frozen=True)
class _CheckedFunction:
    """Another package's method; crashes when what it returns would spoil a table in silence."""

    function: EstimateFunction
    origin: str

    def __call__(
        self, cam1: Observation, cam2: Observation, rig: Rig, config: Config | None = None
    ) -> Estimate:
        estimate = self.function(cam1, cam2, rig, config)
        if not isinstance(estimate, Estimate):
            raise TypeError(
                f"{self.origin}: must return an Estimate, got {type(estimate).__name__}"
            )
        if not _STATUS.fullmatch(estimate.status):
            raise ValueError(
                f"{self.origin}: returned the status {str(estimate.status)!r}: give one word of "
                f"ssac.Status, or of your own, that matches {_STATUS.pattern}"
            )
        if estimate.status == Status.OK and not np.isfinite(estimate.t_d_s):
            raise ValueError(
                f'{self.origin}: returned t_d_s = {estimate.t_d_s} with status "ok": give the '
                "reason's name as the status when there is no offset"
            )
        return estimate


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
    try:
        inspect.signature(found.estimate).bind(None, None, None, None)
    except (TypeError, ValueError) as error:
        raise SsacError(
            f"{origin}: expected a function of (cam1, cam2, rig, config) or a Method of one, "
            f"got {type(found.estimate).__name__} ({error})"
        ) from error
    return replace(
        found,
        estimate=_CheckedFunction(found.estimate, origin),
        refine=None,  # so that the check sees every estimate
        of_views=None,
        version=" ".join(filter(None, (_distribution(entry), _code_hash(entry), found.version))),
    )


def _origin(entry: EntryPoint) -> str:
    """Name an entry point for an error message."""
    return f"{_distribution(entry)} (entry point {entry.name} = {entry.value})"


def _distribution(entry: EntryPoint) -> str:
    return f"{entry.dist.name} {entry.dist.version}" if entry.dist else "an unnamed package"


def _code_hash(entry: EntryPoint) -> str:
    """Hash an imported entry point's whole top-level package: its version says nothing of edits."""
    top = sys.modules[entry.module.partition(".")[0]]
    if getattr(top, "__file__", None) is None:  # a namespace package, which many may share
        top = sys.modules[entry.module]
    file = Path(getattr(top, "__file__", None) or "")
    files = [file] if file.is_file() else []
    if file.name == "__init__.py":
        suffixes = (*SOURCE_SUFFIXES, *EXTENSION_SUFFIXES)
        files = sorted(path for path in file.parent.rglob("*") if path.name.endswith(suffixes))
    digest = hashlib.sha256()
    for path in files:
        content = path.read_bytes()
        digest.update(f"{path.relative_to(file.parent).as_posix()} {len(content)}\n".encode())
        digest.update(content)
    return digest.hexdigest()[:16] if files else ""
