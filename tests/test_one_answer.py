"""Tests that all ways to ask for an estimate give the bits of the Python call."""

import json
import pickle
from dataclasses import replace
from functools import cache
from itertools import combinations
from pathlib import Path

import pytest
from threadpoolctl import threadpool_limits

from experiments.lab.cell import UNUSABLE
from experiments.lab.grid import Cell
from experiments.lab.schedule import plain
from experiments.lab.scored import _scored, scored_row
from sim.recording import SimConfig
from ssac import Chain, sync
from ssac.camera import to_be_read_out
from ssac.cli.sync import OPTIONS
from ssac.config import Config
from ssac.errors import SsacError
from ssac.estimate import Estimate
from ssac.pipeline.opened import Recording, opened, opened_rig
from ssac.pipeline.registry import OURS, choose_method
from tests.answers import answered, by_python, differences, fields_of, synced
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
    """Results by files and rig, by which chains estimate nothing twice until a test clears them."""
    of_chains, init = {}, Chain.__init__

    def begun(chain, cameras, rig, *more):
        init(chain, cameras, rig, *more)
        if all(isinstance(camera, Recording) for camera in cameras):
            chain._kept = of_chains.setdefault(pickle.dumps(([*cameras], chain.rig)), {})

    monkeypatch.setattr(Chain, "__init__", begun)
    return of_chains


def told(result):
    """Return what the command line must write and print, but for the time that it took."""
    return untimed(result.to_dict()) | {"printed": result.summary().split()}


def untimed(fields):
    return {**json.loads(json.dumps(fields)), "seconds": None}


def told_by_python(recorded, method):
    result = synced(recorded, method)
    return {"estimate": result.estimate, "told": told(result)}


def by_command_line(recorded, method):
    """Run `ssac sync --json` within this process; return the file's fields and the output."""
    args = [*recorded.files, "--rig", recorded.rig, *(("--method", method) if method else ())]
    args += ["--known-extrinsics"] * recorded.known_extrinsics
    args += ["--estimate-readout"] * recorded.estimate_readout
    for name, option in OPTIONS.items():
        value, flag = recorded.config.get(option.field), f"--{name.replace('_', '-')}"
        if option.value is None and value is not None:
            args += [flag, *(value if isinstance(value, tuple) else [value])]
        elif option.value is not None and option.value == value:
            args.append(flag)
    out = Path(recorded.rig).with_name(f"{method}.json")
    ended = run("sync", *args, "--json", out, code=None)
    if ended.exit_code > 1:
        raise SsacError(ended.stderr.splitlines()[-1].removeprefix("error: "))
    found = read_json(out)
    assert ended.exit_code == (found["status"] != "ok"), ended.stderr
    return untimed(found) | {"printed": ended.stdout.split()}  # as lines are folded


@cache
def chain_of(recorded):
    """Build the chain as a caller does who has all cameras in memory."""
    rig = opened_rig(recorded.rig, len(recorded.files))
    if recorded.estimate_readout:
        rig = replace(rig, cameras=tuple(map(to_be_read_out, rig.cameras)))
    cameras = [one.read("images") for one in opened(recorded.files, rig)]
    return Chain(cameras, rig, Config(**recorded.config))


def by_chain(recorded, method, pair):
    """Estimate one pair by the chain of all cameras, which chooses one object for the whole rig."""
    return chain_of(recorded).estimate(method, *pair)


def cell_of(recorded, method):
    chosen, config = choose_method(method, recorded.known_extrinsics), Config(**recorded.config)
    return Cell(SimConfig(), 0, 0, 0.0, config, chosen.name, {"sim.t_d_s": 0.0})


def row_by_study(recorded, method):
    """Measure a cell of a study; return its row as the cache keeps it."""
    row = plain(scored_row(cell_of(recorded, method), chain_of(recorded)))
    if row["status"] in ("skipped", UNUSABLE):
        raise SsacError(row["reason"])
    return row


def row_of(fields, recorded, method):
    """Score the fields of an estimate as a study does."""
    chain, estimate = chain_of(recorded), Estimate(**{**fields, "jump": None, "start": None})
    n_cam1, n_cam2 = (chain.clean(k).n_recorded for k in range(2))
    row = _scored(estimate, cell_of(recorded, method), chain.rig.pair(0, 1))
    return plain(replace(row, n_events_cam1=n_cam1, n_events_cam2=n_cam2))


def ways(recorded, method):
    """Yield each way's name, the answer expected from the Python call, and its own answer."""
    if len(recorded.files) > 2:
        result = sync([*recorded.files], recorded.rig, None, method, **recorded.config)
        # The whole rig chooses one object, and a pair alone may choose another.
        alone = by_chain if recorded.name == "three_cameras_two_drones" else by_python
        pairs = combinations(range(len(recorded.files)), 2)
        expected = {pair: answered(alone, recorded, method, pair) for pair in pairs}
        yield "network", expected, fields_of({k: one.estimate for k, one in result.pairs.items()})
        yield "command line", told(result), answered(by_command_line, recorded, method)
        return
    python = answered(told_by_python, recorded, method)
    yield "command line", python.get("told", python), answered(by_command_line, recorded, method)
    if recorded.name != "without_pose":  # studies know every pose
        row = python if "error" in python else row_of(python["estimate"], recorded, method)
        yield "row", row, answered(row_by_study, recorded, method)


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
