"""A study from its cells to its files: resumed, in shards, with crashes; no OpenGL.

The study counts letters: what is tested is the bookkeeping.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure
from typer.testing import CliRunner

from experiments import commands
from experiments.cli import app
from experiments.lab import study as module
from experiments.lab import task
from experiments.lab.cache import Cache
from experiments.lab.cell import Measure
from experiments.lab.files import SUMS_FILE, csv_text, read_table
from experiments.lab.schedule import Workers
from experiments.lab.study import Made, Runs, Study, check_runs, numbered, run_study
from sim.recording import SimConfig
from ssac.cli.exits import BUG
from ssac.errors import SsacError

WORDS = ("one", "two", "three", "four")


@dataclass(frozen=True)
class WordCell:
    word: str
    letter: str

    @property
    def recordings(self) -> tuple[Any, ...]:
        return ((SimConfig(), WORDS.index(self.word)),)

    @property
    def columns(self) -> dict[str, Any]:
        return {"word": self.word, "sizes": [len(self.word), 1], "letter": self.letter}

    @property
    def inputs(self) -> str:
        return self.letter


@dataclass(frozen=True)
class WordRow:
    status: str
    reason: str = ""
    count: int = 0
    share: float = np.nan


LOADED: list[str] = []
FAULTS: dict[str, BaseException] = {}


def load_word(cells: Sequence[WordCell], _: Cache) -> str:
    word = cells[0].word
    LOADED.append(word)
    if word in FAULTS:
        raise FAULTS[word]
    return word


def count_row(cell: WordCell, word: str) -> WordRow:
    if cell.letter in FAULTS:
        raise FAULTS[cell.letter]
    count = word.count(cell.letter)
    return WordRow("ok", "", count, count / 3 / len(word))


def word_cells() -> list[WordCell]:
    return [WordCell(word, letter) for letter in "eo" for word in WORDS]


def sums(runs: pd.DataFrame) -> pd.DataFrame:
    ok = runs[runs["status"] == "ok"]
    return ok.groupby("letter", as_index=False)[["count", "share"]].sum()


STUDY = Study(
    "words", "Letters of words", word_cells, Measure(load_word, count_row, WordRow),
    Runs("words_runs.csv", ("word", "letter")),
    (
        Made("words.csv", lambda results: sums(results.table("words_runs"))),
        Made("words.png", lambda _: Figure()),
    ),
    config={"words": WORDS},
)  # fmt: skip

CELLS = word_cells()


@pytest.fixture(autouse=True)
def no_gl(monkeypatch: pytest.MonkeyPatch) -> None:
    """Words need no recordings, so no OpenGL, and stand in no module of ours."""
    LOADED.clear()
    FAULTS.clear()
    monkeypatch.setattr(task, "recording_key", lambda sim, seed: f"recording {seed}")
    monkeypatch.setattr(task, "run_key", lambda *parts: str(abs(hash(parts))))
    monkeypatch.setattr(module, "context_or_none", lambda: None)
    monkeypatch.setattr(commands, "all_studies", lambda: {"words": STUDY})


def study(*arguments: object) -> Any:
    line = ["study", *map(str, arguments), "--workers", "1"]
    return CliRunner().invoke(app, line, catch_exceptions=False)


def test_every_cell_is_a_row_and_the_files_follow_from_it(tmp_path: Path) -> None:
    result = study("words", "--out", tmp_path, "--cache", tmp_path / "cache")
    assert result.exit_code == 0, result.output
    assert {path.name for path in tmp_path.iterdir() if path.is_file()} == {
        "words_runs.csv", "words_runs.provenance.json", "words.csv", "words.provenance.json",
        "words.png", SUMS_FILE,
    }  # fmt: skip
    text = (tmp_path / "words_runs.csv").read_text()
    first, second, *_ = text.splitlines()
    assert first == "cell,word,sizes,letter,status,reason,count,share"
    assert second == '0,one,"[3, 1]",e,ok,,1,0.111111'
    summary = (tmp_path / "words.csv").read_text()
    assert summary.splitlines()[1] == "e,3,0.244444"
    content = json.loads((tmp_path / "words_runs.provenance.json").read_text())
    assert content["command"] == "ssac study words"
    assert content["config"] == {"study": "words", "shard": "1/1", "words": list(WORDS)}


def test_what_is_done_is_not_done_again(tmp_path: Path) -> None:
    first = run_study(STUDY, Cache(tmp_path), Workers(1))
    assert sorted(LOADED) == sorted(WORDS)  # each once, for both letters
    LOADED.clear()
    again = run_study(STUDY, Cache(tmp_path), Workers(1))
    assert LOADED == []
    pd.testing.assert_frame_equal(first.runs, again.runs)


def test_an_interrupted_study_goes_on_where_it_was(tmp_path: Path) -> None:
    FAULTS["three"] = KeyboardInterrupt()
    with pytest.raises(KeyboardInterrupt):
        run_study(STUDY, Cache(tmp_path), Workers(1))
    done = LOADED[:-1]
    assert LOADED[-1] == "three"
    assert done
    FAULTS.clear()
    LOADED.clear()
    runs = run_study(STUDY, Cache(tmp_path), Workers(1)).runs
    assert sorted(LOADED) == sorted(set(WORDS) - set(done))
    assert list(runs["status"]) == ["ok"] * 8


def test_a_crash_is_a_row_and_leaves_the_others(tmp_path: Path) -> None:
    FAULTS["e"] = RuntimeError("a bug")
    FAULTS["two"] = SsacError("unreadable")
    runs = run_study(STUDY, Cache(tmp_path), Workers(1)).runs.set_index(["word", "letter"])
    assert len(runs) == 8
    assert runs.loc[("one", "e"), "status"] == "crashed"
    assert runs.loc[("one", "e"), "reason"] == "e: RuntimeError: a bug"
    assert runs.loc[("one", "o"), "status"] == "ok"
    assert list(runs.loc["two", "status"]) == ["unusable"] * 2
    # Crashed cells are tried again, and no others.
    FAULTS.clear()
    LOADED.clear()
    again = run_study(STUDY, Cache(tmp_path), Workers(1)).runs.set_index(["word", "letter"])
    assert sorted(LOADED) == ["four", "one", "three"]
    assert (again.loc[("one", "e"), "status"], again.loc[("two", "e"), "status"]) == (
        "ok", "unusable",
    )  # fmt: skip


def test_a_crashed_run_makes_the_command_fail(tmp_path: Path) -> None:
    FAULTS["o"] = RuntimeError("a bug")
    result = study("words", "--out", tmp_path, "--cache", tmp_path / "cache")
    assert result.exit_code == BUG
    assert (pd.read_csv(tmp_path / "words_runs.csv")["status"] == "crashed").sum() == 4


@pytest.mark.parametrize("n_shards", [1, 2, 3, 5])
def test_shards_are_a_partition_that_splits_no_recording(n_shards: int) -> None:
    shards = [numbered(word_cells(), (index + 1, n_shards)) for index in range(n_shards)]
    assert sorted(number for shard in shards for number, _ in shard) == list(range(8))
    words = [{cell.word for _, cell in shard} for shard in shards]
    assert sum(map(len, words)) == 4


def test_merged_shards_are_the_same_bytes(tmp_path: Path) -> None:
    whole = tmp_path / "whole"
    assert study("words", "--out", whole, "--cache", tmp_path / "cache").exit_code == 0
    parts = []
    for index in (1, 2, 3):
        folder = tmp_path / f"part{index}"
        done = study("words", "--out", folder, "--cache", folder, "--shard", f"{index}/3")
        assert done.exit_code == 0
        assert not (folder / "words.csv").exists()
        parts.append(folder / "words_runs.csv")
    out = tmp_path / "merged" / "words_runs.csv"
    arguments = ["merge", str(out), *map(str, reversed(parts))]
    result = CliRunner().invoke(app, arguments, catch_exceptions=False)
    assert result.exit_code == 0, result.output
    for name in ("words_runs.csv", "words.csv", "words.png"):
        assert (out.parent / name).read_bytes() == (whole / name).read_bytes(), name
    assert (out.parent / "words.provenance.json").is_file()
    missing = CliRunner().invoke(app, ["merge", str(out), *map(str, parts[:2])])
    assert "2 of 8 cells are in none of the shards" in str(missing.exception)
    other = CliRunner().invoke(app, ["merge", str(tmp_path / "x.csv"), *map(str, parts)])
    assert "are named words_runs.csv" in str(other.exception)


def test_gaps_in_the_runs_are_found(tmp_path: Path) -> None:
    runs = read_table(csv_text(run_study(STUDY, Cache(tmp_path), Workers(1)).runs))
    check_runs(STUDY, runs, CELLS)
    with pytest.raises(SsacError, match="the cells 0 to 7 in order, got 7 rows"):
        check_runs(STUDY, runs.drop(index=3), CELLS)
    with pytest.raises(SsacError, match="the cells 0 to 7 in order"):
        check_runs(STUDY, runs.iloc[[1, 0, *range(2, 8)]], CELLS)
    with pytest.raises(SsacError, match=r"row 2 is of .*'word': 'one'"):
        check_runs(STUDY, runs.assign(word=runs["word"].replace("three", "one")), CELLS)
    with pytest.raises(SsacError, match="row 0 is of"):
        check_runs(STUDY, runs.assign(sizes="[1, 1]"), CELLS)
    with pytest.raises(SsacError, match="no columns letter"):
        check_runs(STUDY, runs.drop(columns="letter"), CELLS)


def test_a_summary_that_needs_another_file_says_so_before_the_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    needy = Study(**{**vars(STUDY), "reads": ("runs.csv",)})
    monkeypatch.setattr(commands, "all_studies", lambda: {"words": needy})
    with pytest.raises(SsacError, match=r"`ssac study words` needs runs.csv in "):
        study("words", "--out", tmp_path, "--cache", tmp_path / "cache")
    assert LOADED == []


def test_the_command_lists_studies_and_knows_no_others() -> None:
    assert study("--list").output.split() == ["words", "Letters", "of", "words"]
    with pytest.raises(SsacError, match="unknown study 'letters': use one of words"):
        study("letters")
    with pytest.raises(SsacError, match="name a study: words"):
        study()
    with pytest.raises(SsacError, match="--shard: expected i/n"):
        study("words", "--shard", "3/2")
