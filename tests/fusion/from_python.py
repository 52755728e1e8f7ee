"""Functions that only kernels call, compiled so that a test can call them."""

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba

_Function = TypeVar("_Function", bound=Callable[..., Any])


def from_python(function: _Function) -> _Function:
    """A kernel that is nothing but ``function``."""
    return cast(_Function, numba.njit(error_model="numpy")(cast(Any, function).py_func))
