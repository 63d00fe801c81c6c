"""Lines that fit a screen."""

import os
import textwrap
from typing import TextIO

COLUMNS = 100
"""The most that a line has, unless it has a longer word, such as a path."""


def columns(stream: TextIO | None, otherwise: int = COLUMNS) -> int:
    """Give the columns of the terminal that is written to, `COLUMNS` at most; or, of none, others.

    One that does not say its width has `COLUMNS`, and rows of a name and a value need 40.
    """
    try:
        width = os.get_terminal_size(stream.fileno()).columns  # type: ignore[union-attr]
    except (AttributeError, OSError, ValueError):  # closed, a file or a pipe, a notebook's
        return otherwise
    return min(COLUMNS, max(40, width or COLUMNS))


def folded(text: str, width: int, indent: int = 0) -> list[str]:
    """Break a text into lines of so many columns, between words; at least one line.

    All but the first begin with an indent, which is within the width.
    """
    return textwrap.wrap(
        text, width, subsequent_indent=" " * indent, break_long_words=False, break_on_hyphens=False
    ) or [""]
