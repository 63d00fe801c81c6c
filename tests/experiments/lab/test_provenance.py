"""Which code made a result: its commit, and whether files differed from it."""

import subprocess

import pytest

from experiments.lab import provenance


@pytest.fixture
def repository(tmp_path, monkeypatch):
    monkeypatch.setattr(provenance, "_ROOT", tmp_path)

    def git(*arguments):
        identity = ("-c", "user.name=a", "-c", "user.email=a@b", "-c", "commit.gpgsign=false")
        subprocess.run(["git", *identity, *arguments], cwd=tmp_path, check=True)

    (tmp_path / "results").mkdir()
    for name in ("code.py", "results/table.csv"):
        (tmp_path / name).write_text("1\n")
    git("init", "-q")
    git("add", ".")
    git("commit", "-q", "-m", "x")
    return tmp_path


def test_results_that_are_being_made_leave_the_commit_clean(repository):
    commit = provenance.code_commit()
    assert len(commit) == 12
    (repository / "results" / "table.csv").write_text("2\n")
    (repository / "untracked.txt").write_text("3\n")
    assert provenance.code_commit() == commit


def test_changed_code_makes_it_dirty(repository):
    commit = provenance.code_commit()
    (repository / "code.py").write_text("2\n")
    assert provenance.code_commit() == f"{commit}-dirty"


def test_outside_git_it_is_unknown(tmp_path, monkeypatch):
    monkeypatch.setattr(provenance, "_ROOT", tmp_path)
    monkeypatch.setenv("GIT_CEILING_DIRECTORIES", str(tmp_path.parent))
    assert provenance.code_commit() == "unknown"


def test_it_names_the_processor_which_decides_the_last_digits():
    assert provenance.provenance("ssac tables", {}, 1.0, None)["processor"]
