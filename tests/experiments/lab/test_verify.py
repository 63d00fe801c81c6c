"""Damage to each file of results in turn is found, even with its checksum made anew."""

from dataclasses import replace
from functools import cache

import pytest

from experiments.lab import verify
from experiments.lab.results import SUMS_FILE, Results, record_checksums
from experiments.lab.study import NO_RUNS, Runs
from experiments.studies import all_studies
from tests.experiments.lab import squares
from tests.experiments.lab.squares import SQUARES
from tests.experiments.reported import RESULTS


def all_of(folder):
    of_study = verify.study_findings(SQUARES, Results(folder))
    return [*verify.file_findings(folder, [SQUARES]), *of_study]


def faulty(findings):
    return [finding.what for finding in findings if finding.faults]


def sums_made_anew(folder):
    (folder / SUMS_FILE).unlink(missing_ok=True)
    record_checksums(folder, [path for path in folder.rglob("*") if path.is_file()])


def test_complete_results_have_no_fault_and_any_damage_is_found_by_a_checksum(results):
    findings = all_of(results)
    assert not faulty(findings)
    assert len(findings) == 3 + 2 + 2 + 3 + 1
    for name in (*SQUARES.files, *SQUARES.provenances, SUMS_FILE):
        path = results / name
        content = path.read_bytes()
        path.unlink()
        assert faulty(verify.file_findings(results, [SQUARES])), name
        path.write_bytes(squares.flipped(content, len(content) // 2))
        assert faulty(verify.file_findings(results, [SQUARES])), name
        path.write_bytes(content)


def test_another_picture_and_a_file_that_no_command_leaves_are_found(results):
    path = results / "squares.png"
    path.write_bytes(path.read_bytes()[:-1] + b"x")
    sums_made_anew(results)
    (results / "mine.csv").write_text("a\n1\n")
    picture = "squares.png is as it follows from the results"
    assert faulty(all_of(results)) == ["no other file is there", picture]
    for name in ("squares.md", "gone.csv"):
        found = verify.file_findings(results, [SQUARES], {name: "0" * 64})
        assert f"{name} is as it was copied" in faulty(found)


@pytest.mark.parametrize(
    ("old", "new", "fault"),
    [
        ('"0123456789ab"', '"0123456789ab-dirty"', "its commit is 0123456789ab-dirty"),
        ('"0123456789ab"', '"unknown"', "its commit is unknown"),
        ('"ssac study squares"', '"ssac study cubes"', "it was made by `ssac study cubes`"),
        ('"numbers"', '"cubes"', "its configuration is not today's: cubes, numbers"),
        ('"numpy"', '"numpie"', "it lacks the versions of numpy"),
        ('"renderer"', '"painter"', "it does not say which OpenGL drew"),
        ('"wall_time_s": 1.0', '"wall_time_s": -1.0', "it took -1.0 s"),
        # Entries of another form.
        ('"config": {', '"config": null, "was": {', "AttributeError: "),
        ('"gl": {', '"gl": 3, "was": {', "TypeError: "),
        # The label of an axis does not count.
        ('"config": {', '"config": {"figure": {"label": "side of a square"},', None),
    ],
)
def test_a_wrong_provenance_is_found(results, old, new, fault):
    path = results / "squares.provenance.json"
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    sums_made_anew(results)
    found = {one.what.partition(":")[0]: one.faults for one in all_of(results) if one.faults}
    assert set(found) == ({"squares.provenance.json"} if fault else set())
    assert fault is None or found["squares.provenance.json"][0].startswith(fault)


def test_a_shard_alone_is_not_the_study_but_merged_shards_are(results):
    path = results / "squares.provenance.json"
    one, other = (
        path.read_text().replace("ssac study squares", f"ssac study squares --shard {n}/2")
        for n in (1, 2)
    )
    path.write_text(f'{{"command": "ssac merge", "config": {{}}, "shards": [{one}, {other}]}}')
    sums_made_anew(results)
    assert not faulty(all_of(results))


def test_a_number_made_on_another_processor_may_differ_by_its_last_digit(results):
    path, beside = results / "squares.csv", results / "squares.provenance.json"
    path.write_text(path.read_text().replace("110", "110.001"))
    assert any("squares.csv" in one for one in faulty(all_of(results)))
    beside.write_text(beside.read_text().replace('"processor": "', '"processor": "other '))
    what = "squares.csv is as it follows from the results"
    assert what not in faulty(all_of(results))
    path.write_text(path.read_text().replace("110.001", "110.002"))
    assert what in faulty(all_of(results))


def test_runs_that_two_studies_share_are_the_same(results):
    text = (results / "squares_runs.csv").read_text()
    twins = SQUARES, replace(SQUARES, name="others", runs=Runs("others_runs.csv", ("number",)))
    fault = "row 5: square is 98, there 49 (squares_runs.csv, row 5)"
    for others, faults in ((text, ()), (squares.double_a_number(text), (fault,))):
        beside = Results(results, {"others_runs.csv": others})
        assert [one.faults for one in verify.shared_findings(twins, beside)] == [(), faults]


def test_faults_are_short_and_name_the_line():
    assert verify.text_difference("a\nb\n", "a\nb\n") == ()
    assert verify.text_difference("a\nb\n", "a\nc\n") == ("line 2 is b", "line 2 should be c")
    assert verify.text_difference("a\n", "a\nc\n") == ("line 2 is nothing", "line 2 should be c")
    assert verify.text_difference("a\r\n", "a\n") == ("the ends of lines are not the same",)
    assert len(verify.text_difference("x" * 1000, "")[0]) < 200
    lines = list(verify.Finding("something", tuple("abcdefgh")).lines())
    assert lines[0] == "differs something"
    assert lines[-1].strip() == "- and 3 more"


UNGUARDED = ("network_runs.csv", "bench_growth.csv", "real_strays.csv", "reasons_runs.csv")
"""Files whose last number does not follow from other results: a Mahalanobis distance of a pose, a
deviation of a clock's stray, an error of t_d, and how many events a camera recorded."""

COMMITTED = [
    pytest.param(study.name, file, id=file)
    for study in all_studies().values()
    if study.is_committed
    for file in study.files
    if file.endswith((".csv", ".md"))
]


def once(make):
    """Make a file of the committed results once for all damages, which leave these as they are."""
    made = cache(lambda: make(Results(RESULTS)))
    return lambda _: made()


@pytest.mark.parametrize(("name", "file"), COMMITTED)
def test_no_damage_to_a_committed_file_is_hidden_by_its_checksum(name, file):
    """A row that is gone, doubled or changed is a fault, or makes a number on a page stale."""
    study, committed = all_studies()[name], Results(RESULTS)
    is_of_runs = file == study.runs.file
    followed = [
        replace(one, make=once(one.make)) if one.follows and not is_of_runs else one
        for one in study.makes
        if one.file == file or (is_of_runs and ".csv" in one.file)
    ]
    study = replace(study, makes=tuple(followed))  # other files are not made again
    if file.endswith(".csv") and not is_of_runs:
        study = replace(study, runs=NO_RUNS)  # and the runs are not checked
    text = committed.text(file)
    damages = [squares.delete_a_row, squares.double_a_row]
    for damage in damages if file in UNGUARDED else [*damages, squares.double_a_number]:
        damaged = Results(RESULTS, {file: damage(text)})
        assert damaged.text(file) != text
        is_found = any(one.faults for one in verify.study_findings(study, damaged)) or any(
            one(damaged) != one(committed) for one in study.numbers.values()
        )
        assert is_found, damage.__name__
