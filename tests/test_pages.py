"""Tests that the pages name the right folders, links and versions, and are short enough."""

import re

import pytest
import yaml

from tests.test_architecture import FLOORS, ROOT

PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").glob("*.md")])
TEXTS = {page.name: page.read_text(encoding="utf-8") for page in PAGES}
WORDS = 22_000
"""Most words of all pages together, tables included, so that they can still be read."""

_LINK = re.compile(r"\]\(([^)#\s]+)")
_PATH = re.compile(r"`((?:sim|ssac|experiments|tests|docs)/[\w./-]*)`")
_MADE = "results/"  # files that commands make, and `ssac verify` checks


def test_the_folders_of_the_architecture_are_those_there_are():
    row = re.compile(r"^\| `((?:sim|ssac|experiments)/\w+/)` \|", re.MULTILINE)
    told = row.findall(TEXTS["architecture.md"])
    assert all((ROOT / package / "py.typed").is_file() for package in FLOORS)
    there = [
        f"{package}/{folder.name}/"
        for package in FLOORS
        for folder in (ROOT / package).iterdir()
        if any(folder.glob("*.py"))
    ]
    assert sorted(told) == sorted(there), "docs/architecture.md: the table of folders"


def test_the_way_of_a_recording_follows_the_arrows():
    way = TEXTS["architecture.md"].split("## The way of one recording")[1].split("##")[0]
    order = []
    for path in re.findall(r"`((?:sim|ssac|experiments)/[\w/.]+)`", way):
        package, floor, *_ = path.removesuffix(".py").strip("/").split("/")
        order.append((list(FLOORS).index(package), FLOORS[package].index(floor)))
    assert len(order) > 10
    assert order == sorted(order)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_somewhere_and_lines_fit(page):
    text = TEXTS[page.name]
    links = [
        link for link in _LINK.findall(text) if not link.startswith("http") and _MADE not in link
    ]
    assert not [link for link in links if not (page.parent / link).exists()]
    if page.name != "CHANGELOG.md":  # which may name paths of the past
        assert not [path for path in _PATH.findall(text) if not (ROOT / path).exists()]
    # A comment at the start of a line would end the paragraph and show the line as it is written.
    assert not re.findall(r"^ *<!--n:(?!table).*", text, re.MULTILINE)
    # Comments do not count, as a quoted number's name is not shown and its text may change. Nor do
    # rows of tables, which cannot be broken.
    lines = re.sub(r"<!--.*?-->", "", text).splitlines()
    assert not [one for one in lines if len(one) > 120 and not one.startswith("|")]


def test_the_pages_are_short_enough_to_be_read_and_the_readme_has_its_first_screen():
    lines = {name: text.splitlines() for name, text in TEXTS.items()}
    readme = lines["README.md"]
    assert len(readme) <= 120
    assert not [name for name, of_page in lines.items() if len(of_page) > 200]
    assert sum(len(text.split()) for text in TEXTS.values()) <= WORDS
    first = "\n".join(readme[:20])
    assert all(part in first for part in ("p2(t + t_d)'", "![", "make demo", "make tables"))
    assert first.index("![") < first.index("make demo") < first.index("p2(t + t_d)'")


def test_how_to_cite_names_this_version_and_the_paper():
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    project = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    assert f'version = "{citation["version"]}"' in project
    assert citation["license"] == "MIT"
    assert len(citation["preferred-citation"]["authors"]) == 5
    assert f"## [{citation['version']}]" in TEXTS["CHANGELOG.md"]
