"""Markdown pages and results in; the pages with each quoted number as it is in the results out.

In a page a quoted number stands between two comments, which are not shown when it is rendered:

    the truth is held in <!--n:coverage.tangency.t_d-->93.2 %<!--/n--> of the flights

A table stands likewise, on lines of its own. `ssac numbers` writes what is between the comments;
`stale_numbers` says where that is not what the results say, and `ssac verify` fails on it.
"""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import typer

from experiments.lab.results import Committed
from experiments.quoted.cells import NUMBERS, Number
from experiments.quoted.tables import TABLES
from ssac.errors import SsacError
from ssac.files.whole_file import whole_file

_OPEN = re.compile(r"<!--n:([^>]*?)-->")
_QUOTED = re.compile(r"<!--n:(?P<name>[^>]*?)-->(?P<text>.*?)<!--/n-->", re.DOTALL)
_CODE = re.compile(r"^```.*?^```|`[^`\n]*`", re.DOTALL | re.MULTILINE)


def numbers_command(
    root: Annotated[
        Path, typer.Option(help="Folder with README.md, docs/ and results/.", metavar="FOLDER")
    ] = Path("."),
    check: Annotated[
        bool, typer.Option("--check", help="Write nothing; fail if a number is stale.")
    ] = False,
) -> None:
    """Write the numbers that README.md and docs/ quote, as they are in results/ now."""
    if check:
        stale = stale_numbers(root)
        for line in stale:
            typer.echo(line)
        if stale:
            raise SsacError(f"{len(stale)} stale numbers: run `ssac numbers`")
        return
    for path in rewrite_numbers(root):
        typer.echo(f"written: {path}")


def pages(root: Path) -> list[Path]:
    """List the pages that may quote numbers."""
    return [
        path
        for path in (root / "README.md", *sorted((root / "docs").glob("*.md")))
        if path.exists()
    ]


def rewrite_numbers(root: Path) -> list[Path]:
    """Write what the results say between all comments; return the pages that changed."""
    results = Committed(root / "results")
    changed = []
    for path in pages(root):
        before = path.read_text(encoding="utf-8")
        after = with_numbers(before, results, path)
        if after != before:
            with whole_file(path) as temporary:
                temporary.write_text(after, encoding="utf-8", newline="\n")
            changed.append(path)
    return changed


def stale_numbers(root: Path) -> list[str]:
    """Say, one line each, where a page of `root` quotes other than what its results say.

    A number whose name, file, row or column is not there is such a line too.
    """
    results = Committed(root / "results")
    lines = []
    for path in pages(root):
        try:
            quoted_here = list(quotations(path.read_text(encoding="utf-8"), path))
        except SsacError as error:
            lines.append(str(error))
            continue
        for name, quoted, line in quoted_here:
            try:
                now = value_of(name, results, f"{path}:{line}")
            except SsacError as error:
                lines.append(str(error))
                continue
            if quoted != now:
                lines.append(f"{path}:{line}: {name} is {_brief(now)}, not {_brief(quoted)}")
    return lines


def with_numbers(text: str, results: Committed, page: Path) -> str:
    """Return a page's text with every quoted number as it is in the results."""
    values = {
        name: value_of(name, results, f"{page}:{line}") for name, _, line in quotations(text, page)
    }
    code = _code_spans(text)

    def replaced(match: re.Match[str]) -> str:
        if _within(match.start(), code):
            return match[0]
        return f"<!--n:{match['name']}-->{values[match['name']]}<!--/n-->"

    return _QUOTED.sub(replaced, text)


def quotations(text: str, page: Path) -> Iterator[tuple[str, str, int]]:
    """Yield (name, text, line) of each number that a page quotes; code is no quotation.

    Raises
    ------
    SsacError
        Where a comment is opened and not closed.
    """
    code = _code_spans(text)
    closed = set()
    for match in _QUOTED.finditer(text):
        if not _within(match.start(), code):
            closed.add(match.start())
            yield match["name"], match["text"], _line(text, match.start())
    for match in _OPEN.finditer(text):
        if match.start() not in closed and not _within(match.start(), code):
            line = _line(text, match.start())
            raise SsacError(
                f"{page}:{line}: <!--n:{match[1]}--> or the one before it is not closed"
            )


def value_of(name: str, results: Committed, place: str) -> str:
    """Return what the results say under a name, as it stands in a page.

    Raises
    ------
    SsacError
        With the place and the name, when there is no such name, or no such result.
    """
    try:
        if name in TABLES:
            return f"\n{TABLES[name](results)}\n"
        return _number(name)(results)
    except SsacError as error:
        raise SsacError(f"{place}: {name}: {error}") from error


def _number(name: str) -> Number:
    if name not in NUMBERS:
        raise SsacError(
            "no such number: the names are in experiments/quoted/, cells.py and tables.py"
        )
    return NUMBERS[name]


def _code_spans(text: str) -> list[tuple[int, int]]:
    return [match.span() for match in _CODE.finditer(text)]


def _within(position: int, spans: list[tuple[int, int]]) -> bool:
    return any(start <= position < end for start, end in spans)


def _line(text: str, position: int) -> int:
    return text.count("\n", 0, position) + 1


def _brief(text: str) -> str:
    return repr(text) if len(text) < 60 else f"{text[:40]!r}... ({len(text)} characters)"
