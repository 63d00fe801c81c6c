"""The rules of all stages: what values they take, and that a sweep reaches each by its name."""

import ast
from dataclasses import fields, is_dataclass, replace
from pathlib import Path

import numpy as np
import pytest

import ssac
from experiments.lab.grid import configs_of
from ssac import Chain, Config, Observation, SsacError
from ssac.config import checked
from ssac.rules import Rules
from tests.ssac.synthetic import make_events, make_scene


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


def changed(group, name, value):
    """A group of rules, one of which, by its dotted name, is another."""
    part, _, rest = name.partition(".")
    return replace(group, **{part: changed(getattr(group, part), rest, value) if rest else value})


def with_rule(name, value):
    return Config(rules=changed(Rules(), name, value), interval_s=(-0.2, 0.2))


@pytest.fixture(scope="module")
def chain():
    scene = make_scene(seed=1, duration_s=6.0)
    cameras = [Observation(one) for one in make_events(scene, 1, 0.05, size_m=0.4)]
    return Chain(cameras, scene.rig, Config(interval_s=(-0.2, 0.2)))


@pytest.mark.parametrize("name", RULES)
def test_a_sweep_sets_a_rule_by_its_dotted_name_and_one_that_makes_no_sense_is_named(name):
    value = RULES[name]
    _, config = configs_of({f"ssac.rules.{name}": other(value)})
    assert checked(config).rules == with_rule(name, other(value)).rules != Rules()
    assert hash(config) != hash(Config())  # what was found under other rules is not taken for it
    for wrong in (None, "many", [value], *(() if isinstance(value, bool) else (np.nan, True))):
        if isinstance(value, tuple) and not isinstance(wrong, list):
            wrong = (wrong, *value[1:])
        with pytest.raises(SsacError, match=rf"rules\.{name}(\[0\])?: expected [^\n]*$"):
            checked(with_rule(name, wrong))


def test_rules_of_another_kind_are_refused_and_any_number_is_taken():
    for wrong in (None, Config(), Rules().verdict, {}):
        with pytest.raises(SsacError, match=r"rules: expected a ssac\.rules\.Rules"):
            checked(Config(rules=wrong))
    with pytest.raises(SsacError, match=r"rules\.verdict: expected VerdictRules"):
        checked(Config(rules=Rules(verdict=None)))
    for value in (np.float64(0.5), np.int64(1), 1):
        checked(with_rule("verdict.max_spread", value))


def test_a_stage_has_no_rules_but_those_of_its_config():
    """Nothing but the config makes rules, and each of them is read somewhere."""
    made, read = set(), set()
    for path in Path(ssac.__file__).parent.rglob("*.py"):
        nodes = list(ast.walk(ast.parse(path.read_text(encoding="utf-8"))))
        read |= {node.attr for node in nodes if isinstance(node, ast.Attribute)}
        called = [node.func for node in nodes if isinstance(node, ast.Call)]
        if any(isinstance(one, ast.Name) and one.id.endswith("Rules") for one in called):
            made.add(path.name)
    # Functions that people call without a config: of two paths, and of a faint object.
    assert made == {"rules.py", "align.py", "faint.py"}
    assert {name.rpartition(".")[2] for name in RULES} <= read


OTHERS = (
    ("search.rival", 1e9, "ssac"),
    ("view.even_share", 1.5, "ssac"),
    ("fit.least_curvature", 50.0, "joint"),
    ("joint.bias_slope", 0.4, "joint"),
    ("verdict.max_t_d_std_s", 1e-6, "tangency"),
    ("tangency.outline.rank", 4, "tangency"),
    ("albl.inlier_px", 0.5, "albl"),
    ("signals.zncc_bin_s", 0.02, "zncc_e"),
)


@pytest.mark.parametrize(("rule", "value", "method"), OTHERS)
def test_what_was_found_by_other_rules_is_not_given(rule, value, method, chain):
    """Of one chain, whose memory the answers share."""
    by_others = chain.under(with_rule(rule, value)).estimate(method)
    assert repr(by_others) != repr(chain.estimate(method))
