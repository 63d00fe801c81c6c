"""Numbers that Markdown pages quote from the results, and how they are kept as they are there.

In a page a quoted number stands between two comments, which are not shown when it is rendered:

    the truth is held in <!--n:coverage.tangency.t_d-->93.2 %<!--/n--> of the flights

A table, whose name begins with "table.", stands likewise on lines of its own. A name is declared by
the study that knows the number; `minutes.<name>` is of any study. Each name that is declared is
quoted, and the other way round, so a number that somebody typed in its place is noticed.
"""

import re
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

from experiments.lab.results import PROVENANCE, Results
from ssac.errors import SsacError
from ssac.files.whole_file import whole_file

Numbers = Mapping[str, Callable[[Results], str]]
"""By name: the text as it stands in a page."""

_TABLE, _MINUTES = "table.", "minutes."
_OPEN = re.compile(r"<!--n:([^>]*?)-->")
_QUOTED = re.compile(r"<!--n:(?P<name>[^>]*?)-->(?P<text>.*?)<!--/n-->", re.DOTALL)
_CODE = re.compile(r"^```.*?^```|`[^`\n]*`", re.DOTALL | re.MULTILINE)


def pages(root: Path) -> list[Path]:
    """List the pages that may quote numbers."""
    listed = (root / "README.md", *sorted((root / "docs").glob("*.md")))
    return [path for path in listed if path.exists()]


def rewrite_numbers(root: Path, numbers: Numbers) -> list[Path]:
    """Write what the results say between all comments; return the pages that changed."""
    results = Results(root / "results")
    changed = []
    for path in pages(root):
        before = path.read_text(encoding="utf-8")
        after = with_numbers(before, results, path, numbers)
        if after != before:
            with whole_file(path) as temporary:
                temporary.write_text(after, encoding="utf-8", newline="\n")
            changed.append(path)
    return changed


def stale_numbers(root: Path, numbers: Numbers) -> list[str]:
    """Say, one line each, where pages and results differ.

    That is where a page quotes other than what its results say, where a name, file, row or column
    is not there, and which names no page quotes.
    """
    results = Results(root / "results")
    lines, unquoted = [], dict(numbers)
    for path in pages(root):
        try:
            quoted_here = list(quotations(path.read_text(encoding="utf-8"), path))
        except SsacError as error:
            lines.append(str(error))
            continue
        for name, quoted, line in quoted_here:
            unquoted.pop(name, None)
            try:
                now = value_of(name, results, f"{path}:{line}", numbers)
            except SsacError as error:
                lines.append(str(error))
                continue
            if quoted != now:
                lines.append(f"{path}:{line}: {name} is {_brief(now)}, not {_brief(quoted)}")
    return lines + [
        f"{name} is declared and no page quotes it: was it typed by hand?" for name in unquoted
    ]


def with_numbers(text: str, results: Results, page: Path, numbers: Numbers) -> str:
    """Return a page's text with every quoted number as it is in the results."""
    values = {
        name: value_of(name, results, f"{page}:{line}", numbers)
        for name, _, line in quotations(text, page)
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


def value_of(name: str, results: Results, place: str, numbers: Numbers) -> str:
    """Return what the results say under a name, as it stands in a page.

    Raises
    ------
    SsacError
        With the place and the name, when there is no such name, or no such result.
    """
    try:
        if name in numbers:
            text = numbers[name](results)
            return f"\n{text}\n" if name.startswith(_TABLE) else text
        of = name.removeprefix(_MINUTES)
        if of != name and (results.folder / f"{of}{PROVENANCE}").is_file():
            return _rounded_minutes(results.minutes(of))
        raise SsacError("no such number: a study in experiments/studies/ declares it")
    except SsacError as error:
        raise SsacError(f"{place}: {name}: {error}") from error


def _rounded_minutes(value: float) -> str:
    return f"{value:.0f}" if value >= 1.95 else f"{value:.1f}"


def _code_spans(text: str) -> list[tuple[int, int]]:
    return [match.span() for match in _CODE.finditer(text)]


def _within(position: int, spans: list[tuple[int, int]]) -> bool:
    return any(start <= position < end for start, end in spans)


def _line(text: str, position: int) -> int:
    return text.count("\n", 0, position) + 1


def _brief(text: str) -> str:
    return repr(text) if len(text) < 60 else f"{text[:40]!r}... ({len(text)} characters)"
