"""The ways to ask for an estimate, and a comparison of two answers to the last bit.

Only this module of the tests knows how each way is called. `.ci/same` runs this file with the
packages of another commit, so it imports only `ssac` of our packages when it is loaded.
"""

import json
import os
import pickle
import sys
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, is_dataclass, replace
from functools import cache
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

from ssac.config import Config
from ssac.errors import SsacError
from ssac.estimate import Estimate

Pair = tuple[int, int]
FIRST_TWO: Pair = (0, 1)


@dataclass(frozen=True)
class Recorded:
    """The files of two or more cameras, their rig, and the options to synchronise them with."""

    name: str
    files: tuple[str, ...]
    rig: str
    known_extrinsics: bool = False
    estimate_readout: bool = False
    config: dict[str, Any] = field(default_factory=dict, hash=False)  # fields of Config

    def without_paths(self, text: str) -> str:
        """Replace the paths in a message by the names that a caller without files sees."""
        for number, path in enumerate(self.files, start=1):
            text = text.replace(path, f"camera {number}")
        return text.replace(self.rig, "the rig")


# --- The ways: each gives an estimate, or raises SsacError ----------------------------------------


def told_by_python(recorded: Recorded, method: str, pair: Pair = FIRST_TWO) -> dict[str, Any]:
    """Call `ssac.sync`; return its estimate, and what the command line must write and print."""
    from ssac import sync

    result = sync(
        *(recorded.files[k] for k in pair), recorded.rig, method,
        known_extrinsics=recorded.known_extrinsics, cameras=(pair[0] + 1, pair[1] + 1),
        estimate_readout=recorded.estimate_readout, **recorded.config,
    )  # fmt: skip
    told = {**untimed(result.to_dict()), "printed": result.summary().split()}
    return {"estimate": result.estimate, "told": told}


def by_python(recorded: Recorded, method: str, pair: Pair = FIRST_TWO) -> Estimate:
    return told_by_python(recorded, method, pair)["estimate"]


def untimed(told: dict[str, Any]) -> dict[str, Any]:
    found = {name: value for name, value in told.items() if name != "seconds"}
    return json.loads(json.dumps(found))


def by_command_line(recorded: Recorded, method: str) -> dict[str, Any]:
    """Run `ssac sync --json` within this process; return the file's fields and the output."""
    from ssac.cli.sync import OPTIONS
    from tests.ssac.command import read_json, run

    args: list[object] = [*recorded.files, "--rig", recorded.rig, "--method", method]
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
    return {**untimed(found), "printed": ended.stdout.split()}


def row_by_study(recorded: Recorded, method: str) -> dict[str, Any]:
    """Measure a cell of a study; return its row as the cache keeps it."""
    from experiments.lab.cell import UNUSABLE
    from experiments.lab.schedule import plain
    from experiments.lab.scored import scored_row

    row = plain(scored_row(*_of_study(recorded, method)))
    if row["status"] in ("skipped", UNUSABLE):
        raise SsacError(row["reason"])
    return row


def row_of(fields: dict[str, Any], recorded: Recorded, method: str) -> dict[str, Any]:
    from experiments.lab.schedule import plain
    from experiments.lab.scored import _scored

    cell, chain = _of_study(recorded, method)
    n_cam1, n_cam2 = (chain.clean(k).n_recorded for k in range(2))
    truth = chain.rig.pair(0, 1)
    row = _scored(Estimate(**{**fields, "jump": None, "start": None}), cell, truth)
    return plain(replace(row, n_events_cam1=n_cam1, n_events_cam2=n_cam2))


def by_chain(recorded: Recorded, method: str, pair: Pair) -> Estimate:
    """Estimate one pair by the chain of all cameras, which chooses one object for the whole rig."""
    return _chain(recorded).estimate(method, *pair)


