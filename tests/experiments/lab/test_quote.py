"""Quoted numbers follow the results, and each way of being stale is one clear line."""

import pytest

from experiments import commands
from experiments.lab.quote import rewrite_numbers, stale_numbers
from experiments.lab.results import save_text
from experiments.lab.summary import digits, listed, markdown_table
from experiments.studies import all_studies
from ssac.errors import SsacError

PAGE = """# Page

The low half adds up to <!--n:sum.low-->0<!--/n--> and
the high half to <!--n:sum.high-->no<!--/n-->.

<!--n:table.sums-->
<!--/n-->

```markdown
<!--n:sum.low-->left as it is<!--/n-->
```
"""


def _sum(half):
    return lambda results: f"{results.value('squares', 'sum', half=half):.0f}"


def _table(results):
    return markdown_table(results.table("squares").astype(str))


NUMBERS = {"sum.low": _sum("low"), "sum.high": _sum("high"), "table.sums": _table}


@pytest.fixture
def root(results):
    """A small project: two pages, and the results of one study."""
    save_text(results.parent / "README.md", PAGE)
    save_text(results.parent / "docs" / "a.md", "")
    return results.parent


def test_numbers_are_written_once_and_then_stay_until_a_result_changes(root, monkeypatch):
    assert rewrite_numbers(root, NUMBERS) == [root / "README.md"]
    text = (root / "README.md").read_text()
    assert "to <!--n:sum.low-->29<!--/n--> and" in text
    assert "<!--n:sum.high-->110<!--/n-->." in text
    assert "| low  |  29 |" in text
    assert "left as it is" in text  # what stands in a code block is an example
    assert stale_numbers(root, NUMBERS) == []
    assert rewrite_numbers(root, NUMBERS) == []
    path = root / "results" / "squares.csv"
    path.write_text(path.read_text().replace("29", "30"))
    stale = stale_numbers(root, NUMBERS)
    assert len(stale) == 2  # the sentence and the table
    assert "README.md:3: sum.low is '30', not '29'" in stale[0]
    monkeypatch.setattr(commands, "all_numbers", lambda: NUMBERS)
    with pytest.raises(SsacError, match="2 stale numbers"):
        commands.numbers_command(root, check=True)
    (finding,) = commands.page_findings(root / "results")
    assert list(finding.faults) == stale
    assert not commands.page_findings(root)  # results of another place: no page quotes them
    (typed,) = stale_numbers(root, {"cubes": str} | NUMBERS)[2:]
    assert typed == "cubes is declared and no page quotes it: was it typed by hand?"


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("low", "lower", "squares.csv: no row with half = low"),
        ("sum", "total", "squares.csv: no column sum"),
        ("high", "low", "squares.csv: 2 rows with"),
        (None, "", "squares.csv: no such file: make it first"),
    ],
)
def test_a_gap_in_the_results_names_the_number(root, old, new, said):
    path = root / "results" / "squares.csv"
    path.write_text(path.read_text().replace(old, new)) if old else path.unlink()
    with pytest.raises(SsacError, match=rf"README.md:3: sum.low: .*{said}"):
        rewrite_numbers(root, NUMBERS)
    assert any(said in line for line in stale_numbers(root, NUMBERS))


def test_a_column_that_results_do_not_have_is_stale_and_no_crash(root):
    numbers = NUMBERS | {"sum.low": lambda of: str(of.table("squares")["median"][0])}
    with pytest.raises(SsacError, match=r"README.md:3: sum.low: the results have no 'median'"):
        rewrite_numbers(root, numbers)


def test_an_unknown_name_is_stale_and_a_comment_that_is_not_closed_an_error(root):
    rewrite_numbers(root, NUMBERS)
    page, names = root / "docs" / "a.md", ("minutes.squares", "minutes.cubes", "no.such")
    page.write_text(" ".join(f"<!--n:{name}-->0.0<!--/n-->" for name in names))
    for stale, name in zip(stale_numbers(root, NUMBERS), names[1:], strict=True):
        assert f"{name}: no such number" in stale
    for text in ("<!--n:a-->1\n\n<!--n:b-->2<!--/n-->\n", "`<!--n:a-->`\n\n<!--n:b-->2\n"):
        page.write_text(text)
        (line,) = stale_numbers(root, NUMBERS)
        assert "a.md:3: <!--n:b-->" in line
    page.write_text("a ` alone, <!--n:minutes.squares-->`99`<!--/n-->, ` too\n")
    assert any("99" in line for line in stale_numbers(root, NUMBERS))


def test_names_of_our_numbers_are_single_words_and_of_one_study_each():
    names = [name for study in all_studies().values() for name in study.numbers]
    assert not [name for name in names if " " in name or names.count(name) > 1]


def test_numbers_and_lists_in_words():
    values = (0.0961, 9.96, 0.996, 123.4, 0.0, -0.25, float("nan"))
    assert [digits(one) for one in values] == ["0.096", "10", "1.0", "120", "0.0", "-0.25", "none"]
    assert [listed(some) for some in ("a", "abc")] == ["a", "a, b and c"]
