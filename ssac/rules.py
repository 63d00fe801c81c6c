"""The numbers by which each stage decides between answers, or refuses one.

They were fitted to recordings with known truth, as the comments beside them say. A sweep varies
each of them by its dotted name, as in `ssac.rules.verdict.max_t_d_std_s`; a stage reads them from
the configuration that it is given, and has no copy of its own.
"""

import math
from dataclasses import dataclass, fields, is_dataclass
from typing import Any, get_args, get_origin, get_type_hints

import numpy as np

from ssac.errors import SsacError


@dataclass(frozen=True)
class VerdictRules:
    """When a refined estimate is to be relied upon (`ssac.methods.verdict`)."""

    max_t_d_std_s: float = 0.025  # of an offset; the search's own steps are 20 ms
    max_pose_std_deg: float = 5.0  # of a direction of the pose; a less certain one is unobservable
    # Largest robust deviation of the last step's distances, over the object's rms size.
    max_spread: float = 0.12
    # Largest mean of those distances over their robust deviation, 0.8 for normal errors, where the
    # mean is above small_px and small_share times the object's rms size.
    max_tail: float = 1.8
    small_px: float = 0.2
    small_share: float = 0.06
    # From the rig's intrinsics to those that fit best, in their stated deviations.
    max_against: float = 3.5


@dataclass(frozen=True)
class Rules:
    """The rules of all stages; the defaults are what every committed result was made with."""

    verdict: VerdictRules = VerdictRules()


def check_rules(rules: object) -> None:
    """Refuse rules that are none, or of which one is not of its type or not finite.

    Raises
    ------
    SsacError
        It names the rule, as in `rules.verdict.max_t_d_std_s`.
    """
    if not isinstance(rules, Rules):
        raise SsacError(f"rules: expected a ssac.rules.Rules, got {rules!r}")
    _check_part("rules", Rules, rules)


def _check_part(name: str, kind: Any, value: Any) -> None:
    """Check one rule, or all of a group of rules."""
    if isinstance(kind, type) and is_dataclass(kind):
        if not isinstance(value, kind):
            raise SsacError(f"{name}: expected {kind.__name__}, got {value!r}")
        hints = get_type_hints(kind)
        for one in fields(kind):
            _check_part(f"{name}.{one.name}", hints[one.name], getattr(value, one.name))
    elif get_origin(kind) is tuple:
        kinds = get_args(kind)
        if not (isinstance(value, tuple) and len(value) == len(kinds)):
            raise SsacError(f"{name}: expected {len(kinds)} numbers in a tuple, got {value!r}")
        for place, (inner, item) in enumerate(zip(kinds, value, strict=True)):
            _check_part(f"{name}[{place}]", inner, item)
    elif not _is_of(kind, value):
        word = {bool: "True or False", int: "a whole number", float: "a finite number"}[kind]
        raise SsacError(f"{name}: expected {word}, got {value!r}")


def _is_of(kind: type, value: object) -> bool:
    if kind is bool:
        return isinstance(value, (bool, np.bool_))
    if isinstance(value, (bool, np.bool_)):
        return False
    if kind is int:
        return isinstance(value, (int, np.integer))
    return isinstance(value, (int, float, np.integer, np.floating)) and math.isfinite(value)