@cache
def _chain(recorded: Recorded) -> Any:
    """Build the chain as a caller does who has all cameras in memory."""
    from ssac import Chain
    from ssac.camera import to_be_read_out
    from ssac.pipeline.opened import opened, opened_rig

    rig = opened_rig(recorded.rig, len(recorded.files))
    if recorded.estimate_readout:
        rig = replace(rig, cameras=tuple(map(to_be_read_out, rig.cameras)))
    cameras = [one.read("images") for one in opened(recorded.files, rig)]
    return Chain(cameras, rig, Config(**recorded.config))


@cache
def told_by_network(recorded: Recorded, method: str) -> Any:
    """Call `ssac.sync` for all cameras at once."""
    from ssac import sync

    return sync([*recorded.files], recorded.rig, None, method, **recorded.config)


def by_network(recorded: Recorded, method: str) -> dict[Pair, Estimate]:
    pairs = told_by_network(recorded, method).pairs
    return {pair: answer.estimate for pair, answer in pairs.items()}


def _of_study(recorded: Recorded, method: str) -> Any:
    from experiments.lab.grid import Cell
    from sim.recording import SimConfig
    from ssac.pipeline.registry import choose_method

    chosen, config = choose_method(method, recorded.known_extrinsics), Config(**recorded.config)
    cell = Cell(SimConfig(), 0, 0, 0.0, config, chosen.name, {"sim.t_d_s": 0.0})
    return cell, _chain(recorded)


# --- Comparing ------------------------------------------------------------------------------------


def answered(way: Callable[..., Any], recorded: Recorded, method: str, *more: Any) -> Any:
    """Return the fields of a way's answer by name; if it refuses, the message as field `error`."""
    try:
        return fields_of(way(recorded, method, *more))
    except SsacError as error:
        return {"error": recorded.without_paths(str(error))}


def fields_of(value: Any) -> Any:
    """Turn dataclasses into dicts and statuses into plain strings, which any commit can load."""
    if is_dataclass(value):
        return {name: fields_of(part) for name, part in vars(value).items()}
    if isinstance(value, dict):
        return {name: fields_of(part) for name, part in value.items()}
    return str(value) if isinstance(value, str) else value


def assert_same(one: Any, other: Any) -> None:
    """Compare two dataclasses to the last bit."""
    assert [*differences(fields_of(one), fields_of(other))] == []


def differences(one: Any, other: Any, name: str = "") -> Iterator[tuple[str, Any, Any]]:
    """Yield the fields that differ in any bit, with both values; NaN equals NaN."""
    if isinstance(one, dict) and isinstance(other, dict):
        for key in {**one, **other}:
            inner, missing = f"{name}.{key}" if name else str(key), "(missing)"
            yield from differences(one.get(key, missing), other.get(key, missing), inner)
    elif not _is_same(one, other):
        yield name, one, other


def _is_same(one: Any, other: Any) -> bool:
    if type(one) is not type(other):
        return False
    if isinstance(one, np.ndarray):
        may_be_nan = one.dtype.names is None  # which NumPy cannot tell of fields
        return one.dtype == other.dtype and np.array_equal(one, other, equal_nan=may_be_nan)
    return repr(one) == repr(other)  # shows every bit of a float, and NaNs alike


# --- For another commit ---------------------------------------------------------------------------


def main() -> None:
    """Estimate the recordings of a JSON file by the packages of PYTHONPATH; pickle the answers."""
    recorded_file, answers_file = map(Path, sys.argv[1:])
    tree = Path(os.environ["PYTHONPATH"])
    if not Path(sys.modules["ssac"].__file__ or "").is_relative_to(tree):
        sys.exit(f"{sys.modules['ssac'].__file__} is not of {tree}")
    warnings.simplefilter("ignore")
    from ssac.pipeline.registry import OURS

    answers = {}
    for one in json.loads(recorded_file.read_text(encoding="utf-8")):
        recorded = Recorded(**{**one, "files": tuple(one["files"])})
        for method in (one.name for one in OURS):
            for pair in combinations(range(len(recorded.files)), 2):
                numbers = "-".join(str(k + 1) for k in pair)
                found = answered(by_python, recorded, method, pair)
                answers[recorded.name, method, numbers] = found
    answers_file.write_bytes(pickle.dumps(answers))


if __name__ == "__main__":
    main()
