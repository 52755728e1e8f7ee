"""The one typed door to numba: kernels are compiled here, and nowhere else does a checker need an exception."""

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba  # pyright: ignore[reportMissingTypeStubs]  numba ships no stubs

_Kernel = TypeVar("_Kernel", bound=Callable[..., Any])


def kernel(function: _Kernel) -> _Kernel:
    """Compile ``function`` to machine code on first call, and keep it on disk for the next process.

    No fastmath and no contraction: the same input gives the same bytes on every instruction set.
    """
    return cast(_Kernel, numba.njit(cache=True, error_model="numpy")(function))  # pyright: ignore[reportUnknownMemberType]  numba ships no stubs


def inline(function: _Kernel) -> _Kernel:
    """Compile ``function`` for use inside kernels only; it is cached with the kernel that calls it."""
    return cast(_Kernel, numba.njit(error_model="numpy", inline="never")(function))  # pyright: ignore[reportUnknownMemberType]  numba ships no stubs
