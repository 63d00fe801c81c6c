"""Options: the range of numbers, what they say of it, and which field of the config each sets."""

from typing import Annotated

import pytest
import typer
from typer.testing import CliRunner

from ssac.cli import convert, sync
from ssac.cli.options import config_of, number
from ssac.config import Config
from ssac.errors import SsacError

app = typer.Typer(rich_markup_mode=None)


@app.command()
def command(
    half_window: Annotated[float, number("Of a sample.", 0.001, 0.25, "seconds")] = 0.02,
    size: Annotated[tuple[int, int], number("Of a sensor.", 1, 99, metavar="W H")] = (9, 9),
    extent: Annotated[float | None, number("Of a thing.", 1, 2, "metres")] = None,
) -> None:
    typer.echo(f"{half_window} {size} {extent}")


def run(*args: str):
    return CliRunner().invoke(app, args)


HALF_WINDOW = "--half-window: expected 0.001 to 0.25 seconds, got"


@pytest.mark.parametrize(
    ("args", "shown"),
    [
        ("", "0.02 (9, 9) None"),
        ("--half-window 0.001 --size 1 99", "0.001 (1, 99) None"),
        ("--half-window 0.25 --extent 2", "0.25 (9, 9) 2.0"),
        *((f"--half-window {value}", f"{HALF_WINDOW} {value}") for value in ("20", "nan", "-inf")),
        ("--size 9 100", "--size: expected 1 to 99, got 100"),
        ("--extent 0.99", "--extent: expected 1 to 2 metres, got 0.99"),
    ],
)
def test_values_within_the_range_are_taken_and_others_refused_with_range_and_unit(args, shown):
    result = run(*args.split())
    assert (result.stdout.rstrip() or str(result.exception)) == shown
    assert isinstance(result.exception, SsacError) == ("expected" in shown)


def test_help_gives_words_for_values_and_their_range():
    shown = " ".join(run("--help").stdout.split())
    assert "--half-window SECONDS Of a sample. From 0.001 to 0.25 seconds. [default: 0.02]" in shown
    assert "--size W H Of a sensor. From 1 to 99. [default: 9, 9]" in shown
    assert "--extent METRES Of a thing. From 1 to 2 metres." in shown


# --- Fields of the config ---

GIVEN = {
    "search": (-0.3, 0.4),
    "search_all": True,
    "rate_range": (0.9, 1.1),
    "skew_prior": 7.0,
    "clock": "pieces",
    "roughness": 9.0,
    "no_denoise": True,
    "n_samples": 30,
    "half_window": 0.01,
    "n_min": 11,
    "neighbours": 3,
}
CASES = [
    pytest.param(command, name, option, id=f"{command.__name__}-{name}")
    for command in (sync, convert)
    for name, option in command.OPTIONS.items()
    if option.field
]


@pytest.mark.parametrize(("command", "name", "option"), CASES)
def test_an_option_sets_its_field_and_no_other(command, name, option):
    defaults = {key: one.parameter[1] for key, one in command.OPTIONS.items()}
    assert config_of(command.OPTIONS, defaults) == Config()
    changed = config_of(command.OPTIONS, defaults | {name: GIVEN[name]})
    value = GIVEN[name] if option.value is None else option.value
    assert getattr(changed, option.field) == value != getattr(Config(), option.field)
    assert changed == Config(**{option.field: value})
