"""The rules of all stages: what values they take, and that a sweep reaches each by its name."""

from dataclasses import fields, is_dataclass, replace

import numpy as np
import pytest

from experiments.lab.grid import configs_of
from ssac import Config, SsacError, Status
from ssac.config import checked
from ssac.estimate import Estimate
from ssac.methods.verdict import certain
from ssac.rules import Rules


def rules_of(group, prefix=""):
    """Names and values of all rules, dotted."""
    for one in fields(group):
        value = getattr(group, one.name)
        if is_dataclass(value):
            yield from rules_of(value, f"{prefix}{one.name}.")
        else:
            yield f"{prefix}{one.name}", value


RULES = dict(rules_of(Rules()))


def other(value):
    """Another value of the same type."""
    if isinstance(value, tuple):
        return tuple(map(other, value))
    return not value if isinstance(value, bool) else value + 1


def with_rule(name, value):
    """A config with one rule, by its dotted name, as Python sets it."""
    group, _, field = name.partition(".")
    rules = Rules()
    part = replace(getattr(rules, group), **{field: value})
    return Config(rules=replace(rules, **{group: part}))


@pytest.mark.parametrize("name", RULES)
def test_a_sweep_sets_a_rule_by_its_dotted_name(name):
    value = other(RULES[name])
    _, config = configs_of({f"ssac.rules.{name}": value})
    assert checked(config).rules == with_rule(name, value).rules != Rules()
    assert hash(config) != hash(Config())  # what was found under other rules is not taken for it


@pytest.mark.parametrize("name", RULES)
def test_a_rule_that_makes_no_sense_is_named(name):
    value = RULES[name]
    for wrong in (None, "many", [value], *(() if isinstance(value, bool) else (np.nan, True))):
        if isinstance(value, tuple) and not isinstance(wrong, list):
            wrong = (wrong, *value[1:])
        with pytest.raises(SsacError, match=rf"rules\.{name}(\[0\])?: expected ") as error:
            checked(with_rule(name, wrong))
        assert "\n" not in str(error.value)


def test_rules_of_another_kind_are_refused():
    for wrong in (None, Config(), Rules().verdict, {}):
        with pytest.raises(SsacError, match=r"rules: expected a ssac\.rules\.Rules"):
            checked(Config(rules=wrong))
    with pytest.raises(SsacError, match=r"rules\.verdict: expected VerdictRules"):
        checked(Config(rules=Rules(verdict=None)))


def test_numbers_of_numpy_and_whole_ones_are_rules_too():
    for value in (np.float64(0.5), np.int64(1), 1):
        checked(with_rule("verdict.max_spread", value))


@pytest.mark.parametrize(("std_s", "status"), [(0.024, "ok"), (0.026, "ambiguous_offset")])
def test_an_offset_is_certain_to_25_ms(std_s, status):
    found = Estimate("joint", t_d_s=0.05, t_d_std_s=std_s)
    assert certain(found, Rules().verdict).status == status
    assert certain(found, replace(Rules().verdict, max_t_d_std_s=0.03)).status == Status.OK


@pytest.mark.parametrize(("std_deg", "status"), [(4.9, "ok"), (5.1, "degenerate_pose")])
def test_a_direction_of_the_pose_is_certain_to_5_degrees(std_deg, status):
    covariance = np.diag([1e-6, *np.deg2rad([0.1, 0.1, std_deg, 0.1, 0.1]) ** 2])
    pose = {"R": np.eye(3), "t": np.array([1.0, 0.0, 0.0])}
    found = Estimate("joint", t_d_s=0.05, t_d_std_s=1e-3, covariance=covariance, **pose)
    assert certain(found, Rules().verdict).status == status
    assert certain(found, replace(Rules().verdict, max_pose_std_deg=6.0)).status == Status.OK
