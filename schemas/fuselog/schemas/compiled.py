"""The one typed door to numba: kernels are compiled here; no other module needs a checker's exception."""

# pyright: reportUnknownMemberType=false, reportUnknownArgumentType=false, reportUnknownVariableType=false
# pyright: reportUnknownParameterType=false, reportMissingParameterType=false, reportMissingTypeStubs=false
# numba and llvmlite ship no stubs.

import sys
from collections.abc import Callable
from typing import Any, Protocol, TypeVar, cast

import numba
import numpy as np
from llvmlite import ir
from numba.core import types
from numba.core.cgutils import raw_memcpy
from numba.extending import intrinsic
from numpy.typing import NDArray

from fuselog.schemas.parts import PartCompiler

_Kernel = TypeVar("_Kernel", bound=Callable[..., Any])
_Scalar = TypeVar("_Scalar", bound=np.generic)


def kernel(function: _Kernel) -> _Kernel:
    """Compile ``function`` to machine code on first call, and keep it on disk for the next process.

    No fastmath and no contraction: the same input gives the same bytes on every instruction set. What is on
    disk is renewed when the kernel's own module changes, not when one that it calls into does.
    """
    return cast(_Kernel, numba.njit(cache=True, nogil=True, error_model="numpy")(function))


def inline(function: _Kernel) -> _Kernel:
    """Compile ``function`` for use inside kernels only; it is cached with the kernel that calls it.

    Called from Python it raises TypeError.
    """
    return cast(_Kernel, numba.njit(error_model="numpy", inline="never", pipeline_class=PartCompiler)(function))


def once(function: _Kernel) -> _Kernel:
    """As `inline`, for a function that is called from one place, where its code is put."""
    options = {"error_model": "numpy", "inline": "never", "forceinline": True, "pipeline_class": PartCompiler}
    return cast(_Kernel, cast(Any, numba.njit)(**options)(function))


def leaf(function: _Kernel) -> _Kernel:
    """As `inline`, for a function that makes no array: it borrows its arguments, and no call counts references.

    Counting is an atomic operation per array and call, which is more than half of the time of a small function. Its
    code is put where it is called: an array is seven arguments to hand over.
    """
    options = {"error_model": "numpy", "inline": "never", "forceinline": True, "_nrt": False}
    return cast(_Kernel, cast(Any, numba.njit)(**options, pipeline_class=PartCompiler)(function))


class _Load(Protocol):
    def __call__(
        self, data: NDArray[np.uint8], at: int | np.int64, swapped: bool, dtype: type[_Scalar], /
    ) -> _Scalar: ...


def _load(_context: Any, data: Any, at: Any, swapped: Any, dtype: Any) -> Any:  # noqa: ARG001  types only
    scalar = dtype.dtype

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        array = context.make_array(signature.args[0])(context, builder, arguments[0])
        result = context.get_value_type(scalar)
        word = ir.IntType(scalar.bitwidth)
        pointer = builder.bitcast(builder.gep(array.data, [arguments[1]]), word.as_pointer())
        raw = builder.load(pointer, align=1)
        if scalar.bitwidth > 8:
            raw = builder.select(arguments[2], builder.bswap(raw), raw)
        return builder.bitcast(raw, result)

    return scalar(data, types.int64, types.boolean, dtype), generate


load = cast(_Load, intrinsic(_load))
"""Inside kernels: ``load(data, at, swapped, np.float64)`` is the scalar in the bytes from ``data[at]``.

Any alignment; byte-swapped when ``swapped``. Nothing is checked: the caller has looked at the bounds.
"""


class _Store(Protocol):
    def __call__(self, data: NDArray[np.uint8], at: int, value: float, dtype: type[np.generic], /) -> None: ...


def _store(_context: Any, data: Any, at: Any, value: Any, dtype: Any) -> Any:  # noqa: ARG001  types only
    scalar = dtype.dtype

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        array = context.make_array(signature.args[0])(context, builder, arguments[0])
        word = ir.IntType(scalar.bitwidth)
        raw = builder.bitcast(context.cast(builder, arguments[2], signature.args[2], scalar), word)
        builder.store(raw, builder.bitcast(builder.gep(array.data, [arguments[1]]), word.as_pointer()), align=1)
        return context.get_dummy_value()

    return types.void(data, types.int64, value, dtype), generate


store = cast(_Store, intrinsic(_store))
"""Inside kernels: ``store(data, at, value, np.float32)`` writes a scalar to the bytes from ``data[at]``, unchecked."""


class _Copy(Protocol):
    def __call__(self, data: NDArray[Any], at: int, source: NDArray[Any], first: int, count: int, /) -> None: ...


def _copy(_context: Any, data: Any, at: Any, source: Any, first: Any, count: Any) -> Any:  # noqa: ARG001  types only
    width = source.dtype.bitwidth // 8

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        to, taken = (context.make_array(signature.args[i])(context, builder, arguments[i]).data for i in (0, 2))
        size = builder.mul(arguments[4], ir.Constant(ir.IntType(64), width))
        raw_memcpy(builder, builder.gep(to, [arguments[1]]), builder.gep(taken, [arguments[3]]), size, 1)
        return context.get_dummy_value()

    return types.void(data, types.int64, source, types.int64, types.int64), generate


copy = cast(_Copy, intrinsic(_copy))
"""Inside kernels: the bytes of ``source[first : first + count]`` from ``data[at]`` on, both flat arrays, unchecked."""

HOST_IS_BIG_ENDIAN = sys.byteorder == "big"
