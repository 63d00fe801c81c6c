"""A campaign that damages inputs of all kinds in turn, and keeps what became of each."""

import shutil
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np

from experiments.damage.changes import OF_BYTES, OF_TEXT, restructured
from experiments.damage.forked import outcome, run_forked
from experiments.damage.inputs import Input, whole_inputs
from experiments.damage.reliability import Case, Extent
from experiments.lab.cache import Cache, run_key
from ssac.cli.progress import progress

CASES_PER_ENTRY = 100
"""Cases that are kept together: so many at most are lost when a campaign is stopped."""

ALLOWED = ", allowed"
"""Behind a damage: read with `--allow-damaged`."""

_CODE = ("experiments.damage.campaign",)


def campaign(
    extent: Extent, folder: Path, cache: Cache, show_progress: bool = False
) -> Iterator[Case]:
    """Damage inputs of all kinds in turn, in a folder to work in.

    What is finished is kept in the cache under all code that it depends on, so that a campaign
    that was stopped goes on where it was.
    """
    whole = whole_inputs(folder / "whole")
    with progress(extent.cases, "damage", is_shown=show_progress) as advance:
        for first in range(0, extent.cases, CASES_PER_ENTRY):
            numbers = range(first, min(first + CASES_PER_ENTRY, extent.cases))
            key = run_key((), ("damage", extent.seed, numbers.start, numbers.stop), _CODE)
            row = cache.load_run(key)
            if row is None:
                cases = [
                    damaged_case(whole[k % len(whole)], k, extent.seed, folder / "damaged")
                    for k in numbers
                ]
                row = {"cases": cases}
                cache.save_run(key, row)
            yield from (Case(*case) for case in row["cases"])
            advance(numbers.stop)


def damaged_case(whole: Input, number: int, seed: int, folder: Path) -> Case:
    """Damage a copy of an input and use it; the same seed and number damage it the same way."""
    rng = np.random.default_rng([seed, number])
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
