"""The registry of methods: ours, and those of other packages.

A method of ours is a function of `ssac.methods` (see `ssac.methods.method`). Any installed package
adds its own by an entry point of the group `ssac.methods` (docs/methods.md). A method's code is
imported when that method is asked for, so that nobody waits for the others.
"""

import hashlib
import inspect
import re
import sys
import traceback
from collections.abc import Callable, Iterator, Mapping
from dataclasses import fields, replace
from functools import cached_property, partial
from importlib.machinery import EXTENSION_SUFFIXES, SOURCE_SUFFIXES
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any

import numpy as np

from ssac.arrays import Array
from ssac.camera import Rig
from ssac.config import Config
from ssac.errors import PluginError, SsacError
from ssac.estimate import Estimate, Status
from ssac.methods.method import DEFAULT as DEFAULT
from ssac.methods.method import OF_TRACKS, our_methods
from ssac.methods.method import Input as Input
from ssac.methods.method import Method as Method
from ssac.track.observation import Observation

EstimateFunction = Callable[[Observation, Observation, Rig, Config | None], Estimate]

_STATUS = re.compile(r"[a-z][a-z0-9_]*")
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]*")  # what a CSV column and a file name can hold

# The package of our methods, which keys of runs read here, and the group of entry points of others.
_METHODS = "ssac.methods"

OURS = our_methods()


class Registry(Mapping[str, Method]):
    """Our methods in their order, then those of other packages by name.

    A broken package affects only those who ask for it: looking its method up raises SsacError.
    """

    def __init__(self) -> None:
        self._ours = {method.name: method for method in OURS}
        self._loaded: dict[str, Method] = {}

    @cached_property
    def _entry_points(self) -> dict[str, list[EntryPoint]]:
        found: dict[str, list[EntryPoint]] = {name: [] for name in self._ours}
        for entry in sorted(entry_points(group=_METHODS), key=lambda entry: entry.name):
            found.setdefault(entry.name, []).append(entry)
        return found

    def __iter__(self) -> Iterator[str]:
        return iter(self._entry_points)

    def __len__(self) -> int:
        return len(self._entry_points)

    def __contains__(self, name: object) -> bool:
        return name in self._entry_points

    def __getitem__(self, name: str) -> Method:
        if name not in self._loaded:
            entries = self._entry_points[name]
            owners = ["this suite"] * (name in self._ours) + sorted(map(_origin, entries))
            if len(owners) > 1:
                raise SsacError(
                    f"the method name {name!r} is taken twice, by {' and by '.join(owners)}: "
                    "uninstall one, or change its entry point's name"
                )
            self._loaded[name] = self._ours.get(name) or _method_from(entries[0])
        return self._loaded[name]


METHODS: Mapping[str, Method] = Registry()


def load(method: Method) -> None:
    """Import the code of a method, and of those that it starts from."""
    if method.runs:
        _ = method.function
    if method.starts_from:
        load(METHODS[method.starts_from])


def choose_method(
    name: str | None = None, known_extrinsics: bool = False, has_track: bool = False
) -> Method:
    """Look up a method, or the best one for None; with known extrinsics its variant for them."""
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


def _checked(function: EstimateFunction, origin: str, home: Path, *given: Any) -> Estimate:
    """Run another package's method; raise PluginError for its exceptions and wrong results."""
    where: Path | str = home
    try:
        estimate: Any = function(*given)
    except SsacError:
        raise
    except (Exception, SystemExit) as error:  # an exit of theirs is none of the user's
        frames = traceback.extract_tb(error.__traceback__)
        theirs = [frame for frame in frames if Path(frame.filename).is_relative_to(home)]
        if theirs:  # the last line of that package in the traceback
            where = f"{theirs[-1].filename}, line {theirs[-1].lineno}"
        raise PluginError(_bug(origin, f"{type(error).__name__}: {error}", where)) from error
    try:
        if not isinstance(estimate, Estimate):  # which would spoil a table in silence
            raise TypeError(f"must return an Estimate, got {type(estimate).__name__}")
        typed = _typed(estimate)
        fault = _fault_of(typed)
    except TypeError as error:
        fault = str(error)
    if fault:
        raise PluginError(_bug(origin, fault, where))
    return typed


