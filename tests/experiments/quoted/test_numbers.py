"""Quoted numbers follow the results, and each way of being stale is one clear line."""

import shutil
from pathlib import Path

import pandas as pd
import pytest

from experiments.cli import COMMANDS
from experiments.lab.results import Committed
from experiments.quoted.cells import NUMBERS, digits, listed
from experiments.quoted.numbers import (
    numbers_command,
    pages,
    quotations,
    rewrite_numbers,
    stale_numbers,
)
from experiments.quoted.tables import TABLES
from ssac.errors import SsacError

ROOT = Path(__file__).resolve().parents[3]

PAGE = """# Page

`joint` holds the truth in <!--n:coverage.joint.t_d-->0.0 %<!--/n--> of
<!--n:coverage.flights-->no<!--/n--> flights.

<!--n:table.coverage-->
<!--/n-->

```markdown
<!--n:coverage.joint.t_d-->left as it is<!--/n-->
```
"""

METHODS = ("joint", "tangency", "joint-known", "tangency-known")


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """Return a small project: one page, one file of results."""
    (tmp_path / "docs").mkdir()
    (tmp_path / "results").mkdir()
    (tmp_path / "README.md").write_text(PAGE)
    (tmp_path / "docs" / "a.md").write_text("no numbers\n")
    rows = [
        {
            "method": method,
            "quantity": quantity,
            "angle_deg": angle,
            "n_runs": 40,
            "rms_normalised": 1.0,
            "coverage_95": 0.95,
            "coverage_95_low": 0.9,
            "coverage_95_high": 0.99,
        }
        for method in METHODS
        for quantity in ("t_d", "R", "t", "skew")
        for angle in ("30", "all")
    ]
    pd.DataFrame(rows).to_csv(tmp_path / "results" / "coverage.csv", index=False)
    return tmp_path


def test_numbers_are_written_once_and_then_stay(root: Path) -> None:
    assert rewrite_numbers(root) == [root / "README.md"]
    text = (root / "README.md").read_text()
    assert "in <!--n:coverage.joint.t_d-->95.0 %<!--/n--> of" in text
    assert "<!--n:coverage.flights-->40<!--/n--> flights" in text
    assert "| `tangency-known` |" in text.replace("  ", "")
    assert "left as it is" in text  # what stands in a code block is an example
    assert stale_numbers(root) == []
    assert rewrite_numbers(root) == []


def test_a_changed_result_makes_the_page_stale(root: Path) -> None:
    rewrite_numbers(root)
    path = root / "results" / "coverage.csv"
    path.write_text(
        path.read_text().replace("joint,t_d,all,40,1.0,0.95", "joint,t_d,all,40,1.0,0.9")
    )
    stale = stale_numbers(root)
    assert len(stale) == 2  # the sentence and the table
    assert "README.md:3: coverage.joint.t_d is '90.0 %', not '95.0 %'" in stale[0]
    with pytest.raises(SsacError, match="2 stale numbers"):
        numbers_command(root, check=True)


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        (lambda t: t.replace("all", "every"), "no row with"),
        (lambda t: t.replace("coverage_95,", "coverage_97,"), "no column coverage_95"),
        (lambda t: t + t.split("\n", 1)[1], "2 rows with"),
    ],
)
def test_a_gap_in_the_results_names_the_number(root: Path, damage, said: str) -> None:
    path = root / "results" / "coverage.csv"
    path.write_text(damage(path.read_text()))
    with pytest.raises(
        SsacError, match=rf"README.md:3: coverage.joint.t_d: .*coverage.csv: {said}"
    ):
        rewrite_numbers(root)
    assert any(said in line for line in stale_numbers(root))


def test_a_missing_file_and_an_unknown_name_are_stale(root: Path) -> None:
    page = root / "docs" / "a.md"
    page.write_text("<!--n:minutes.refusal-->1<!--/n--> <!--n:no.such-->1<!--/n-->\n")
    stale = [line for line in stale_numbers(root) if "a.md" in line]
    assert len(stale) == 2
    assert "minutes.refusal" in stale[0]
    assert "refusal.provenance.json" in stale[0]
    assert "no.such: no such number" in stale[1]


def test_a_comment_that_is_not_closed_is_an_error(root: Path) -> None:
    (root / "docs" / "a.md").write_text("<!--n:a-->1\n\n<!--n:b-->2<!--/n-->\n")
    assert ["a.md:3: <!--n:b-->" in line for line in stale_numbers(root)].count(True) == 1


def test_every_number_of_our_pages_has_a_name() -> None:
    for page in pages(ROOT):
        for name, _, line in quotations(page.read_text(encoding="utf-8"), page):
            assert name in NUMBERS or name in TABLES, f"{page.name}:{line}: {name}"


def test_names_are_single_words() -> None:
    assert not set(NUMBERS) & set(TABLES)
    assert all(" " not in name for name in (*NUMBERS, *TABLES))


def test_results_are_read_by_their_values(root: Path) -> None:
    results = Committed(root / "results")
    assert results.value("coverage", "n_runs", method="joint", quantity="R", angle_deg="all") == 40
    assert results.texts("coverage", "n_runs", method="joint", quantity="R") == ["40", "40"]
    shutil.rmtree(root / "results")
    with pytest.raises(SsacError, match="no such file: a page quotes it"):
        Committed(root / "results").table("coverage")


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.0961, "0.096"),
        (9.96, "10"),
        (0.996, "1.0"),
        (123.4, "120"),
        (0.0, "0.0"),
        (-0.25, "-0.25"),
    ],
)
def test_digits(value: float, text: str) -> None:
    assert digits(value) == text


def test_listed() -> None:
    assert listed(["a"]) == "a"
    assert listed("abc") == "a, b and c"


def test_the_command_is_there() -> None:
    assert any(command.name == "numbers" for command in COMMANDS)


def test_an_ablation_that_is_not_there_is_named_by_the_page_that_quotes_it(tmp_path: Path) -> None:
    with pytest.raises(SsacError, match="no such file: a page quotes it"):
        TABLES["table.ablation.rotors"](Committed(tmp_path))
    rows = [{"sim.rotor_hz": hz, "method": "joint", "n_runs": 2, "failed": 0,
             "t_d_error_ms_mean": 0.2, "r_error_deg_mean": 0.1} for hz in (0, 60)]  # fmt: skip
    pd.DataFrame(rows).to_csv(tmp_path / "ablation_rotors.csv", index=False)
    last = TABLES["table.ablation.rotors"](Committed(tmp_path)).splitlines()[-1]
    assert last.split()[1:4] == ["60", "|", "0.20"]
