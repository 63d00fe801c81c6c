"""The base class of the errors that `sim` raises on purpose, and the check of config numbers."""

import math
from collections.abc import Iterable
from typing import Any


class SimError(ValueError):
    """Bad input: the message says what was expected, what came and what to do."""


def check_numbers(
    config: Any, of: str, positive: Iterable[str] = (), or_zero: Iterable[str] = ()
) -> None:
    """Raise SimError unless fields of a config are finite and positive (or 0, if in `or_zero`)."""
    for name in positive:
        if not 0.0 < getattr(config, name) < math.inf:
            raise SimError(f"{of}{name} must be a positive number, got {getattr(config, name)}")
    for name in or_zero:
        if not 0.0 <= getattr(config, name) < math.inf:
            raise SimError(
                f"{of}{name} must be 0 or a positive number, got {getattr(config, name)}"
            )
