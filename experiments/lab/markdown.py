"""Numbers and tables as Markdown, aligned so that they read well as plain text too."""

import re
import textwrap
from collections.abc import Iterable, Sequence

import numpy as np
import pandas as pd

UNKNOWN = "none"
"""Shown in place of a number that there is not."""

_WIDTH = 100
_NUMBER = re.compile(r"-?\d.*|none|")


def markdown_table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Lay out a table; columns of numbers to the right, those with a word to the left."""
    rows = [[cell.replace("|", "\\|") for cell in row] for row in rows]
    columns = list(zip(header, *rows, strict=True))
    widths = [max(3, *map(len, column)) for column in columns]
    right = [all(_NUMBER.fullmatch(cell) for cell in column[1:]) for column in columns]
    rule = ["-:".rjust(width, "-") if to_right else "-" * width
            for width, to_right in zip(widths, right, strict=True)]  # fmt: skip

    def line(row: Sequence[str]) -> str:
        cells = zip(row, widths, right, strict=True)
        return " | ".join(one.rjust(n) if to_right else one.ljust(n) for one, n, to_right in cells)

    return "\n".join(f"| {line(row)} |" for row in (header, rule, *rows))


def paragraph(text: str) -> str:
    """Break a text into lines; a line that starts with "- " is an item of a list."""
    indent = "  " if text.startswith("- ") else ""
    return textwrap.fill(
        " ".join(text.split()), _WIDTH, subsequent_indent=indent,
        break_on_hyphens=False, break_long_words=False,
    )  # fmt: skip


def number(value: float, decimals: int) -> str:
    """Show a number, or that there is none."""
    return f"{value:.{decimals}f}" if np.isfinite(value) else UNKNOWN


def means_with_stds(means: pd.Series, stds: pd.Series, decimals: int) -> list[str]:
    """Show means and deviations, their decimal points below each other."""
    shown = [number(std, decimals) for std in stds]
    wide = max(map(len, shown))
    return [
        f"{number(mean, decimals)} ± {std.rjust(wide)}" if np.isfinite(mean) else UNKNOWN
        for mean, std in zip(means, shown, strict=True)
    ]


def digits(value: float) -> str:
    """Show two significant digits, without an exponent."""
    if not np.isfinite(value):
        return "none"
    rounded = f"{value:.1e}"
    return f"{float(rounded):.{max(1 - int(rounded.split('e')[1]), 0)}f}"


def listed(texts: Iterable[str]) -> str:
    """Join as in a sentence: "a, b and c"."""
    *first, last = texts
    return f"{', '.join(first)} and {last}" if first else last
