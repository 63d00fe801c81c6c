"""Figures of results and of recordings, drawn the same whenever they are drawn."""

from collections.abc import Callable
from typing import Any

import pandas as pd

from experiments.drawing.style import Figure


def of_errors(name: str, *more: Callable[[], Any]) -> Callable[[pd.DataFrame], Figure]:
    """Declare a figure of `drawing.errors`, of a table and what more is loaded to draw it."""

    def draw(table: pd.DataFrame) -> Figure:
        from experiments.drawing import errors

        drawn: Figure = getattr(errors, name)(table, *(load() for load in more))
        return drawn

    return draw
