"""Tables of the public drone tracks, made up: they may be absent, but not in part nor wrong."""

from itertools import combinations
from pathlib import Path

import pandas as pd
import pytest

from experiments.paper.checksums import record_checksums
from experiments.real.data_sets import COMMAND, DATA_SETS, real_config
from experiments.real.drawing import OFFSETS_FIGURE
from experiments.real.pairs import (
    PAIR_COLUMNS,
    PAIRS_FILE,
    STRAY_COLUMNS,
    STRAYS_FILE,
    TRIPLE_COLUMNS,
    TRIPLES_FILE,
)
from experiments.real.paths import COLUMNS as PATH_COLUMNS
from experiments.real.paths import PATH_FIGURE, PATHS_FILE
from experiments.run.provenance import save_provenance
from experiments.studies.study import save_csv
from experiments.verify.files import file_findings
from experiments.verify.manifest import Manifest, manifest_of
from experiments.verify.real import real_faults


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Give three cameras in each data set; of the last a pair is refused."""
    refused = (DATA_SETS[-1], 1, 2)
    rows = []
    for number in DATA_SETS:
        for i, j in combinations(range(3), 2):
            row = dict.fromkeys(PAIR_COLUMNS, 1.0)
            row |= {"data_set": number, "camera_1": i, "camera_2": j, "models": "a b"}
            row |= {"status": "ok", "clock": "affine", "reason": "", "closure_ms": 2.5}
            row["most_stray_ms"] = 1.5 if i else 0.0
            if number == DATA_SETS[-1]:
                row["closure_ms"] = float("nan")
            if (number, i, j) == refused:
                row |= {"status": "clock_jump", "reason": "it jumps", "t_d_s": float("nan")}
            rows.append(row)
    triples = [(number, "0-1-2", -2.5) for number in DATA_SETS[:-1]]
    strays = [(number, 1, 2, t_s, -0.5 * t_s, 0.1) for number in DATA_SETS for t_s in (2.0, 3.0)]
    save_csv(tmp_path / STRAYS_FILE, pd.DataFrame(strays, columns=STRAY_COLUMNS))
    save_csv(tmp_path / PAIRS_FILE, pd.DataFrame(rows, columns=PAIR_COLUMNS))
    save_csv(tmp_path / TRIPLES_FILE, pd.DataFrame(triples, columns=TRIPLE_COLUMNS))
    paths = [dict.fromkeys(PATH_COLUMNS, 0.5) | {"data_set": number} for number in DATA_SETS]
    save_csv(tmp_path / PATHS_FILE, pd.DataFrame(paths, columns=PATH_COLUMNS))
    tables = PAIRS_FILE, TRIPLES_FILE, STRAYS_FILE, PATHS_FILE
    for name in tables:
        save_provenance(tmp_path / name, COMMAND, real_config(), 1.0, None)
    figures = OFFSETS_FIGURE, *map(PATH_FIGURE.format, DATA_SETS)
    for name in figures:
        (tmp_path / name).write_bytes(b"drawn")
    names = *tables, *figures
    record_checksums(tmp_path, [tmp_path / name for name in names])
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


def test_both_tables_are_there_with_all_they_need_or_none_is(folder: Path) -> None:
    more, *_ = manifest_of({}).optional
    manifest = Manifest((), (), (more,))
    assert not manifest.of(folder / "elsewhere").files
    found = {one.what: one.faults for one in file_findings(folder, manifest)}
    assert not found["no other file is there"]
    assert not found["every file that there must be is there"]
    assert not found[f"{PAIRS_FILE} makes sense"]
    (folder / TRIPLES_FILE).unlink()
    found = {one.what: one.faults for one in file_findings(folder, manifest)}
    assert found["every file that there must be is there"] == (TRIPLES_FILE,)
    path = folder / PAIRS_FILE.replace(".csv", ".provenance.json")
    path.write_text(path.read_text().replace("make real", "make unreal"))
    found = {one.what: one.faults for one in file_findings(folder, manifest)}
    what = f"{path.name}: a clean commit, today's configuration, versions"
    assert any("make unreal" in fault for fault in found[what])
