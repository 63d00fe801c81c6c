"""Numbers that Markdown pages quote from the results: their update, and a check for stale ones.

A quoted number stands between two comments, which are not shown when the page is rendered:

    the truth is held in <!--n:coverage.tangency.t_d-->93.2 %<!--/n--> of the flights

A table, whose name begins with "table.", stands likewise on lines of its own. The study that knows
a number declares its name; `minutes.<name>` exists for any study. Every declared name is quoted and
every quoted name declared, so a number that somebody typed in its place is noticed.
"""

import re
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

from experiments.lab.results import PROVENANCE, Results, save_text
from ssac.errors import SsacError

Numbers = Mapping[str, Callable[[Results], str]]
"""Functions by name, each of which returns a number's text as it stands in a page."""

_TABLE, _MINUTES = "table.", "minutes."
_CODE = r"^```.*?^```|`<!--n:[^`\n]*`|`(?:(?!<!--n:)[^`\n])*`"
_QUOTED = r"<!--n:(?P<name>[^>]*?)-->(?P<text>.*?)<!--/n-->"
_OPEN = re.compile(r"<!--n:(?P<open>[^>]*?)-->")
_CODE_OR_QUOTED = re.compile(rf"{_CODE}|{_QUOTED}|{_OPEN.pattern}", re.DOTALL | re.MULTILINE)


def pages(root: Path) -> list[Path]:
    """List the pages that may quote numbers."""
    listed = (root / "README.md", *sorted((root / "docs").glob("*.md")))
    return [path for path in listed if path.exists()]


def rewrite_numbers(root: Path, numbers: Numbers) -> list[Path]:
    """Update all quoted numbers from the results; return the pages that changed."""
    results = Results(root / "results")
    changed = []
    for path in pages(root):
        before, after, end = path.read_text(encoding="utf-8"), "", 0
        for match, place in quotations(before, path):
            now = value_of(match["name"], results, place, numbers)
            after += before[end : match.start("text")] + now
            end = match.end("text")
        after += before[end:]
        if after != before:
            save_text(path, after)
            changed.append(path)
    return changed


def stale_numbers(root: Path, numbers: Numbers) -> list[str]:
    """List quotations that differ from the results or have no source, and names never quoted."""
    results = Results(root / "results")
    lines, unquoted = [], dict(numbers)
    for path in pages(root):
        try:
            quoted_here = list(quotations(path.read_text(encoding="utf-8"), path))
        except SsacError as error:
            lines.append(str(error))
            continue
        for match, place in quoted_here:
            name, quoted = match["name"], match["text"]
            unquoted.pop(name, None)
            try:
                now = value_of(name, results, place, numbers)
            except SsacError as error:
                lines.append(str(error))
                continue
            if quoted != now:
                lines.append(f"{place}: {name} is {_brief(now)}, not {_brief(quoted)}")
    return lines + [
        f"{name} is declared and no page quotes it: was it typed by hand?" for name in unquoted
    ]


def quotations(text: str, page: Path) -> Iterator[tuple[re.Match[str], str]]:
    """Yield match and place of each quoted number outside code; SsacError if one is not closed."""
    for match in _CODE_OR_QUOTED.finditer(text):
        nested = _OPEN.search(text, *match.span("text")) if match["text"] else None
        start = (nested or match).start()
        place = f"{page}:{text.count(chr(10), 0, start) + 1}"
        unclosed = nested["open"] if nested else match["open"]
        if unclosed is not None:
            raise SsacError(f"{place}: <!--n:{unclosed}--> or the one before it is not closed")
        if match["name"] is not None:
            yield match, place


def value_of(name: str, results: Results, place: str, numbers: Numbers) -> str:
    """Return a named number's text from the results; SsacError names the place and the number."""
    try:
        if name in numbers:
            text = numbers[name](results)
            return f"\n{text}\n" if name.startswith(_TABLE) else text
        of = name.removeprefix(_MINUTES)
        if of != name and (results.folder / f"{of}{PROVENANCE}").is_file():
            minutes = results.minutes(of)
            return f"{minutes:.0f}" if minutes >= 1.95 else f"{minutes:.1f}"
        raise SsacError("no such number: a study in experiments/studies/ declares it")
    except SsacError as error:
        raise SsacError(f"{place}: {name}: {error}") from error
    except LookupError as error:
        raise SsacError(f"{place}: {name}: the results have no {error}: make them anew") from error


def _brief(text: str) -> str:
    return repr(text) if len(text) < 60 else f"{text[:40]!r}... ({len(text)} characters)"
