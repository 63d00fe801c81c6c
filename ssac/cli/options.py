"""Options that several commands share, and functions that make options and arguments."""

import inspect
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, get_type_hints

import typer

from ssac.config import N_MIN, Config
from ssac.errors import SsacError

_TYPES = get_type_hints(Config)


def number(
    help_text: str,
    low: float,
    high: float,
    unit: str = "",
    metavar: str = "",
    default_words: str = "",
) -> Any:
    """Make an option of one or several numbers that must lie between two bounds, both allowed.

    `unit` is a word such as "seconds". Help shows `default_words`, if any, as the default.
    """
    bounds = f"{low:.10g} to {high:.10g}"

    def check(param: typer.CallbackParam, value: Any) -> Any:
        for each in value if isinstance(value, Iterable) else (value,):
            if each is not None and not low <= each <= high:  # true of NaN too
                expected = f"{bounds} {unit}".strip()
                raise SsacError(f"{param.opts[0]}: expected {expected}, got {each:.10g}")
        return value

    return typer.Option(
        help=f"{help_text} From {bounds}{f' {unit}' if unit else ''}.",
        metavar=metavar or unit.upper() or "NUMBER",
        callback=check,
        show_default=default_words or True,
    )


def named(metavar: str, help_text: str, shown: bool | str = True) -> Any:
    """Make an option whose value is a name, a path or the like; `shown` is its default in help."""
    return typer.Option(metavar=metavar, help=help_text, show_default=shown)


def argument(metavar: str, help_text: str) -> Any:
    """Make an argument."""
    return typer.Argument(metavar=metavar, help=help_text, show_default=False)


def flag(name: str, help_text: str) -> Any:
    """Make an option that takes no value."""
    return typer.Option(f"--{name}", help=help_text)


@dataclass(frozen=True)
class Option:
    """One option of a command: its Typer option and the field of Config that it sets, if any."""

    info: Any
    field: str = ""  # field of Config that it sets; gives its type and default; empty: none
    type: Any = bool  # type of a flag, or of an option that sets no field
    default: Any = None  # default of such a flag or option; a flag's None is False
    value: Any = None  # value that a flag gives the field, which otherwise keeps its default

    @property
    def parameter(self) -> tuple[Any, Any]:
        """Type and default of a command's parameter."""
        if self.value is not None or not self.field:
            default = False if self.default is None and self.type is bool else self.default
            return Annotated[self.type, self.info], default
        return Annotated[_TYPES[self.field], self.info], getattr(Config, self.field)


def with_options(
    options: Mapping[str, Option],
) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Replace a command's last parameter, `**options`, by one for each option of a table."""

    def given(command: Callable[..., None]) -> Callable[..., None]:
        *own, _ = inspect.signature(command).parameters.values()
        taken = []
        for name, option in options.items():
            hint, default = option.parameter
            kind = inspect.Parameter.KEYWORD_ONLY
            taken.append(inspect.Parameter(name, kind, default=default, annotation=hint))
        command.__signature__ = inspect.Signature([*own, *taken])  # type: ignore[attr-defined]
        command.__annotations__ = {one.name: one.annotation for one in (*own, *taken)}
        return command

    return given


def file_option(help_text: str, metavar: str = "FILE") -> Option:
    """Make an option whose value is a file's path."""
    return Option(named(metavar, help_text), type=Path | None)


def config_of(options: Mapping[str, Option], given: Mapping[str, Any]) -> Config:
    """Make the configuration that options ask for."""
    fields = {}
    for name, option in options.items():
        if option.field and (option.value is None or given[name]):
            fields[option.field] = given[name] if option.value is None else option.value
    return Config(**fields)


OF_EVENTS = {
    "half_window": Option(
        number("Half of the time window whose events give a position.", 0.001, 0.25, "seconds"),
        "half_window_s",
    ),
    "n_min": Option(
        number(
            "Least number of events for a position.",
            1,
            100_000,
            metavar="COUNT",
            default_words=f"{N_MIN}; fewer for a thin object",
        ),
        "n_min",
    ),
}
JSON_FILE = Option(
    typer.Option("--json", metavar="FILE", help="Write the result as JSON."), type=Path | None
)
LEVER_ARM = Option(
    number(
        "Position of RTK's antenna in the body: forward, left, up. Needs its attitude.",
        -100,
        100,
        "metres",
        metavar="X Y Z",
    ),
    type=tuple[float, float, float] | None,
)
NO_DENOISE = Option(
    flag("no-denoise", "Do not filter hot pixels and isolated events."), "denoise", value=False
)

READING = {
    "allow_damaged": Option(
        flag("allow-damaged", "Read what is left of a damaged event file, with a warning.")
    ),
    "sort": Option(flag("sort", "Sort events that are out of order by less than 1 ms.")),
}
"""Options of every command that reads events."""
