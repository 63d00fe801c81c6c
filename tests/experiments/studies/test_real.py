"""Public drone tracks: reading them, checks of the committed tables, and numbers quoted of them."""

import os
import re
from itertools import combinations
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from experiments.lab.results import Results
from experiments.lab.verify import found
from experiments.studies import real
from experiments.studies.real import PAIRS, PATHS, SHIFTED, STRAYS, TRIPLES, WITH_TRUTH
from experiments.worlds.tracks import VARIABLE_RATES, data_sets, load_rtk, path_of
from ssac.errors import SsacError
from tests.experiments.reported import RESULTS

DATA = os.environ.get("SSAC_DRONE_TRACKING", "")  # a folder with dataset1 ...; not ours to ship
(STUDY,) = real.STUDIES


@pytest.mark.parametrize(
    ("name", "old", "new", "fault"),
    [
        (PAIRS, "closure_ms", "closure_s", "KeyError: 'closure_ms'"),
        (PAIRS, "\n1,0,2,", "\n1,0,1,", "its rows are not all pairs"),
        (PAIRS, ",ok,affine,", ",fine,affine,", "real_pairs.csv, row 0: status not in"),
        (PAIRS, ",ok,affine,", ",ok,bent,", "real_pairs.csv, row 0: clock not in"),
        (PAIRS, ",ok,affine,[^,]+,", ",ok,affine,,", "(1, 0, 1) is answered without t_d_s"),
        (PAIRS, r"(\n1,0,1,.*,)[\d.]+\n", r"\g<1>9\n", "(1, 0, 1): closure_ms is 9.0 in the pai"),
        (TRIPLES, "\n1,0-1-2,", "\n1,0-1-9,", "not each triple"),
        (TRIPLES, r"1,0-1-3,-[\d.]+", "1,0-1-3,-41", "(1, 0, 1): closure_ms is 20."),
        (STRAYS, "\n2,0,1,0.0333667,-", "\n2,0,1,0.0333667,-9", "the strays of (2, 0, 1)"),
        (STRAYS, "\n2,0,1,5.0409629,", "\n2,0,1,6.0409629,", "the knots of (2, 0, 1)"),
        (STRAYS, "\n2,0,1,", "\n2,0,9,", "(2, 0, 9): most_stray_ms is nan"),
        (STRAYS, r"(\n2,0,1,5.0409629,)[-\d.]+", r"\g<1>", "the strays of (2, 0, 1)"),
        (PATHS, "max_m", "most_m", "UndefinedVariableError: name 'max_m' is not"),
        (PATHS, "\n2,", "\n3,", "real_paths.csv has not each data set once"),
        (PATHS, r"(\n1,4,,)[\d.]+", r"\g<1>0.018", "real_paths.csv, row 0: mean_m > rmse_m"),
        (PATHS, r"(\n1,4,,(?:[\d.]+,){3})[\d.]+", r"\g<1>0.01", "real_paths.csv, row 0: rmse_m >"),
    ],
)
def test_what_makes_no_sense_is_found(name, old, new, fault) -> None:
    spoilt, n_found = re.subn(old, new, (RESULTS / f"{name}.csv").read_text(), count=1)
    assert n_found == 1
    results = Results(RESULTS, {f"{name}.csv": spoilt})
    findings = [found(what, lambda check=check: check(results)) for what, check in STUDY.checks]
    faults = [one for finding in findings for one in finding.faults]
    assert any(one.startswith(fault) for one in faults), faults


def test_a_camera_that_is_off_is_told_from_the_others() -> None:
    off_ms = np.array([3.0, 3.0, 0.0, 0.0, -3.0, 2.0, -2.0])
    off_ms[SHIFTED] = -40.0
    first, rows = dict(Results(RESULTS).table(PAIRS).iloc[0]), []
    for i, j in combinations(range(len(off_ms)), 2):
        row = first | {"data_set": WITH_TRUTH, "camera_1": i, "camera_2": j}
        wild_ms = 500.0 if {(WITH_TRUTH, i), (WITH_TRUTH, j)} & VARIABLE_RATES else 0.0
        rows.append(row | {"from_truth_ms": off_ms[j] - off_ms[i] + wild_ms})
    results = Results(RESULTS, {f"{PAIRS}.csv": pd.DataFrame(rows).to_csv(index=False)})
    assert STUDY.numbers["real.camera1.apart"](results) == "-40 ms"  # the others' mean is 0
    assert STUDY.numbers["real.off"](results) == "43 ms"
    assert STUDY.numbers["real.off.others"](results) == "6 ms"


def test_rtk_is_of_5_hz_and_an_index_says_which_samples_are_missing(tmp_path: Path) -> None:
    (tmp_path / "trajectory").mkdir()
    file, positions = tmp_path / "trajectory" / "rtk.txt", np.arange(12.0).reshape(4, 3)
    np.savetxt(file, positions)
    found_here = load_rtk(tmp_path)
    assert found_here.times_s == pytest.approx([0.0, 0.2, 0.4, 0.6])
    assert found_here.positions_m == pytest.approx(positions)
    np.savetxt(file, np.column_stack([[0, 1, 5], np.eye(3)]))
    assert load_rtk(tmp_path).times_s == pytest.approx([0.0, 0.2, 1.0])
    np.savetxt(file, np.ones((3, 2)))
    with pytest.raises(SsacError, match="expected lines `\\[index\\] x y z`, got 2 columns"):
        load_rtk(tmp_path)


@pytest.mark.skipif(not DATA, reason="SSAC_DRONE_TRACKING names no folder with the data sets")
def test_the_first_real_flight_is_found_from_nothing(tmp_path: Path) -> None:
    (one,) = data_sets(Path(DATA), tmp_path, lambda line: None, (1,))
    row, _ = path_of(one)
    assert row["cameras"] == 4
    assert row["rmse_m"] <= 0.045  # 4.5 cm: the mark for this data set
    assert row["n_rtk"] >= 608  # mvus' coverage
