"""Refusals name their causes, and advice that is followed literally works; the sums of a table."""

import pandas as pd
import pytest

from experiments.lab.cache import Cache
from experiments.studies.reasons import (
    ADVICE,
    ReasonRow,
    reason_cells,
    reason_row,
    reasons_table,
    said,
)
from experiments.worlds.causes import CAUSES, Cause, Scene
from experiments.worlds.spoilt import KindCell

CELLS = reason_cells(base=1, recordings=1)
# A jump of 0.2 s within 12 s of a track may leave no offset that fits either side.
_FAILS = pytest.mark.xfail(reason="the search over all offsets knows no jumps")


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Cache:
    return Cache(tmp_path_factory.mktemp("cache"))  # causes of one flight share its recording


@pytest.mark.render
@pytest.mark.parametrize(
    "cell",
    [
        pytest.param(one, id=one.kind, marks=[_FAILS] if one.kind == "clock jumps, tracks" else [])
        for one in CELLS
    ],
)
def test_a_refusal_names_its_cause_and_its_advice_works(cell: KindCell, cache: Cache) -> None:
    row = reason_row(cell, cache)
    assert row.is_named or row.is_right, row.reason
    if row.status != "ok":
        assert row.works, (row.advice, row.then)


def test_a_recording_that_nothing_spoils_is_answered(cache: Cache) -> None:
    scene = Scene(Cause((), ""), CELLS[0], cache)
    _, row = said(scene.cause, scene.made())
    assert (row.status, row.is_right, row.pose_given) == ("ok", True, True)


def test_each_cause_is_recorded_once_of_each_flight() -> None:
    cells = reason_cells(base=2, recordings=3)
    assert [cell.kind for cell in cells] == 3 * list(CAUSES)
    assert len({cell.seed for cell in cells} | {cell.seed for cell in CELLS}) == 4
    mended_by = {cause.mended_by for cause in CAUSES.values()} - {""}
    assert mended_by <= set(ADVICE)


def test_the_table_counts_what_was_said_of_each_cause() -> None:
    rows = [
        ReasonRow("no_match", "two paths", is_named=True, advice="record one flight", works=True),
        ReasonRow("ok", offset_given=True, is_right=True),
        ReasonRow("ok", offset_given=True),
        ReasonRow("clock_jump", "jumps", advice="cut the recordings"),
    ]
    table = reasons_table(pd.DataFrame([{"kind": "any", **vars(row)} for row in rows]))
    assert list(table["kind"]) == ["all", "any"]
    counts = table.iloc[1][["recordings", "named", "right", "wrong", "advised", "works"]]
    assert list(counts) == [4, 1, 1, 1, 2, 1]
    assert table.iloc[1]["not_named"] == "ok:2 clock_jump:1"
