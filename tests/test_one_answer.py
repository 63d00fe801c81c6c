"""One answer, whichever way it is asked for: the same bits for every recording and method.

All ways are compared with the Python call. The command line makes a chain of its own from its
options, and where that is of the same files, the same rig and the same configuration, it finds in
it what the Python call left: nothing is estimated twice of what is the same to the last bit.
"""

import pickle
from collections.abc import Callable, Iterator
from itertools import combinations
from pathlib import Path
from typing import Any

import pytest
from threadpoolctl import threadpool_limits

import ssac
from ssac.pipeline.chain import Chain
from ssac.pipeline.opened import Recording
from ssac.pipeline.registry import OURS
from tests.answers import (
    Recorded,
    answered,
    by_chain,
    by_command_line,
    by_network,
    by_python,
    differences,
    row_by_study,
    row_of,
    told_by_python,
    untimed,
)
from tests.pipeline_recordings import RECORDINGS, write
from tests.ssac.command import read_json, run

pytestmark = pytest.mark.filterwarnings("ignore:.*all times are whole")

ALL = tuple(method.name for method in OURS)
FEW = ("joint", "tangency", "zncc_e")
"""Of all kinds: the pose by tracks and by outlines, and the offset alone by signals."""

METHODS = {
    **dict.fromkeys(("ordinary", "without_pose", "known_extrinsics", "without_frames"), ALL),
    **dict.fromkeys(("tracks", "readout"), ALL),
    **dict.fromkeys(("people", "three_cameras_two_drones", "three_mixed"), FEW[:1]),
}
"""Those asked about a recording, where they are not FEW: all where methods need what some
recordings lack, and one where objects take seconds to be told apart."""

WAYS: dict[str, Callable[..., Any]] = {
    "command line": by_command_line,
    "row": row_by_study,
    "network": by_network,
}


@pytest.fixture(scope="module")
def answers(tmp_path_factory) -> Iterator["Answers"]:
    # Matrices are so small that threads of BLAS only wait, which doubles the CPU time.
    with threadpool_limits(1), pytest.MonkeyPatch.context() as patch:
        yield Answers(tmp_path_factory.mktemp("one_answer"), patch)


class Answers:
    """Recordings and what the Python call answers, each made once."""

    def __init__(self, folder, patch: pytest.MonkeyPatch) -> None:
        self.folder = folder
        self._recorded = dict[str, Recorded]()
        self._answers = dict[tuple[Any, ...], Any]()
        self._now: tuple[str, str] = "", ""
        self._found = dict[bytes, dict[Any, Any]]()  # by chains of the recording asked for last
        patch.setattr(Chain, "__init__", self._shared(Chain.__init__))

    def _shared(self, init: Callable[..., None]) -> Callable[..., None]:
        """Let chains of the same files and rig share what they find, for one method at a time."""

        def begun(chain: Chain, cameras: Any, rig: Any, *more: Any) -> None:
            init(chain, cameras, rig, *more)
            if all(isinstance(camera, Recording) for camera in cameras):
                key = pickle.dumps((self._now, [*cameras], chain.rig))
                chain._kept = self._found.setdefault(key, {})

        return begun

    def recorded(self, name: str) -> Recorded:
        """Write a recording's files."""
        if name not in self._recorded:
            self._recorded[name] = write(name, self.folder)
        return self._recorded[name]

    def by(self, way: Callable[..., Any], name: str, method: str, *pair: Any) -> Any:
        """Ask one way."""
        key = (way, name, method, *pair)
        if self._now[0] != name:
            self._found.clear()
        self._now = name, method
        if key not in self._answers:
            self._answers[key] = answered(way, self.recorded(name), method, *pair)
        return self._answers[key]


def expected(way: str, answers: Answers, name: str, method: str) -> Any:
    """Give what a way must answer, by the Python call."""
    if way == "network":
        pairs = combinations(range(len(answers.recorded(name).files)), 2)
        # One object is chosen for the whole rig, which may be another than a pair alone chooses.
        alone = by_chain if name == "three_cameras_two_drones" else by_python
        of_pairs = {pair: answers.by(alone, name, method, pair) for pair in pairs}
        return next((found for found in of_pairs.values() if "error" in found), of_pairs)
    told = answers.by(told_by_python, name, method)
    if "error" in told:
        return told
    if way == "command line":
        return told["json"]
    found = told["estimate"]
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
        # Pairs of a network look for no body, as it is followed in all of its cameras together.
        if not (way == "network" and field.endswith("without_body"))
    ]


def cases() -> Iterator[Any]:
    """List all recordings by all ways."""
    for name in RECORDINGS:
        for way in WAYS:
            if (way == "network") != name.startswith("three"):
                continue
            if (way, name) == ("row", "without_pose"):  # studies know every pose
                continue
            yield pytest.param(way, name, id=f"{way}-{name}")


@pytest.mark.parametrize(("way", "name"), list(cases()))
def test_one_answer(way, name, answers):
    assert different(way, answers, name, METHODS.get(name, FEW)) == []
    if way == "network" and name != "three_cameras":  # here, where the one object is known
        same_of_all_cameras(answers.recorded(name), answers.folder / "three.json")


def same_of_all_cameras(recorded: Recorded, out: Path) -> None:
    """Compare what command line and Python say of all cameras together."""
    ended = run("sync", *recorded.files, "--rig", recorded.rig, "--json", out)
    result = ssac.sync([*recorded.files], recorded.rig)
    assert ended.exit_code == (result.status != "ok"), ended.stderr
    assert ended.stdout.split() == result.summary().split()  # lines are folded there
    assert list(differences(untimed(read_json(out)), untimed(result.to_dict()))) == []
