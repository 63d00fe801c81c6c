"""Every file of a complete folder of results is damaged in turn, and each time it is found."""

import json
from pathlib import Path
from shutil import copytree

import pytest

from experiments.lab.files import SUMS_FILE, read_checksums, record_checksums
from experiments.lab.finding import Finding
from experiments.paper.results import SUMMARY_FILE
from experiments.verify import verify as command
from experiments.verify.derived import figure_findings, study_findings, table_findings
from experiments.verify.files import file_findings
from experiments.verify.manifest import Manifest, manifest_of
from tests.experiments.verify.conftest import STUDIES
from tests.experiments.verify.damage import (
    change_a_status,
    damages_of,
    delete,
    double_a_number,
    halve_a_number,
    swap_two_rows,
)

RESULTS = Path(__file__).resolve().parents[3] / "results"


def faulty(findings: list[Finding]) -> list[str]:
    return [finding.what for finding in findings if finding.faults]


def all_findings(results: Path, manifest: Manifest) -> list[Finding]:
    return [
        *file_findings(results, manifest),
        *table_findings(results),
        *study_findings(results, STUDIES),
        *figure_findings(results, STUDIES),
    ]


def test_complete_results_have_no_fault(complete: Path, manifest: Manifest) -> None:
    findings = all_findings(complete, manifest)
    assert [line for finding in findings if finding.faults for line in finding.lines()] == []
    assert len(findings) > 25


def test_every_damage_to_any_file_is_found(results: Path, manifest: Manifest) -> None:
    for name in (*manifest.files, SUMS_FILE):
        path = results / name
        content = path.read_bytes()
        for damage in damages_of(name):
            damage(path)
            assert not path.exists() or path.read_bytes() != content
            assert faulty(file_findings(results, manifest)), f"{damage.__name__}: {name}"
            path.write_bytes(content)
    assert not faulty(file_findings(results, manifest))


@pytest.mark.parametrize("damage", [delete, double_a_number, halve_a_number, swap_two_rows])
@pytest.mark.parametrize(
    "name",
    ["runs.csv", "esim_10.csv", "esim_20.csv", "comparison.csv", "comparison_summary.csv",
     "README.md", "squares_runs.csv", "squares.csv"],
)  # fmt: skip
def test_checksums_made_anew_do_not_hide_it(results: Path, name: str, damage) -> None:
    if (name, damage) == ("squares.csv", swap_two_rows):
        return  # it has one row
    damage(results / name)
    (results / SUMS_FILE).unlink()
    record_checksums(results, [path for path in results.rglob("*") if path.is_file()])
    squares = name.startswith("squares")
    assert faulty(study_findings(results, STUDIES) if squares else table_findings(results))


def test_a_changed_status_is_no_longer_what_the_tables_follow_from(results: Path) -> None:
    change_a_status(results / "runs.csv")
    assert any(name.startswith("esim_") for name in faulty(table_findings(results)))


def test_another_picture_is_found_though_its_checksum_is_right(results: Path) -> None:
    for name in ("squares", "beyond_paper"):
        (results / f"{name}.png").write_bytes((results / "fig4_epipolar.png").read_bytes())
    assert faulty(figure_findings(results, STUDIES)) == [
        "beyond_paper.png is drawn from runs.csv",
        "squares.png is drawn from its CSVs",
    ]


def test_a_file_that_no_command_leaves_is_found(results: Path, manifest: Manifest) -> None:
    (results / "published" / "mine.csv").write_text("a\n1\n")
    assert faulty(file_findings(results, manifest)) == ["no other file is there"]


