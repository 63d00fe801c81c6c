"""Options of the command line that several commands have, and ranges of numbers."""

from collections.abc import Callable, Iterable
from typing import Annotated, Any

import typer

from ssac.config import N_MIN
from ssac.errors import SsacError


def number(
    help_text: str,
    low: float,
    high: float,
    unit: str = "",
    metavar: str = "",
    default_words: str = "",
) -> Any:
    """Make an option of one or several numbers that must lie between two bounds.

    Parameters
    ----------
    help_text
        What the number is; its range is added.
    low, high
        Least and largest value, both allowed.
    unit
        As a word: "seconds".
    metavar
        How the value is shown; the unit in capitals when empty.
    default_words
        Shown in place of a default that is no number.
    """
    bounds = f"{_plain(low)} to {_plain(high)}"
    return typer.Option(
        help=f"{help_text} From {bounds}{f' {unit}' if unit else ''}.",
        metavar=metavar or unit.upper() or "NUMBER",
        callback=_within(low, high, f"{bounds} {unit}".strip()),
        show_default=default_words or True,
    )


def _within(low: float, high: float, expected: str) -> Callable[[typer.CallbackParam, Any], Any]:
    """Make the check of an option's value; None stands for an option that is not given."""

    def check(param: typer.CallbackParam, value: Any) -> Any:
        values = value if isinstance(value, Iterable) else (value,)
        for each in values:
            if each is not None and not low <= each <= high:  # NaN is not within either
                raise SsacError(f"{param.opts[0]}: expected {expected}, got {_plain(each)}")
        return value

    return check


def _plain(value: float) -> str:
    return f"{value:.10g}"


NoDenoise = Annotated[
    bool, typer.Option("--no-denoise", help="Do not filter hot pixels and isolated events.")
]
AllowDamaged = Annotated[
    bool,
    typer.Option(
        "--allow-damaged", help="Read what is left of a damaged event file, with a warning."
    ),
]
Sort = Annotated[
    bool,
    typer.Option("--sort", help="Sort events that are out of order by less than 1 ms."),
]


def n_min_of(what: str) -> Any:
    """Make the option of how many events it takes; `what` they make: "a position"."""
    return number(
        f"Least number of events for {what}.",
        1,
        100_000,
        metavar="COUNT",
        default_words=f"{N_MIN}; fewer for a thin object",
    )
