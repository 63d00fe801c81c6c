"""Tables of the public drone tracks, made up: they are part of the results, and make sense."""

from pathlib import Path

import pytest

from experiments.lab.files import record_checksums
from experiments.lab.provenance import save_provenance
from experiments.real.data_sets import COMMAND, real_config
from experiments.real.pairs import PAIRS_FILE, STRAYS_FILE, TRIPLES_FILE
from experiments.real.paths import PATHS_FILE
from experiments.verify.files import file_findings
from experiments.verify.manifest import Manifest, manifest_of, of_real_data
from experiments.verify.real import real_faults
from tests.experiments.flown import write_made_up_flights


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Give a folder with nothing but the tables and figures of real data, made up."""
    write_made_up_flights(tmp_path)
    for name in (PAIRS_FILE, TRIPLES_FILE, STRAYS_FILE, PATHS_FILE):
        save_provenance(tmp_path / name, COMMAND, real_config(), 1.0, None)
    names = [name for name in of_real_data().files if not name.endswith(".json")]
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


def test_real_results_are_there_as_all_others_are() -> None:
    assert set(of_real_data().files) <= set(manifest_of({}).files)


def test_files_that_are_gone_or_changed_are_found(folder: Path) -> None:
    more = of_real_data()
    manifest = Manifest(more.files, more.provenances)
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
