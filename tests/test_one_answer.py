"""Tests that all ways to ask for an estimate give the same bits, for every recording and method.

All ways are compared with the Python call. The command line builds its own chain from its options.
Where that has the same files, rig and configuration, it reuses the results of the Python call, so
that nothing is estimated twice from inputs that are the same to the last bit.
"""

import pickle
from itertools import combinations
from typing import Any

import pytest
from threadpoolctl import threadpool_limits

from ssac.pipeline.chain import Chain
from ssac.pipeline.opened import Recording
from ssac.pipeline.registry import OURS
from tests import answers
from tests.answers import answered, differences, untimed
from tests.pipeline_recordings import RECORDINGS, write
from tests.ssac.command import read_json, run

pytestmark = pytest.mark.filterwarnings("ignore:.*all times are whole")

ALL = tuple(method.name for method in OURS)
FEW = ("joint", "tangency", "zncc_e")
"""One method of each kind: the pose by tracks or by outlines, and the offset alone by signals."""

METHODS = {
    **dict.fromkeys(("ordinary", "without_pose", "known_extrinsics", "without_frames"), ALL),
    **dict.fromkeys(("tracks", "readout"), ALL),
    **dict.fromkeys(("people", "clock_jump", "three_cameras_two_drones"), FEW[:1]),
    **dict.fromkeys(("three_cameras", "three_mixed"), (None,)),  # each pair's default
}
"""The methods to ask about a recording, if not FEW: all where methods need data that some
recordings lack, and one where it takes seconds to separate objects or to try other clocks."""


@pytest.fixture
def found(monkeypatch):
    """Results by files and rig, which the chains of these share until the test clears them."""
    of_chains, init = dict[bytes, dict[Any, Any]](), Chain.__init__

    def begun(chain, cameras, rig, *more):
        init(chain, cameras, rig, *more)
        if all(isinstance(camera, Recording) for camera in cameras):
            chain._kept = of_chains.setdefault(pickle.dumps(([*cameras], chain.rig)), {})

    monkeypatch.setattr(Chain, "__init__", begun)
    return of_chains


def ways(recorded, method):
    """Yield each way's name, the answer expected from the Python call, and its own answer."""
    if len(recorded.files) > 2:
        yield "network", of_pairs(recorded, method), answered(answers.by_network, recorded, method)
        return
    told = answered(answers.told_by_python, recorded, method)
    by_command_line = answered(answers.by_command_line, recorded, method)
    yield "command line", told.get("told", told), by_command_line
    if recorded.name != "without_pose":  # studies know every pose
        row = told if "error" in told else answers.row_of(told["estimate"], recorded, method)
        yield "row", row, answered(answers.row_by_study, recorded, method)


def of_pairs(recorded, method):
    """Answer each pair of cameras alone; if a pair is refused, return the first error alone."""
    # The whole rig chooses one object, and a pair alone may choose another.
    is_one = recorded.name == "three_cameras_two_drones"
    alone = answers.by_chain if is_one else answers.by_python
    pairs = combinations(range(len(recorded.files)), 2)
    found = {pair: answered(alone, recorded, method, pair) for pair in pairs}
    return next((one for one in found.values() if "error" in one), found)


@pytest.mark.parametrize("name", RECORDINGS)
def test_one_answer(name, tmp_path, found):
    recorded, different = write(name, tmp_path), []
    # Matrices are so small that threads of BLAS only wait, which doubles the CPU time.
    with threadpool_limits(1):
        for method in METHODS.get(name, FEW):
            found.clear()  # so that no method reuses another's results
            different += [
                f"{method}: {field}: {one} by Python, {other} by {way}"
                for way, expected, answer in ways(recorded, method)
                for field, one, other in differences(expected, answer)
                # Pairs of a network look for no body, which is followed in all cameras together.
                if not (way == "network" and field.endswith("without_body"))
            ]
        assert different == []
        if len(recorded.files) > 2:  # command line and Python of all cameras together
            out, asked = tmp_path / "three.json", ("--method", method) if method else ()
            args = (*recorded.files, "--rig", recorded.rig, "--json", out, *asked)
            result = answers.told_by_network(recorded, method)
            ended = run("sync", *args, code=int(result.status != "ok"))
            assert ended.stdout.split() == result.summary().split()  # as lines are folded
            assert list(differences(untimed(read_json(out)), untimed(result.to_dict()))) == []
