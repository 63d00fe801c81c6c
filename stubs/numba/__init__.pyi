"""What this suite uses of numba, which carries no types: a compiled function keeps its own."""

from collections.abc import Callable
from typing import Literal, TypeVar, overload

_F = TypeVar("_F", bound=Callable[..., object])

@overload
def njit(function: _F) -> _F: ...
@overload
def njit(
    *,
    cache: bool = False,
    fastmath: bool | set[str] = False,
    nogil: bool = False,
    error_model: Literal["python", "numpy"] = "python",
) -> Callable[[_F], _F]: ...