def _text(value: Any) -> str:
    if not isinstance(value, str):
        raise TypeError
    return value


_array = partial(np.asarray, dtype=np.float64)

_TYPES: dict[Any, tuple[Callable[[Any], Any], str]] = {
    float: (float, "one number"),
    int: (int, "one whole number"),
    str: (_text, "text"),
    Array: (_array, "an array of numbers"),
    Array | None: (_array, "an array of numbers, or None"),
}
"""For the types of an estimate's fields: what brings a value to it, and its name."""


def _typed(estimate: Estimate) -> Estimate:
    """Bring each value to its field's type and dimensions; TypeError if one cannot be."""
    typed, plain = dict[str, Any](), vars(Estimate(""))
    for name, kind in ((one.name, one.type) for one in fields(Estimate)):
        value, usual = getattr(estimate, name), plain[name]
        if value is usual or kind not in _TYPES:
            continue
        convert, what = _TYPES[kind]
        try:
            if usual is not None and np.ndim(value) != np.ndim(usual):
                raise TypeError
            typed[name] = convert(value)
        except (TypeError, ValueError) as error:
            got = f"of shape {value.shape}" if isinstance(value, np.ndarray) else f"= {value!r}"
            raise TypeError(f"returned {name} {got}: give {what}") from error
    return replace(estimate, **typed)


def _fault_of(estimate: Estimate) -> str:
    """Say which value of an estimate cannot be, where one cannot; empty otherwise."""
    t_d_s, R, t, most = estimate.t_d_s, estimate.R, estimate.t, 1e-3  # a rounded pose's error
    if not _STATUS.fullmatch(estimate.status):
        return (
            f"returned the status {str(estimate.status)!r}: give one word of ssac.Status, or of"
            f" your own, that matches {_STATUS.pattern}"
        )
    if estimate.status == Status.OK and not np.isfinite(t_d_s):
        return (
            f'returned t_d_s = {t_d_s} with status "ok": give the reason\'s name as the'
            " status when there is no offset"
        )
    if np.isfinite(estimate.skew_ppm) and not np.isfinite(estimate.t_ref_s):
        return "returned skew_ppm without t_ref_s: give the time at which t_d holds"
    if R is not None and not (
        np.shape(R) == (3, 3)
        and np.allclose(np.transpose(R) @ R, np.eye(3), rtol=0.0, atol=most)
        and np.linalg.det(R) > 0.0
    ):
        return f"returned R = {np.array(R).tolist()}: give an array (3, 3), a rotation, or None"
    if t is not None and not (np.shape(t) == (3,) and abs(np.linalg.norm(t) - 1.0) <= most):
        return f"returned t = {np.array(t).tolist()}: give an array (3,) of length 1, or None"
    return ""


def _bug(origin: str, fault: str, where: Path | str) -> str:
    return f"{origin}: {fault} ({where}): a bug of that package"


def _method_from(entry: EntryPoint) -> Method:
    """Import what an entry point names, a Method or a plain function, and make a Method of it."""
    origin = _origin(entry)
    try:
        found = entry.load()
    except (Exception, SystemExit) as error:  # whatever the import of someone else's code may raise
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
        estimate=partial(_checked, function, origin, _home(entry)),
        runs="",  # this and the next two are for our methods alone
        starts_from="",
        keeps_start="",
        version=" ".join(filter(None, (_distribution(entry), _code_hash(entry), found.version))),
    )


def _origin(entry: EntryPoint) -> str:
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
    digest, files = hashlib.sha256(), 0
    for path in within:
        if path.is_file() and path.name.endswith(suffixes):
            content, files = path.read_bytes(), files + 1
            digest.update(f"{path.relative_to(home.parent).as_posix()} {len(content)}\n".encode())
            digest.update(content)
    return digest.hexdigest()[:16] if files else ""
