"""Tables of the public drone tracks, made up: they are part of the results, and make sense."""

from pathlib import Path

import pytest

from experiments.real.faults import real_faults
from experiments.real.pairs import PAIRS_FILE, STRAYS_FILE, TRIPLES_FILE
from experiments.real.paths import PATHS_FILE
from tests.experiments.flown import write_made_up_flights


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Give a folder with nothing but the tables and figures of real data, made up."""
    write_made_up_flights(tmp_path)
    return tmp_path


def test_tables_that_agree_have_no_fault(folder: Path) -> None:
    assert real_faults(folder) == ()


@pytest.mark.parametrize(
    ("name", "old", "new", "fault"),
    [
        (PAIRS_FILE, "closure_ms", "closure_s", "columns are data_set"),
        (PAIRS_FILE, "\n1,0,2,", "\n1,0,1,", "a pair is there twice"),
        (PAIRS_FILE, "\n1,0,2,", "\n1,2,3,", "its rows are not all pairs"),
        (PAIRS_FILE, ",ok,affine,", ",fine,affine,", "data set 1, cameras 0 1: fine"),
        (PAIRS_FILE, ",ok,affine,1,", ",ok,affine,,", "data set 1, cameras 0 1: t_d_s is nan"),
        (PAIRS_FILE, "it jumps", "", "data set 4, cameras 1 2: clock_jump, and it does not say"),
        (PAIRS_FILE, ",2.5\n", ",3.5\n", "(1, 0, 1): its closure is 3.5 ms"),
        (TRIPLES_FILE, "1,0-1-2,-2.5\n", "", "real_triples.csv has not each triple"),
        (STRAYS_FILE, "4,1,2,3,-1.5", "4,1,2,3,1.75", "(4, 1, 2): it strays by 1.5 ms"),
        (STRAYS_FILE, "4,1,2,3,-1.5", "4,1,3,3,-1.5", "real_strays.csv has pairs that"),
        (PATHS_FILE, "\n2,", "\n3,", "real_paths.csv has not each data set once"),
        (PATHS_FILE, "\n2,0.5,0.5,0.5,0.5,", "\n2,0.5,0.5,0.4,0.5,", "data set 2: its distances"),
        (TRIPLES_FILE, "2,0-1-2,-2.5", "2,0-1-2,4", "(2, 0, 1): its closure is 2.5 ms"),
    ],
)
def test_what_makes_no_sense_is_found(folder, name, old, new, fault) -> None:
    text = (folder / name).read_text()
    assert old in text
    (folder / name).write_text(text.replace(old, new, 1))
    faults = real_faults(folder)
    assert any(one.startswith(fault) for one in faults), faults
