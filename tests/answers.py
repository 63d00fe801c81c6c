"""Asks Python for an estimate, and compares two answers to the last bit.

`.ci/same` runs this file with the packages of another commit, so it imports only `ssac` of ours.
"""

import json
import os
import pickle
import sys
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, is_dataclass
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

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


def synced(recorded: Recorded, method: str, pair: Pair = FIRST_TWO) -> Any:
    """Call `ssac.sync` with the files of two cameras."""
    from ssac import sync

    return sync(
        *(recorded.files[k] for k in pair), recorded.rig, method,
        known_extrinsics=recorded.known_extrinsics, cameras=(pair[0] + 1, pair[1] + 1),
        estimate_readout=recorded.estimate_readout, **recorded.config,
    )  # fmt: skip


def by_python(recorded: Recorded, method: str, pair: Pair = FIRST_TWO) -> Estimate:
    return synced(recorded, method, pair).estimate


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
                found = answered(by_python, recorded, method, pair)
                answers[recorded.name, method, "-".join(str(k + 1) for k in pair)] = found
    answers_file.write_bytes(pickle.dumps(answers))


if __name__ == "__main__":
    main()
