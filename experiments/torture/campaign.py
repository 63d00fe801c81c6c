"""A seed and a number of cases in, what became of each damaged input out."""

import shutil
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np

from experiments.lab.cache import Cache, run_key
from experiments.torture.case import MAX_S, Ended, Forked, outcome
from experiments.torture.mutations import OF_BYTES, OF_TEXT
from experiments.torture.reliability import Case
from experiments.torture.structure import restructured
from experiments.torture.victims import Victim, victims
from ssac.cli.progress import progress

CASES_PER_ENTRY = 100
"""Cases that are kept together: so many at most are lost when a campaign is stopped."""

ALLOWED = ", allowed"
"""Behind a damage: read with `--allow-damaged`."""

_CODE = ("experiments.torture.campaign",)


def campaign(
    n_cases: int, seed: int, folder: Path, cache: Cache, show_progress: bool = False
) -> Iterator[Case]:
    """Damage inputs of all kinds in turn.

    What is finished is kept in the cache under all code that it depends on, so that a campaign
    that was stopped goes on where it was.

    Parameters
    ----------
    n_cases
    seed
        The same one gives the same damages.
    folder
        To work in.
    cache
    show_progress
        On stderr.
    """
    whole = victims(folder / "whole")
    with progress(n_cases, "torture", is_shown=show_progress) as advance:
        for first in range(0, n_cases, CASES_PER_ENTRY):
            numbers = range(first, min(first + CASES_PER_ENTRY, n_cases))
            key = run_key((), ("torture", seed, numbers.start, numbers.stop), _CODE)
            row = cache.load_run(key)
            if row is None:
                cases = [_case(whole[k % len(whole)], k, seed, folder / "damaged") for k in numbers]
                row = {"cases": cases}
                cache.save_run(key, row)
            yield from (Case(*case) for case in row["cases"])
            advance(numbers.stop)


def _case(victim: Victim, number: int, seed: int, folder: Path) -> Case:
    rng = np.random.default_rng([seed, number])
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    path = folder / victim.path.name
    damage = _damaged(victim, path, rng)
    is_allowed = victim.use_damaged is not None and rng.integers(3) == 0
    use = victim.use_damaged if is_allowed and victim.use_damaged else victim.use
    ended = Forked(partial(use, path), folder).ended(MAX_S)
    found = outcome(ended, path.name, victim.good)
    if found == "silently_fewer" and damage == "cut" and not victim.has_end:
        found = "shorter"
    damage += ALLOWED if is_allowed else ""
    return Case(victim.kind, damage, number, found, _last_words(ended))


def _damaged(victim: Victim, path: Path, rng: np.random.Generator) -> str:
    """Write a damaged copy; return what was done to it."""
    if victim.kind.startswith("hdf5") and rng.integers(2):
        shutil.copyfile(victim.path, path)
        return restructured(path, rng)
    damages = OF_TEXT if victim.is_text else OF_BYTES
    name = list(damages)[int(rng.integers(len(damages)))]
    path.write_bytes(damages[name](victim.path.read_bytes(), rng))
    return name


def _last_words(ended: Ended) -> str:
    return " ".join(ended.stderr.split())[-500:]
