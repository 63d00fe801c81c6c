"""The table of how damaged inputs ended, by kind of input, and what it must be.

It knows nothing of what is damaged or how, so that whoever checks the table need not import that.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import pandas as pd

from ssac.errors import SsacError

COMMAND = "ssac torture"
CSV_FILE = "reliability.csv"

OUTCOMES = (
    "refused",  # in one line that names the file
    "warned",  # read, and it was said what is wrong
    "read",  # all of it, but for 1 %
    "shorter",  # cut off, of a format without an end mark
    "right",  # none: of sweeps that were disturbed, which are tests now
    "silently_fewer",  # over 1 % fewer, without a word
    "unclear",  # refused in several lines, or without the file's name
    "traceback",
    "abort",
    "hang",
    "over_memory",
    "wrong",  # none, as "right"
)
BAD = OUTCOMES[OUTCOMES.index("unclear") :]
"""Outcomes that must not be."""

MAX_SILENT = 0.005
"""Share of the event files damaged in the middle that may be `silently_fewer`."""

EVENT_FILES = (
    "hdf5", "hdf5 dsec", "hdf5 prophesee", "esim text", "csv", "aedat4", "evt2", "evt3",
    "evt2 camera", "evt3 camera", "dat", "es",
)  # fmt: skip
OTHER_INPUTS = (
    "track", "rig", "trajectory", "grid", "mesh", "truth", "cached row", "cached brightness",
    "cached recording",
)  # fmt: skip
ALL = "all"


class Case(NamedTuple):
    """One damaged input."""

    kind: str
    damage: str
    number: int
    outcome: str  # of OUTCOMES
    said: str  # on stderr


@dataclass(frozen=True)
class Extent:
    """How much is damaged."""

    cases: int = 20_000
    seed: int = 0

    def counts(self) -> dict[str, int]:
        """Cases by kind."""
        kinds = (*EVENT_FILES, *OTHER_INPUTS)
        return {kind: len(range(k, self.cases, len(kinds))) for k, kind in enumerate(kinds)}


COMMITTED = Extent()


def reliability_table(cases: Sequence[Case]) -> pd.DataFrame:
    """Count outcomes by kind of input, and of all."""
    counts = Counter((case.kind, case.outcome) for case in cases)
    rows = []
    for kind in dict.fromkeys(case.kind for case in cases):
        of_kind = [counts[kind, name] for name in OUTCOMES]
        rows.append([kind, sum(of_kind), *of_kind])
    frame = pd.DataFrame(rows, columns=["input", "cases", *OUTCOMES])
    frame.loc[len(frame)] = [ALL, *frame.drop(columns="input").sum()]
    return frame


def silent_share(table: pd.DataFrame) -> float:
    """Share of the event files damaged in the middle that gave over 1 % fewer without a word."""
    files = table[table["input"].isin(EVENT_FILES)]
    middle = int((files["cases"] - files["shorter"]).sum())
    return float(files["silently_fewer"].sum() / middle) if middle else 0.0


def reliability_faults(results: Path) -> tuple[str, ...]:
    """Check that the committed table has all its cases, and that none ended as it must not."""
    try:
        table = pd.read_csv(results / CSV_FILE)
    except (OSError, ValueError) as error:
        raise SsacError(f"{results / CSV_FILE} cannot be read: {error}") from error
    there = [str(name) for name in table]
    if there != ["input", "cases", *OUTCOMES]:
        return (f"its columns are {', '.join(there)}",)
    counts = {kind: n for kind, n in COMMITTED.counts().items() if n}
    expected = [*counts.items(), (ALL, sum(counts.values()))]
    faults = []
    if list(zip(table["input"], table["cases"], strict=True)) != expected:
        faults.append("its kinds and cases are not those of today's campaign")
    if (table[list(OUTCOMES)].sum(axis=1) != table["cases"]).any():
        faults.append("its outcomes are not as many as its cases")
    faults += [f"{name}: {n}" for name in BAD if (n := int(table[name].iloc[:-1].sum()))]
    if silent_share(table) > MAX_SILENT:
        faults.append(f"{100 * silent_share(table):.2g} % were read with fewer events, in silence")
    return tuple(faults)
