"""The study of imperfect recordings: its cells, its counts, and the table that the docs quote."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from experiments.lab.files import save_csv
from experiments.lab.results import Results
from experiments.measures.imperfect import ImperfectRow
from experiments.measures.imperfect_kinds import KINDS
from experiments.quoted.real import REAL_TABLES
from experiments.studies.imperfect import (
    ALL,
    FIRST_FLIGHT,
    METHOD_NAMES,
    imperfect_cells,
    imperfect_table,
)


def test_every_round_has_every_kind_by_every_method_on_flights_of_its_own() -> None:
    cells = imperfect_cells(12)
    table = pd.DataFrame([cell.columns for cell in cells])
    assert len(table.drop_duplicates(["kind", "flight"])) >= 600
    counts = table.groupby(["kind", "method"]).size()
    assert len(counts) == len(KINDS) * len(METHOD_NAMES)
    assert set(counts) == {12, 24}  # ordinary flights are two a round
    seeds = {cell.seed for cell in cells}
    others = {cell.other_seed for cell in cells if cell.needs_other}
    assert len(seeds) == 13 * 12
    assert not seeds & others
    assert table["flight"].between(FIRST_FLIGHT, FIRST_FLIGHT + 400).all()
    assert set(table["angle_deg"]) == {30.0, 60.0, 90.0, 120.0, 150.0}


def rows_of(kind: str, rows: list[ImperfectRow], method: str = "joint") -> list[dict[str, object]]:
    return [{"kind": kind, "method": method, **vars(row)} for row in rows]


RUNS = pd.DataFrame(
    [
        *rows_of(
            "lamp 6 px",
            [
                ImperfectRow("ok", "", True, True, t_d_normalised=1.9, skew_normalised=-0.1,
                             r_mahalanobis=2.7, t_mahalanobis=2.5),
                ImperfectRow("ok", "", True, True, t_d_normalised=-3.6, skew_normalised=0.1,
                             r_mahalanobis=2.9, t_mahalanobis=2.4),
                ImperfectRow("degenerate_pose", "", True, t_d_normalised=-1.0),
                ImperfectRow("no_match", "two things move"),
            ],
        ),
        *rows_of(
            "skew",
            [ImperfectRow("ok", "", True, t_d_normalised=0.5, skew_normalised=3.4)],
            "joint-known",
        ),
    ]
)  # fmt: skip


def test_the_table_counts_what_held_and_what_was_wrong() -> None:
    table = imperfect_table(RUNS).set_index(["kind", "method"])
    assert list(table.index) == [
        (ALL, "joint"), (ALL, "joint-known"), ("lamp 6 px", "joint"), ("skew", "joint-known"),
    ]  # fmt: skip
    row = table.loc[("lamp 6 px", "joint")]
    assert (row["runs"], row["answered"], row["pose_given"]) == (4, 3, 2)
    assert row["refused"] == "no_match:1"
    assert (row["t_d_given"], row["skew_given"], row["R_given"], row["t_given"]) == (3, 2, 2, 2)
    # 1.96 deviations of one number, 2.80 of three together, 2.45 of two hold 95 %.
    assert row["t_d_held"] == pytest.approx(2 / 3)
    assert (row["skew_held"], row["R_held"], row["t_held"]) == (1.0, 0.5, 0.5)
    assert row["confident_wrong"] == 1
    known = table.loc[("skew", "joint-known")]
    assert (known["R_given"], known["skew_held"], known["confident_wrong"]) == (0, 0.0, 0)
    assert np.isnan(known["R_held"])


def test_the_docs_show_all_kinds_and_of_each_two_methods(tmp_path: Path) -> None:
    save_csv(tmp_path / "imperfect.csv", imperfect_table(RUNS))
    together = cells_of(REAL_TABLES["table.imperfect"](Results(tmp_path)))
    quantities = ["t_d", "skew", "R", "t"]
    shares = [f"{name} [%]" for name in quantities]
    assert together[0] == ["method", "answered", *shares, "confident wrong"]
    assert together[2][:3] == ["`joint`", "3 of 4", "67 (9 to 99)"]
    kinds = cells_of(REAL_TABLES["table.imperfect.kinds"](Results(tmp_path)))
    assert kinds[0] == ["kind", "method", "answered", "refused", *quantities, "wrong"]
    (lamp,) = [row for row in kinds if row[0] == "lamp 6 px"]
    assert lamp[3:] == ["no match 1", "67", "100", "50", "50", "1"]
    assert not [row for row in kinds if row[0] == "skew"]  # by a method that has no row of its own


def cells_of(table: str) -> list[list[str]]:
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in table.splitlines()]
