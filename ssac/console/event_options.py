"""Options that every command which reads events has, as types of its arguments."""

from typing import Annotated, Any

import typer

from ssac.config import N_MIN
from ssac.console.options import number

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
