"""Text in lines that fit the width of a terminal."""

import os
import textwrap
from typing import TextIO

COLUMNS = 100
"""Largest length of a line, unless one word, such as a path, is longer."""


def columns(stream: TextIO | None, otherwise: int = COLUMNS) -> int:
    """Return the width of the terminal behind a stream, 40 to `COLUMNS`; else `otherwise`."""
    try:
        width = os.get_terminal_size(stream.fileno()).columns  # type: ignore[union-attr]
    except (AttributeError, OSError, ValueError):  # a closed stream, a file, a pipe or a notebook
        return otherwise
    return min(COLUMNS, max(40, width or COLUMNS))  # rows of a name and a value need 40


def folded(text: str, width: int, indent: int = 0) -> list[str]:
    """Break a text between words into lines of at most `width` columns; at least one line."""
    return textwrap.wrap(
        text, width, subsequent_indent=" " * indent, break_long_words=False, break_on_hyphens=False
    ) or [""]
