"""Paths beside RTK: its files, and, where the public data are at hand, the marks."""

import os
from pathlib import Path

import numpy as np
import pytest

from experiments.real.data_sets import data_sets, load_rtk
from experiments.real.paths import path_of
from ssac.errors import SsacError

DATA = os.environ.get("SSAC_DRONE_TRACKING", "")  # a folder with dataset1 ...; not ours to ship


def rtk(folder: Path, rows: np.ndarray) -> Path:
    (folder / "trajectory").mkdir()
    np.savetxt(folder / "trajectory" / "rtk.txt", rows)
    return folder


def test_rtk_is_of_5_hz(tmp_path):
    positions = np.arange(12.0).reshape(4, 3)
    found = load_rtk(rtk(tmp_path, positions))
    assert found.times_s == pytest.approx([0.0, 0.2, 0.4, 0.6])
    assert found.positions_m == pytest.approx(positions)


def test_an_index_says_which_samples_are_missing(tmp_path):
    found = load_rtk(rtk(tmp_path, np.column_stack([[0, 1, 5], np.eye(3)])))
    assert found.times_s == pytest.approx([0.0, 0.2, 1.0])


def test_other_tables_are_refused(tmp_path):
    with pytest.raises(SsacError, match="expected lines `\\[index\\] x y z`, got 2 columns"):
        load_rtk(rtk(tmp_path, np.ones((3, 2))))


@pytest.mark.skipif(not DATA, reason="SSAC_DRONE_TRACKING names no folder with the data sets")
def test_the_first_real_flight_is_found_from_nothing(tmp_path):
    (one,) = data_sets(Path(DATA), tmp_path, lambda line: None, (1,))
    row, _ = path_of(one)
    assert row["cameras"] == 4
    assert row["rmse_m"] <= 0.045  # the mark of DESIGN 8
    assert row["n_rtk"] >= 608  # mvus' coverage
