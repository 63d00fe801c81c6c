"""One answer, whichever way it is asked for: the same bits for every recording and method.

All ways are compared with the Python call. What differs today is marked with the reason, and each
mark goes with the step that cures it.
"""

from collections.abc import Callable, Iterator
from itertools import combinations
from typing import Any, NamedTuple

import pytest
from threadpoolctl import threadpool_limits

from ssac.tool.registry import OURS
from tests.answers import (
    Recorded,
    answered,
    by_command_line,
    by_function,
    by_network,
    by_python,
    by_study,
    differences,
    in_json,
    row_by_study,
    row_of,
)
from tests.pipeline_recordings import RECORDINGS, write

pytestmark = pytest.mark.filterwarnings("ignore:.*all times are whole")

METHODS = tuple(method.name for method in OURS)
WAYS: dict[str, Callable[..., Any]] = {
    "command line": by_command_line,
    "function": by_function,
    "study": by_study,
    "row": row_by_study,
    "network": by_network,
}


FITS = ("ssac", "ssac-known", "joint", "joint-known")
OF_PATHS = (*FITS, "tangency", "tangency-known")
KNOWN = ("ssac-known", "joint-known", "tangency-known")
WITHOUT_TRACKS = ("tangency", "tangency-known", "zncc_e", "zncc_f", "event_rate")
TRACKS = (
    "tracks", "tracks_far_apart", "tracks_in_an_interval", "rounded_tracks", "wandering_clock",
    "tracks_of_3_s", "tracks_of_4_s", "tracks_at_rest", "frame_rate", "event_camera_and_track",
)  # fmt: skip


class Differs(NamedTuple):
    """What differs today, and why."""

    why: str
    recordings: tuple[str, ...]
    methods: tuple[str, ...] = METHODS
    ways: tuple[str, ...] = ("function", "study", "row")


_LACKS = "each way has words of its own for what a method lacks"
_SEARCH = "only the Python call searches all offsets where nothing is said"
_NO_TIME = "only the Python call has no common time as an error, the others as a status"
DIFFERS = (
    Differs(_LACKS, TRACKS, WITHOUT_TRACKS),
    Differs(_LACKS, ("without_frames",), ("zncc_f",)),
    Differs(_LACKS, ("without_pose",), KNOWN),
    Differs(_SEARCH, ("tracks", "tracks_of_4_s", "event_camera_and_track"), FITS),
    Differs(_SEARCH, ("tracks_far_apart", "tracks_of_3_s", "tracks_at_rest"), (*FITS, "albl")),
    Differs(_SEARCH, ("far_apart",), (*OF_PATHS, "albl")),
    Differs(_NO_TIME, ("far_apart", "default_interval_said"), ("zncc_e", "zncc_f", "event_rate")),
    Differs(_NO_TIME, ("interval_without_common_time",)),
    Differs(
        "only the Python call takes the default interval, though it is said, for none",
        ("default_interval_said",),
        (*OF_PATHS, "albl"),
        ("command line", "function", "study", "row"),
    ),
    Differs(
        "a config does not say that all offsets are searched",
        ("events_all_offsets",),
        (*OF_PATHS, "zncc_e", "zncc_f", "event_rate"),
    ),
    Differs("a config does not say rates of camera 2's clock", ("frame_rate",), (*FITS, "albl")),
    Differs(
        "only the Python call searches all offsets, and widens deviations for rounded times",
        ("rounded_tracks",),
        FITS,
    ),
    Differs(
        "only the Python call widens deviations for rounded times",
        ("rounded_events",),
        ("joint", "joint-known", "tangency", "tangency-known"),
    ),
    Differs(
        "only the Python call searches all offsets, and lets a track's clock wander",
        ("wandering_clock",),
        (*FITS, "albl"),
    ),
    Differs(
        "the Python call takes 50 ppm for a track's skew where a config is given",
        ("tracks_in_an_interval",),
        ("joint", "joint-known"),
        ("command line",),
    ),
    Differs(
        "only the Python call refuses methods that find no readout, and searches all offsets",
        ("readout",),
    ),
    Differs(
        "only the Python call has noise alone as an error, the others as a status",
        ("noise_alone",),
        (*OF_PATHS, "albl"),
    ),
    Differs("only the Python call notices a copy of camera 1's file", ("copied",)),
    Differs(
        "a method's own function chooses no object of several",
        ("two_drones", "people"),
        OF_PATHS,
        ("function",),
    ),
)


@pytest.fixture(scope="module")
def answers(tmp_path_factory) -> Iterator["Answers"]:
    # Matrices are so small that threads of BLAS only wait, which doubles the CPU time.
    with threadpool_limits(1):
        yield Answers(tmp_path_factory.mktemp("one_answer"))


class Answers:
    """Recordings and what the Python call answers, each made once."""

    def __init__(self, folder) -> None:
        self._folder = folder
        self._recorded = dict[str, Recorded]()
        self._answers = dict[tuple[Any, ...], Any]()

    def recorded(self, name: str) -> Recorded:
        """Write a recording's files."""
        if name not in self._recorded:
            self._recorded[name] = write(name, self._folder)
        return self._recorded[name]

    def by(self, way: Callable[..., Any], name: str, method: str, *pair: Any) -> Any:
        """Ask one way."""
        key = (way, name, method, *pair)
        if key not in self._answers:
            self._answers[key] = answered(way, self.recorded(name), method, *pair)
        return self._answers[key]


def expected(way: str, answers: Answers, name: str, method: str) -> Any:
    """Give what a way must answer, by the Python call."""
    if way == "network":
        pairs = combinations(range(len(answers.recorded(name).files)), 2)
        alone = {pair: answers.by(by_python, name, method, pair) for pair in pairs}
        return next((found for found in alone.values() if "error" in found), alone)
    found = answers.by(by_python, name, method)
    if way == "command line":
        return in_json(found)
    if way == "row":
        return row_of(found, answers.recorded(name), method)
    return found


def different(way: str, answers: Answers, name: str, methods: tuple[str, ...]) -> list[str]:
    """Say what differs between one way and the Python call."""
    return [
        f"{method}: {field}: {one} by Python, {other} by {way}"
        for method in methods
        for field, one, other in differences(
            expected(way, answers, name, method), answers.by(WAYS[way], name, method)
        )
    ]


def cases() -> Iterator[Any]:
    """List all recordings by all ways: the methods that agree apart from those that do not."""
    for name in RECORDINGS:
        for way in WAYS:
            if (way == "network") != name.startswith("three"):
                continue
            if (way, name) == ("row", "without_pose"):  # studies know every pose
                continue
            left = list(METHODS)
            for mark in DIFFERS:
                if way in mark.ways and name in mark.recordings:
                    left = [method for method in left if method not in mark.methods]
                    of = f"{way}-{name}-{'+'.join(mark.methods)}"
                    xfail = pytest.mark.xfail(strict=True, reason=mark.why)
                    yield pytest.param(way, name, mark.methods, marks=xfail, id=of)
            if left:
                yield pytest.param(way, name, tuple(left), id=f"{way}-{name}")


@pytest.mark.parametrize(("way", "name", "methods"), list(cases()))
def test_one_answer(way, name, methods, answers):
    assert different(way, answers, name, methods) == []
