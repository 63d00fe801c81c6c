"""What becomes of damaged inputs of all kinds (docs/security.md): the command `ssac torture`.

The same seed damages the same way. A cell is a hundred cases, which are kept together.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import wraps
from typing import Annotated, Any

import pandas as pd
import typer

from experiments.damage.cases import OUTCOMES, Damaging, damaged_case
from experiments.lab.cell import Measure, PlainCell, RunRow
from experiments.lab.command import command_of
from experiments.lab.results import Results
from experiments.lab.study import Runs, Study
from experiments.lab.summary import quoted
from ssac.cli.exits import NO_ESTIMATE
from ssac.cli.options import number

N_TOGETHER = 100

BAD = OUTCOMES[OUTCOMES.index("unclear") :]  # outcomes that must not be
MAX_SILENT = 0.005  # share of the event files damaged in the middle that may be `silently_fewer`

EVENT_FILES = (
    "hdf5", "hdf5 dsec", "hdf5 prophesee", "esim text", "csv", "aedat4", "evt2", "evt3",
    "evt2 camera", "evt3 camera", "dat", "es",
)  # fmt: skip
OTHER_INPUTS = (
    "track", "rig", "trajectory", "grid", "mesh", "truth", "cached row", "cached brightness",
    "cached recording",
)  # fmt: skip
KINDS = (*EVENT_FILES, *OTHER_INPUTS)
ALL = "all"


@dataclass(frozen=True)
class DamageCell(PlainCell):
    """Some cases, by their numbers: those of a kind follow each other by as many as there are."""

    seed: int
    first: int
    end: int

    @property
    def shares(self) -> tuple[int, ...]:
        """Each is a task of its own."""
        return (self.first,)


@dataclass(frozen=True)
class DamageRow(RunRow):
    """How the cases ended."""

    outcomes: list[list[Any]] = field(default_factory=list)  # kind, outcome, how many


def damage_cells(
    cases: Annotated[
        int, number("Number of damaged inputs.", 1, 10_000_000, metavar="COUNT")
    ] = 20_000,
    seed: Annotated[int, number("Seed of all damage.", 0, 2**32 - 1)] = 0,
) -> list[DamageCell]:
    """List the cases."""
    firsts = range(0, cases, N_TOGETHER)
    return [DamageCell(seed, first, min(first + N_TOGETHER, cases)) for first in firsts]


def load_damaging(cells: Sequence[DamageCell], cache: object) -> Damaging:
    """Write a good input of each kind."""
    del cells, cache
    return Damaging()


def damage_row(cell: DamageCell, damaging: Damaging) -> DamageRow:
    """Damage inputs of all kinds in turn."""
    cases = [damaged_case(damaging, k, cell.seed) for k in range(cell.first, cell.end)]
    counts = Counter((case.kind, case.outcome) for case in cases)
    bad = [case for case in cases if case.outcome in (*BAD, "silently_fewer")]
    said = "; ".join(f"{c.outcome}: {c.kind}, {c.damage}, number {c.number}: {c.said}" for c in bad)
    return DamageRow("bad" if bad else "ok", said, [[*key, count] for key, count in counts.items()])


def reliability_table(rows: pd.DataFrame, _: Results) -> pd.DataFrame:
    """Count outcomes by kind of input, and of all."""
    counted = pd.DataFrame(rows["outcomes"].sum(), columns=["input", "outcome", "n"])
    table = counted.pivot_table("n", "input", "outcome", "sum", 0).astype(int)
    table = table.reindex([kind for kind in KINDS if kind in table.index])
    table = table.reindex(columns=list(OUTCOMES), fill_value=0)
    table.loc[ALL] = table.sum()
    table.insert(0, "cases", table.sum(axis=1))
    return table.reset_index().rename_axis(columns=None)


def silent_share(table: pd.DataFrame) -> float:
    """Share of the event files damaged in the middle that gave over 1 % fewer without a word."""
    files = table[table["input"].isin(EVENT_FILES)]
    middle = int((files["cases"] - files["shorter"]).sum())
    return float(files["silently_fewer"].sum() / middle) if middle else 0.0


def reliability_faults(results: Results) -> list[str]:
    """Check that the table has all cases, and that none ended as it must not."""
    table = results.table("reliability")
    if list(table) != ["input", "cases", *OUTCOMES]:
        return [f"its columns are {', '.join(map(str, table))}"]
    n_cases = damage_cells()[-1].end
    expected = [(kind, len(range(k, n_cases, len(KINDS)))) for k, kind in enumerate(KINDS)]
    faults = []
    if list(zip(table["input"], table["cases"], strict=True)) != [*expected, (ALL, n_cases)]:
        faults.append("its kinds and cases are not those of today's campaign")
    if (table[list(OUTCOMES)].sum(axis=1) != table["cases"]).any():
        faults.append("its outcomes are not as many as its cases")
    if (table[list(OUTCOMES)].iloc[:-1].sum() != table[list(OUTCOMES)].iloc[-1]).any():
        faults.append("its last row is not the sum of the others")
    faults += [f"{name}: {n}" for name in BAD if (n := int(table[name].iloc[:-1].sum()))]
    if silent_share(table) > MAX_SILENT:
        faults.append(f"{100 * silent_share(table):.2g} % were read with fewer events, in silence")
    return faults


def must_not_be(results: Results) -> str:
    """Count the damaged inputs that ended as none should."""
    return f"{results.one('reliability', input=ALL)[list(BAD)].sum():.0f}"


_COUNTED = ("cases", "refused", "warned", "silently_fewer")

STUDIES = (
    Study(
        "reliability",
        "What becomes of damaged inputs",
        damage_cells,
        Measure(load_damaging, damage_row, DamageRow),
        Runs("reliability.csv", ("input",), numbered=False, table=reliability_table),
        numbers={
            **{
                f"reliability.{name}": quoted("reliability", f"{{{name}:.0f}}", input=ALL)
                for name in _COUNTED
            },
            "reliability.must_not_be": must_not_be,
        },
        checks=(("every case is there, and none ended as it must not", reliability_faults),),
        config={"cases": 20_000, "seed": 0},
        command="ssac torture",
        shows="reliability",
    ),
)

_HELP = """Damage inputs of all kinds, and see what becomes of them.

What is finished is kept in the cache, so that an interrupted campaign goes on where it was.
Exit code 0: none ended as it must not; 1: some did, and they are listed on stderr.
"""
_run = command_of({"reliability": STUDIES}, _HELP)


@wraps(_run)
def command(**given: Any) -> None:
    """Run the campaign, and judge its table."""
    _run(**given)
    table = Results(given["out"]).table("reliability")
    typer.echo(
        f"{100.0 * silent_share(table):.2g} % of the event files damaged in the middle were read "
        "with over 1 % fewer events and no warning"
    )
    if table[list(BAD)].to_numpy().any():
        raise typer.Exit(NO_ESTIMATE)
