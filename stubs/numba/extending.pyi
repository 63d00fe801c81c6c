"""What makes a function of compiled code out of instructions."""

from collections.abc import Callable
from typing import Any

def intrinsic(function: Callable[..., object]) -> Any: ...
