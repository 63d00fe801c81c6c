"""One case: an input is damaged and used as a user would, and what became of that."""

import shutil
import tempfile
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from experiments.damage.changes import OF_BYTES, OF_TEXT, restructured
from experiments.damage.forked import outcome, run_forked
from experiments.damage.inputs import Input, whole_inputs

OUTCOMES = (
    "refused",  # in one line that names the file
    "warned",  # read, and it was said what is wrong
    "read",  # all of it, but for 1 %
    "shorter",  # cut off, of a format without an end mark
    "right",  # of disturbed sweeps, which are tests now: none
    "silently_fewer",  # over 1 % fewer, without a word
    "unclear",  # refused in several lines, or without the file's name
    "traceback",
    "abort",
    "hang",
    "over_memory",
    "wrong",  # as "right"
)

ALLOWED = ", allowed"
"""Behind a damage: read with `--allow-damaged`."""


class Case(NamedTuple):
    """One damaged input."""

    kind: str
    damage: str
    number: int
    outcome: str  # of OUTCOMES
    said: str  # on stderr


class Damaging:
    """A good input of each kind in a folder that goes with this."""

    def __init__(self) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="ssac-damage-")
        self.folder = Path(self._folder.name)
        self.whole = whole_inputs(self.folder / "whole")


def damaged_case(damaging: Damaging, number: int, seed: int) -> Case:
    """Damage a copy of an input and use it; the same seed and number damage it the same way."""
    rng = np.random.default_rng([seed, number])
    whole, folder = damaging.whole[number % len(damaging.whole)], damaging.folder / "damaged"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    path = folder / whole.path.name
    damage = _damaged(whole, path, rng)
    is_allowed = whole.use_damaged is not None and rng.integers(3) == 0
    use = whole.use_damaged if is_allowed and whole.use_damaged else whole.use
    ended = run_forked(partial(use, path), folder)
    found = outcome(ended, path.name, whole.good)
    if found == "silently_fewer" and damage == "cut" and not whole.has_end:
        found = "shorter"
    damage += ALLOWED if is_allowed else ""
    return Case(whole.kind, damage, number, found, " ".join(ended.stderr.split())[-500:])


def _damaged(whole: Input, path: Path, rng: np.random.Generator) -> str:
    """Write a damaged copy; return what was done to it."""
    if whole.kind.startswith("hdf5") and rng.integers(2):
        shutil.copyfile(whole.path, path)
        return restructured(path, rng)
    damages = OF_TEXT if whole.is_text else OF_BYTES
    name = list(damages)[int(rng.integers(len(damages)))]
    path.write_bytes(damages[name](whole.path.read_bytes(), rng))
    return name
