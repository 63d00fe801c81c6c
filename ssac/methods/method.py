"""The record of a method, and the decorator that declares a function as a method.

    @method("joint", "ssac, then offset and pose refined together", starts_from="ssac")
    def joint_from(start: Estimate, views: TwoViews) -> Estimate:

A function that `starts_from` another method takes that method's estimate and the views that it was
found in. Others take the views, or, for rates and frames, both observations and the config. To add
a method, a file of this folder with such a function is enough: the registry, the command line and
`ssac.joint` read the declarations from the source, and so list methods without importing them.
"""

import ast
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from functools import cache
from importlib.metadata import entry_points
from pathlib import Path
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any, TypeVar

if TYPE_CHECKING:  # slow imports, which lists of methods do not need
    from ssac.camera import Rig
    from ssac.config import Config
    from ssac.estimate import Estimate

PACKAGE = __name__.rpartition(".")[0]  # of our methods; also the entry point group of others
DEFAULT = "tangency"  # most accurate without known extrinsics; with them, its `known_variant` is
OF_TRACKS = "joint"  # the most accurate where a camera gave a track of points

Function = TypeVar("Function", bound=Callable[..., Any])

_DECORATOR = r"@method\((?:[^\n]*\)\n|\n(?:    [^\n]*\n)*\)\n)"
_DECLARED = re.compile(rf"^((?:{_DECORATOR})+)(?:@[^\n]*\n)*def (\w+)\(", re.MULTILINE)


class Input(Enum):
    """The data that a method compares."""

    TRACKS = "object tracks"
    RATES = "event rates"
    FRAMES = "intensity frames"


@dataclass(frozen=True)
class Method:
    """One way to find the offset, and perhaps the pose."""

    name: str  # as `--method` takes it
    estimate: "Callable[..., Estimate] | None"  # of another package; None: ours, see `runs`
    input: Input  # the data that it compares
    summary: str  # for lists and error messages
    needs_extrinsics: bool = False  # the rig must have T_2_1; other methods do not get it
    known_variant: str = ""  # name of the method to take in its place when the extrinsics are known
    version: str = ""  # of another package's code, for keys of cached results; empty for ours
    runs: str = ""  # function of a method of ours, as "module:function"
    starts_from: str = ""  # method whose estimate it refines
    keeps_start: str = ""  # "module:function", true of views for which the start is the answer
    takes_means: bool = False  # only frames' means count: images of one pixel serve as well
    follows_clock: bool = False  # a delay of camera 2's clock adds to t_d, and changes nothing else
    counts: str = "pairs of positions"  # what an estimate's `n_samples` are
    needs_events: bool = False  # a track of points cannot replace them
    finds_readout: bool = False  # estimates a rolling shutter's, where the rig leaves it uncertain
    of_one_object: bool = False  # where several things move, it gets the events of one of them

    @property
    def function(self) -> "Callable[..., Estimate]":
        """The function that `runs` names."""
        found: Callable[..., Estimate] = resolve_name(self.runs)
        return found

    @property
    def finds_offset_alone(self) -> bool:
        """Whether it finds no pose, as ours of signals; of other packages' nobody knows before."""
        return bool(self.runs) and self.input is not Input.TRACKS

    def keeps(self, views: Any) -> bool:
        """Whether the method's answer for these views is the estimate that it starts from."""
        return bool(self.keeps_start and resolve_name(self.keeps_start)(views))

    @property
    def without_tracks(self) -> str:
        """Say why the method cannot use a track of points; empty when it can."""
        if self.input is Input.TRACKS and not self.needs_events:
            return ""
        needs = "events" if self.input is Input.TRACKS else self.input.value
        return f"{self.name} needs {needs}, which a track has not: use {OF_TRACKS}"

    def lacks(
        self, seen: Sequence[tuple[str, bool]], rig: "Rig", rig_name: str, config: "Config"
    ) -> str:
        """Say what the method lacks to run at all; empty when it can.

        `seen` has the name of each camera, and whether the camera gave a track of points.
        """
        for name, has_track in seen:
            if has_track and self.without_tracks:
                return f"{name}: is a track of points; {self.without_tracks}"
        if self.needs_extrinsics and rig.T_2_1 is None:
            return (
                f"{rig_name}: {self.name} needs the extrinsics (T_cn_cnm1 of cam1 in a Kalibr file,"
                " R and T in OpenCV's): add them, or use a method that finds the pose, without"
                " --known-extrinsics"
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


def method(name: str, summary: str, place: int = 0, **says: Any) -> Callable[[Function], Function]:
    """Declare the function below as a method; this has no effect at run time.

    All arguments are literals or members of `Input`, as the source is only parsed: name, summary,
    place in lists from 1 on (those without one come last, by name), and other fields of `Method`.
    `known` sums up a variant for known extrinsics, run by the same function and next in lists.
    """
    return lambda function: function


@cache
def our_methods() -> tuple[Method, ...]:
    """Parse the declarations of all methods of this folder; return them in the order of lists."""
    found = [one for path in Path(__file__).parent.glob("*.py") for one in _declared_in(path)]
    return tuple(one for _, one in sorted(found, key=lambda pair: (pair[0], pair[1].name)))


def all_summaries() -> Mapping[str, str]:
    """Summaries by name: of our methods, then of others, whose summary names their package."""
    ours = {one.name: one.summary for one in our_methods()}
    others = {
        entry.name: f"of the package {entry.dist.name}" if entry.dist else "of another package"
        for entry in entry_points(group=PACKAGE)
    }
    return ours | {name: others[name] for name in sorted(others.keys() - ours.keys())}


def _declared_in(path: Path) -> Iterator[tuple[float, Method]]:
    """Yield the methods of one file, each with its place."""
    module = f"{PACKAGE}.{path.stem}"
    for found in _DECLARED.finditer(path.read_text(encoding="utf-8")):
        (stub,) = ast.parse(f"{found[1]}def {found[2]}(): ...").body
        assert isinstance(stub, ast.FunctionDef)
        for call in stub.decorator_list:
            assert isinstance(call, ast.Call)
            name, summary = map(ast.literal_eval, call.args)
            says = {str(one.arg): _value(one.value) for one in call.keywords}
            place = says.pop("place", float("inf"))
            if "keeps_start" in says:
                says["keeps_start"] = f"{module}:{says['keeps_start']}"
            kind, known = says.pop("input", Input.TRACKS), says.pop("known", "")
            one = Method(name, None, kind, summary, runs=f"{module}:{found[2]}", **says)
            if known:
                variant = replace(one, name=f"{name}-known", summary=known, needs_extrinsics=True)
                yield place + 0.5, replace(variant, starts_from=f"{one.starts_from}-known")
                one = replace(one, known_variant=variant.name)
            yield place, one


def _value(node: ast.expr) -> Any:
    """Value of a declaration's argument: a literal, or a member of `Input`."""
    return Input[node.attr] if isinstance(node, ast.Attribute) else ast.literal_eval(node)
