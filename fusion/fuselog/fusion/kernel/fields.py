"""A named tuple of arrays as one address: what a kernel is called with, and what it reads its fields from.

Passing eighty arrays to a compiled function takes longer than a step of the filter. A block of addresses is made once,
and kernels work on bare pointers.
"""
# Numba passes compiler objects to an intrinsic that have no types to check.
# pyright: reportUnknownMemberType=false, reportUnknownArgumentType=false, reportUnknownVariableType=false
# pyright: reportUnknownParameterType=false, reportMissingParameterType=false

from collections.abc import Callable
from functools import cache
from typing import Any, Generic, NamedTuple, Protocol, TypeVar, cast, get_args, get_type_hints

import numpy as np
from llvmlite import ir  # pyright: ignore[reportMissingTypeStubs]  llvmlite ships no stubs
from numba import from_dtype, types  # pyright: ignore[reportMissingTypeStubs]  numba ships no stubs
from numba.core.typing.templates import AttributeTemplate, infer_getattr  # pyright: ignore[reportMissingTypeStubs]
from numba.extending import (  # pyright: ignore[reportMissingTypeStubs]  numba ships no stubs
    intrinsic,
    lower_getattr_generic,
    models,
    register_model,
)
from numpy.typing import NDArray

from fuselog.fusion.kernel.lanes import LanesAt
from fuselog.schemas.compiled import kernel

_BYTES = 8  # of an address, and of a number in the block

_Record = TypeVar("_Record", bound=NamedTuple)


@kernel
def _place(array: NDArray[Any]) -> int:
    """The address of the first byte; numpy's own ways take five times as long."""
    return array.ctypes.data


class Block(Generic[_Record]):
    """The fields of ``record`` for a kernel: addresses of its arrays and its numbers, 8 bytes each, from ``at`` on.

    The addresses hold while this object lives. A field annotated ``Annotated[Any, dtype]`` is a flat array of that
    type, one annotated ``int`` or ``float`` a number. Raises TypeError for an array of another type or one with gaps.
    """

    __slots__ = ("_words", "at", "record")

    def __init__(self, record: _Record) -> None:
        self.record = record
        self._words = np.empty(len(record), np.int64)
        for number, (value, dtype) in enumerate(zip(record, _dtypes(type(record)), strict=True)):
            if isinstance(value, np.ndarray):
                if value.dtype != dtype or not value.flags.c_contiguous:
                    name = type(record)._fields[number]
                    raise TypeError(f"{type(record).__name__}.{name} is no row of {dtype}: {value.dtype}")
                self._words[number] = _place(value)
            elif dtype == np.float64:
                self._words.view(np.float64)[number] = value
            else:
                self._words[number] = value
        self.at = _place(self._words)

    def put(self, name: str, number: int) -> None:
        """Change a whole number for the kernels; ``record`` stays as it was made."""
        self._words[type(self.record)._fields.index(name)] = number


def call(function: Callable[..., int | None], *arguments: Block[Any] | NamedTuple | float) -> int:
    """Call a kernel: named tuples become blocks for as long as it runs; one that stays the same comes as a block."""
    blocks = [Block(argument) if isinstance(argument, tuple) else argument for argument in arguments]
    return function(*[block.at if isinstance(block, Block) else block for block in blocks]) or 0


@cache
def _dtypes(kind: type[NamedTuple]) -> tuple[np.dtype[Any], ...]:
    """What each field holds, as arrays or as a number."""
    hints = get_type_hints(kind, include_extras=True)
    return tuple(np.dtype(get_args(hints[name])[1] if get_args(hints[name]) else hints[name]) for name in kind._fields)


@cache
def own_of(kind: type[NamedTuple]) -> tuple[bool, ...]:
    """Which fields of a record are each filter's own where several are moved together."""
    return tuple(np.float64 in marks or "own" in marks for marks in _marks(kind))


def _marks(kind: type[NamedTuple]) -> list[tuple[Any, ...]]:
    """What is said of each field besides that it is an array."""
    hints = get_type_hints(kind, include_extras=True)
    return [get_args(hints[name])[1:] for name in kind._fields]


class _Fields(types.Type):
    """A pointer to a block; ``held``: what is read of it once stays in a register, whatever is stored meanwhile.

    ``several``: of filters that are moved together.
    """

    def __init__(self, kind: type[NamedTuple], *, held: bool, several: bool) -> None:
        self.names = kind._fields
        numbers = [from_dtype(dtype) for dtype in _dtypes(kind)]
        self.kinds: list[Any] = []
        for number, own, marks in zip(numbers, own_of(kind), _marks(kind), strict=True):
            pointer = LanesAt(number, out="out" in marks) if several and own else types.CPointer(number)
            self.kinds.append(pointer if marks else number)
        self.held = held
        super().__init__(name=f"Fields({kind.__name__}, {held}, {several})")


register_model(_Fields)(models.OpaqueModel)


@infer_getattr
class _FieldsAttribute(AttributeTemplate):
    key = _Fields

    def generic_resolve(self, fields: Any, name: str) -> Any:
        return fields.kinds[fields.names.index(name)] if name in fields.names else None


@lower_getattr_generic(_Fields)
def _load_field(context: Any, builder: Any, fields: Any, value: Any, name: str) -> Any:
    number = fields.names.index(name)
    place = builder.gep(value, [ir.Constant(ir.IntType(64), number * _BYTES)])
    field = builder.load(builder.bitcast(place, context.get_value_type(fields.kinds[number]).as_pointer()))
    if fields.held:
        field.set_metadata("invariant.load", builder.module.add_metadata([]))
    return field


def _record_at(typing, at, kind):  # noqa: ARG001  numba reads this signature
    """The record of the block at an address, with a pointer in each array's place."""
    return _at(_Fields(kind.instance_class, held=False, several=False), kind)


def _held_record_at(typing, at, kind):  # noqa: ARG001  numba reads this signature
    """The same, its fields read once: where rows are long that saves more than the registers are worth."""
    return _at(_Fields(kind.instance_class, held=True, several=False), kind)


def _lanes_at(typing, at, kind):  # noqa: ARG001  numba reads this signature
    """The same of filters that are moved together: a lane for each, see ``lanes``."""
    return _at(_Fields(kind.instance_class, held=True, several=True), kind)


def _at(result: _Fields, kind: Any) -> Any:
    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:  # noqa: ARG001  numba's protocol
        return builder.inttoptr(arguments[0], context.get_value_type(result))

    return result(types.int64, kind), emit


class _RecordAt(Protocol):
    def __call__(self, at: int, kind: type[_Record]) -> _Record:
        """Inside kernels only."""
        ...


record_at = cast(_RecordAt, intrinsic(_record_at))
held_record_at = cast(_RecordAt, intrinsic(_held_record_at))
lanes_at = cast(_RecordAt, intrinsic(_lanes_at))
