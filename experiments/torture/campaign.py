"""A seed and a number of cases in, how many ended how, by kind of input, out."""

import shutil
from collections import Counter
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
from tqdm import tqdm

from experiments.torture.case import Case, Ended, in_own_process, outcome
from experiments.torture.mutations import OF_BYTES, OF_TEXT
from experiments.torture.structure import restructured
from experiments.torture.victims import Victim, victims

OUTCOMES = (
    "refused",  # in one line that names the file
    "warned",  # read, and it was said what is wrong
    "read",  # all of it, but for 1 %
    "shorter",  # cut off, of a format without an end mark
    "right",  # after a kill, or with a full disk: what another run then makes of it
    "silently_fewer",  # over 1 % fewer, without a word
    "unclear",  # refused in several lines, or without the file's name
    "traceback",
    "abort",
    "hang",
    "over_memory",
    "wrong",  # other bytes than those of an undisturbed run, or something left over
)
BAD = OUTCOMES[OUTCOMES.index("unclear") :]
"""Outcomes that must not be."""


def campaign(n_cases: int, seed: int, folder: Path, show_progress: bool = False) -> list[Case]:
    """Damage inputs of all kinds in turn.

    Parameters
    ----------
    n_cases
    seed
        The same one gives the same damages.
    folder
        To work in.
    show_progress
        On stderr, where it is a terminal.
    """
    whole = victims(folder / "whole")
    numbers = tqdm(range(n_cases), desc="torture", disable=None if show_progress else True)
    return [_case(whole[k % len(whole)], k, seed, folder / "damaged") for k in numbers]


def table(cases: list[Case]) -> pd.DataFrame:
    """Count outcomes by kind of input, and of all."""
    counts = Counter((case.kind, case.outcome) for case in cases)
    rows = list(_rows(list(dict.fromkeys(case.kind for case in cases)), counts))
    frame = pd.DataFrame(rows, columns=["input", "cases", *OUTCOMES])
    frame.loc[len(frame)] = ["all", *frame.drop(columns="input").sum()]
    return frame


def _rows(kinds: list[str], counts: Counter[tuple[str, str]]) -> Iterator[list[object]]:
    for kind in kinds:
        of_kind = [counts[kind, name] for name in OUTCOMES]
        yield [kind, sum(of_kind), *of_kind]


def _case(victim: Victim, number: int, seed: int, folder: Path) -> Case:
    rng = np.random.default_rng([seed, number])
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    path = folder / victim.path.name
    damage = _damaged(victim, path, rng)
    ended = in_own_process(partial(victim.use, path), folder)
    found = outcome(ended, path.name, victim.good)
    if found == "silently_fewer" and damage == "cut" and not victim.has_end:
        found = "shorter"
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