@pytest.mark.parametrize(
    ("old", "new", "fault"),
    [
        ('"0123456789ab"', '"0123456789ab-dirty"', "its commit is 0123456789ab-dirty"),
        ('"0123456789ab"', '"unknown"', "its commit is unknown"),
        ('"ssac study squares"', '"ssac study cubes"', "it was made by `ssac study cubes`"),
        ('"study": "squares"', '"study": "cubes"', "its configuration is not today's: study"),
        ('"numpy"', '"numpie"', "it lacks the versions of numpy"),
        ('"renderer"', '"painter"', "it does not say which OpenGL drew"),
    ],
)
def test_a_wrong_provenance_is_found(
    results: Path, manifest: Manifest, old: str, new: str, fault: str
) -> None:
    path = results / "squares.provenance.json"
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    record_checksums(results, [path])
    (found,) = [one for one in file_findings(results, manifest) if one.faults]
    assert found.what.startswith("squares.provenance.json")
    assert found.faults[0].startswith(fault)


@pytest.mark.parametrize(("name", "value"), [("config", None), ("versions", []), ("gl", 3)])
def test_a_provenance_of_another_shape_is_a_fault_and_no_crash(
    results: Path, manifest: Manifest, name: str, value: object
) -> None:
    path = results / "squares.provenance.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {name: value}))
    record_checksums(results, [path])
    wrong = faulty([*file_findings(results, manifest), *figure_findings(results, STUDIES)])
    assert wrong[0].startswith("squares.provenance.json")


def test_a_shard_alone_is_not_the_study_but_merged_shards_are(
    results: Path, manifest: Manifest
) -> None:
    path = results / "squares.provenance.json"
    text = path.read_text()
    shards = [text.replace('"ssac study squares"', f'"ssac study squares --shard {n}/2"')
              for n in (1, 2)]  # fmt: skip
    path.write_text(f'{{"command": "ssac merge", "config": {{}}, "shards": [{",".join(shards)}]}}')
    record_checksums(results, [path])
    assert not faulty(file_findings(results, manifest))


@pytest.mark.parametrize("bad", ["drawing,2,", "drawing,-1,s", "cost,2,s,1.0,False,meets"])
def test_a_benchmark_that_makes_no_sense_is_found(
    results: Path, manifest: Manifest, bad: str
) -> None:
    path = results / "bench.csv"
    header, _, *rest = path.read_text().splitlines()
    path.write_text("\n".join([header, bad, *rest]) + "\n")
    record_checksums(results, [path])
    assert faulty(file_findings(results, manifest)) == ["bench.csv is a benchmark"]


@pytest.mark.parametrize(
    ("old", "new", "fault"),
    [
        ("\n346 x 260,5,", "\n346 x 260,7,", "its points are not the 16 of today's benchmark"),
        (",ok,0.01\n", ",no_match,\n", "346 x 260, 5 s, synchronise: no_match"),
        ("peak_mb", "peak", "its columns are sensor, "),
        ("simulate,250000,", "simulate,,", "346 x 260, 5 s, simulate: events_per_camera is "),
    ],
)
def test_a_growth_that_lacks_a_point_is_found(
    results: Path, manifest: Manifest, old: str, new: str, fault: str
) -> None:
    path = results / "bench_growth.csv"
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    record_checksums(results, [path])
    (found,) = [one for one in file_findings(results, manifest) if one.faults]
    assert found.what == "bench_growth.csv has every point"
    assert found.faults[0].startswith(fault)


@pytest.mark.skipif(
    SUMMARY_FILE not in read_checksums(RESULTS),
    reason=f"no tables were written since {SUMMARY_FILE} is one of their files",
)
def test_every_damage_to_the_committed_results_is_found(tmp_path: Path) -> None:
    results = Path(copytree(RESULTS, tmp_path / "results"))
    manifest = manifest_of(command.ALL_STUDIES, command.CAMPAIGNS)
    checked = Manifest(manifest.files, ())  # provenances have a test of their own
    assert not faulty(file_findings(results, checked))
    for name in (*manifest.files, SUMS_FILE):
        path = results / name
        content = path.read_bytes()
        for damage in damages_of(name):
            damage(path)
            assert faulty(file_findings(results, checked)), f"{damage.__name__}: {name}"
            path.write_bytes(content)
