"""What pages say of real flights, from made-up ones."""

from itertools import combinations
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from experiments.lab.results import Results
from experiments.quoted.real import PAIRS, REAL_NUMBERS, REAL_TABLES, SHIFTED, WITH_TRUTH
from experiments.real.data_sets import DATA_SETS, VARIABLE_RATES
from tests.experiments.flown import write_made_up_flights


@pytest.fixture
def results(tmp_path: Path) -> Results:
    write_made_up_flights(tmp_path)
    return Results(tmp_path)


def with_truth(results: Results, off_ms: np.ndarray) -> Results:
    """Give results whose cameras are off the published clocks, those of varying rates wildly."""
    table = results.table(PAIRS)
    rows = []
    for i, j in combinations(range(len(off_ms)), 2):
        row = dict(table.iloc[0]) | {"data_set": WITH_TRUTH, "camera_1": i, "camera_2": j}
        wild_ms = 500.0 if {(WITH_TRUTH, i), (WITH_TRUTH, j)} & VARIABLE_RATES else 0.0
        rows.append(row | {"from_truth_ms": off_ms[j] - off_ms[i] + wild_ms})
    others = table[table["data_set"] != WITH_TRUTH]
    path = results.folder / f"{PAIRS}.csv"
    pd.concat([others, pd.DataFrame(rows)]).to_csv(path, index=False)
    return Results(results.folder)


def test_a_camera_that_is_off_is_told_from_the_others(results: Results) -> None:
    off_ms = np.array([3.0, 3.0, 0.0, 0.0, -3.0, 2.0, -2.0])
    off_ms[SHIFTED] = -40.0
    results = with_truth(results, off_ms)
    assert REAL_NUMBERS["real.camera1.apart"](results) == "-40 ms"  # the others' mean is 0
    assert REAL_NUMBERS["real.off"](results) == "43 ms"
    assert REAL_NUMBERS["real.off.others"](results) == "6 ms"


def test_refused_pairs_are_not_answered(results: Results) -> None:
    assert REAL_NUMBERS[f"real.answered.{DATA_SETS[0]}"](results) == "3 of 3"
    assert REAL_NUMBERS[f"real.answered.{DATA_SETS[-1]}"](results) == "2 of 3"


def test_a_table_has_a_row_for_each_data_set(results: Results) -> None:
    rows = REAL_TABLES["table.real.pairs"](results).splitlines()[2:]
    assert len(rows) == len(DATA_SETS)
    for data_set, row in zip(DATA_SETS[:-1], rows, strict=False):
        assert [cell.strip() for cell in row.split("|")[1:4]] == [
            f"{data_set}",
            "3 of 3",
            "1, 2 ms",
        ]
    assert len(REAL_TABLES["table.real.paths"](results).splitlines()) == 2 + len(DATA_SETS)
