"""Options of commands are fields of the config: each sets its own, and by default none."""

import pytest

from ssac.cli import convert, sync
from ssac.cli.options import config_of
from ssac.config import Config

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
    (command, name, option)
    for command in (sync, convert)
    for name, option in command.OPTIONS.items()
    if option.field
]


@pytest.mark.parametrize(("command", "name", "option"), CASES, ids=str)
def test_an_option_sets_its_field_and_no_other(command, name, option):
    defaults = {key: one.parameter[1] for key, one in command.OPTIONS.items()}
    assert config_of(command.OPTIONS, defaults) == Config()
    changed = config_of(command.OPTIONS, defaults | {name: GIVEN[name]})
    value = GIVEN[name] if option.value is None else option.value
    assert getattr(changed, option.field) == value != getattr(Config(), option.field)
    assert changed == Config(**{option.field: value})
