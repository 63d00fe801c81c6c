"""Types of compiled code."""

from typing import Any

float64: Any
