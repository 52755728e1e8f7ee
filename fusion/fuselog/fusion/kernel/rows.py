"""Rows of a matrix in flat memory, each operation one sequence of vector instructions of a fixed width.

LLVM turns loops of a short constant length into scalar code; a row as one vector is several times faster. Multiply
and add stay two roundings, so that every instruction set gives the same bytes. Kernels work on bare pointers, because
counting references to arrays would cost more than the arithmetic. Where these point at lanes, every number of a row is
one of each filter, and so is a factor.
"""
# Numba passes compiler objects to an intrinsic that have no types to check.
# pyright: reportUnknownMemberType=false, reportUnknownArgumentType=false, reportUnknownVariableType=false
# pyright: reportUnknownParameterType=false, reportMissingParameterType=false, reportUnknownLambdaType=false

from typing import Any, Protocol, cast

from llvmlite import ir  # pyright: ignore[reportMissingTypeStubs]  llvmlite ships no stubs
from numba import types  # pyright: ignore[reportMissingTypeStubs]  numba ships no stubs
from numba.core import cgutils  # pyright: ignore[reportMissingTypeStubs]  numba ships no stubs
from numba.extending import intrinsic  # pyright: ignore[reportMissingTypeStubs]  numba ships no stubs

from fuselog.fusion.kernel.lanes import LANES, LanesAt, lanes, mask, store

Floats = Any  # a pointer to float64

_BYTES = 8  # of a float64


class Place:
    """How rows lie where a pointer points: of single numbers, or of one number of each filter."""

    def __init__(self, pointer: Any) -> None:
        self.each = LANES if isinstance(pointer, LanesAt) else 1
        self.number = lanes if isinstance(pointer, LanesAt) else types.float64
        self._pointer = pointer

    def at(self, builder: Any, pointer: Any, offset: Any, width: int) -> Any:
        """Pointer to ``width`` numbers from ``offset``, as one vector."""
        place = builder.gep(pointer, [builder.mul(offset, offset.type(self.each)) if self.each > 1 else offset])
        return builder.bitcast(place, ir.VectorType(ir.DoubleType(), width * self.each).as_pointer())

    def load(self, builder: Any, pointer: Any, offset: Any, width: int) -> Any:
        """The row."""
        return builder.load(self.at(builder, pointer, offset, width), align=_BYTES)

    def load_number(self, builder: Any, pointer: Any, offset: Any) -> Any:
        """A factor."""
        if self.each > 1:
            return self.load(builder, pointer, offset, 1)
        return builder.load(builder.gep(pointer, [offset]), align=_BYTES)

    def store(self, builder: Any, row: Any, pointer: Any, offset: Any) -> None:
        """Put a row there."""
        place = self.at(builder, pointer, offset, row.type.count // self.each)
        if self.each > 1:
            store(builder, row, place, self._pointer)
        else:
            builder.store(row, place, align=_BYTES)


def spread(builder: Any, value: Any, width: int) -> Any:
    """A row of ``width`` numbers that are all ``value``."""
    order = [0] * width
    if isinstance(value.type, ir.VectorType):
        one, order = value, [*range(LANES)] * width
    else:
        one = ir.Constant(ir.VectorType(ir.DoubleType(), width), ir.Undefined)
        one = builder.insert_element(one, value, ir.Constant(ir.IntType(32), 0))
    places = ir.Constant(ir.VectorType(ir.IntType(32), len(order)), order)
    return builder.shuffle_vector(one, ir.Constant(one.type, ir.Undefined), places)


def shuffle(builder: Any, p: Any, q: Any, numbers: list[int], each: int) -> Any:
    """A row of numbers of p and, behind these, q."""
    order = [number * each + lane for number in numbers for lane in range(each)]
    return builder.shuffle_vector(p, q, ir.Constant(ir.VectorType(ir.IntType(32), len(order)), order))


def every(builder: Any, found: Any, place: Place) -> Any:
    """Whether each number of a row of truths is true, for each lane."""
    count = found.type.count
    if place.each == 1:
        whole = 1 << (count - 1).bit_length()  # other lengths are compared bit by bit
        order = [*range(count), *[count] * (whole - count)]
        found = shuffle(builder, found, ir.Constant(found.type, [1] * count), order, 1)
        bits = ir.IntType(whole)
        return builder.icmp_unsigned("==", builder.bitcast(found, bits), bits(2**whole - 1))
    result = ir.Constant(ir.VectorType(ir.IntType(1), place.each), [1] * place.each)
    for number in range(found.type.count // place.each):
        result = builder.and_(result, shuffle(builder, found, found, [number], place.each))
    return result


def unpack(builder: Any, values: Any) -> list[Any]:
    """What a tuple holds."""
    return [builder.extract_value(values, i) for i in range(values.type.count)]


def fixed(width: Any) -> bool:
    """Whether the compiler knows the number."""
    return isinstance(width, types.IntegerLiteral)


def _row_copy(typing, to, at, source, start, width):  # noqa: ARG001  numba reads this signature
    """to[at : at + width] = source[start : start + width]."""
    place = Place(to)

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:  # noqa: ARG001  numba's protocol
        row = place.load(builder, arguments[2], arguments[3], width.literal_value)
        place.store(builder, row, arguments[0], arguments[1])
        return context.get_dummy_value()

    return (types.void(to, types.intp, source, types.intp, width), emit) if fixed(width) else None


def _row_fill(typing, to, at, value, width):  # noqa: ARG001  numba reads this signature
    """to[at : at + width] = value."""
    place = Place(to)

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:  # noqa: ARG001  numba's protocol
        row = spread(builder, arguments[2], width.literal_value * place.each)
        place.store(builder, row, arguments[0], arguments[1])
        return context.get_dummy_value()

    return (types.void(to, types.intp, types.float64, width), emit) if fixed(width) else None


def _row_put(typing, to, at, values):  # noqa: ARG001  numba reads this signature
    """to[at:] = the values, as one piece: a row is read late where parts of it are still on their way to the cache."""
    place = Place(to)

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:  # noqa: ARG001  numba's protocol
        to, at, values = arguments
        numbers = unpack(builder, values)
        if place.each > 1:
            for i, number in enumerate(numbers):
                place.store(builder, number, to, builder.add(at, at.type(i)))
        else:
            row = ir.Constant(ir.VectorType(ir.DoubleType(), len(numbers)), ir.Undefined)
            for i, number in enumerate(numbers):
                row = builder.insert_element(row, number, ir.Constant(ir.IntType(32), i))
            place.store(builder, row, to, at)
        return context.get_dummy_value()

    return types.void(to, types.intp, types.UniTuple(place.number, len(values))), emit


def _row_part(typing, to, at, source, start, count, width):  # noqa: ARG001  numba reads this signature
    """to[at : at + width] = source[start : start + count], and 0 behind it."""
    place = Place(to)

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:  # noqa: ARG001  numba's protocol
        to, at, source, start, *_ = arguments
        short, long = count.literal_value, width.literal_value
        row = place.load(builder, source, start, short)
        zeros = ir.Constant(row.type, [0.0] * row.type.count)
        row = shuffle(builder, row, zeros, [*range(short), *[short] * (long - short)], place.each)
        place.store(builder, row, to, at)
        return context.get_dummy_value()

    signature = types.void(to, types.intp, source, types.intp, count, width)
    return (signature, emit) if fixed(width) and fixed(count) else None


def _row_is(typing, source, at, value, width):  # noqa: ARG001  numba reads this signature
    """Whether each number of source[at : at + width] is the value, for each lane."""
    place = Place(source)

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:  # noqa: ARG001  numba's protocol
        long = width.literal_value
        row = place.load(builder, arguments[0], arguments[1], long)
        return every(builder, builder.fcmp_ordered("==", row, spread(builder, arguments[2], long * place.each)), place)

    result = mask if place.each > 1 else types.boolean
    return (result(source, types.intp, types.float64, width), emit) if fixed(width) else None


def _row_scale(typing, to, at, source, start, factor, width):  # noqa: ARG001  numba reads this signature
    """to[at : at + width] = factor * source[start : start + width]."""
    place = Place(to)

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:  # noqa: ARG001  numba's protocol
        row = place.load(builder, arguments[2], arguments[3], width.literal_value)
        scaled = builder.fmul(spread(builder, arguments[4], width.literal_value), row)
        place.store(builder, scaled, arguments[0], arguments[1])
        return context.get_dummy_value()

    signature = types.void(to, types.intp, source, types.intp, place.number, width)
    return (signature, emit) if fixed(width) else None


def _row_add(typing, to, at, source, start, factor, width):  # noqa: ARG001  numba reads this signature
    """to[at : at + width] += factor * source[start : start + width]."""
    place = Place(to)

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:  # noqa: ARG001  numba's protocol
        row = place.load(builder, arguments[2], arguments[3], width.literal_value)
        scaled = builder.fmul(spread(builder, arguments[4], width.literal_value), row)
        before = place.load(builder, arguments[0], arguments[1], width.literal_value)
        place.store(builder, builder.fadd(before, scaled), arguments[0], arguments[1])
        return context.get_dummy_value()

    signature = types.void(to, types.intp, source, types.intp, place.number, width)
    return (signature, emit) if fixed(width) else None


def _row_take(typing, to, at, base, place, source, start, step, factors, first, stride, count, scale, width):  # noqa: ARG001  numba reads this signature
    """to[at:] = scale * (base[place:] - sum over c < count of factors[first + c stride] * source[start + c step :]).

    What was made last should come last, or all else would wait for it.
    """
    there = Place(to)

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:  # noqa: ARG001  numba's protocol
        to, at, base, place, source, start, step, factors, first, stride, count, scale, _ = arguments
        long = width.literal_value
        total = cgutils.alloca_once_value(builder, there.load(builder, base, place, long))
        with cgutils.for_range(builder, count) as loop:
            row = there.load(builder, source, builder.add(start, builder.mul(loop.index, step)), long)
            factor = there.load_number(builder, factors, builder.add(first, builder.mul(loop.index, stride)))
            scaled = builder.fmul(spread(builder, factor, long), row)
            builder.store(builder.fsub(builder.load(total), scaled), total)
        scaled = builder.fmul(spread(builder, scale, long), builder.load(total))
        there.store(builder, scaled, to, at)
        return context.get_dummy_value()

    one, two, three = ([types.intp] * count for count in (1, 2, 3))
    signature = types.void(to, *one, base, *one, source, *two, factors, *three, there.number, width)
    return (signature, emit) if fixed(width) else None


def _row_gather(typing, to, at, source, start, factors, first, count, width):  # noqa: ARG001  numba reads this signature
    """to[at:] = the sum over c < count of factors[first + c] * source[start + c width :]."""
    place = Place(to)

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:  # noqa: ARG001  numba's protocol
        to, at, source, start, factors, first, count, _ = arguments
        long = width.literal_value
        row = ir.VectorType(ir.DoubleType(), long * place.each)
        total = cgutils.alloca_once_value(builder, ir.Constant(row, [0.0] * row.count))
        with cgutils.for_range(builder, count) as loop:
            line = builder.mul(loop.index, at.type(long))
            factor = place.load_number(builder, factors, builder.add(first, loop.index))
            term = builder.fmul(
                spread(builder, factor, long), place.load(builder, source, builder.add(start, line), long)
            )
            builder.store(builder.fadd(builder.load(total), term), total)
        place.store(builder, builder.load(total), to, at)
        return context.get_dummy_value()

    one, two = ([types.intp] * count for count in (1, 2))
    signature = types.void(to, *one, source, *one, factors, *two, width)
    return (signature, emit) if fixed(width) else None


class Copy(Protocol):
    """A row (``row_copy``), or a matrix with rows and columns changed (``transpose``)."""

    def __call__(self, to: Floats, at: int, source: Floats, start: int, width: int) -> None:
        """``width`` is a constant."""


class Scaled(Protocol):
    """As ``Copy``, the source times ``factor``."""

    def __call__(self, to: Floats, at: int, source: Floats, start: int, factor: float, width: int) -> None:
        """``width`` is a constant."""


class Fill(Protocol):
    """A row of one number."""

    def __call__(self, to: Floats, at: int, value: float, width: int) -> None:
        """``width`` is a constant."""


class Put(Protocol):
    """A row of numbers that are not in memory."""

    def __call__(self, to: Floats, at: int, values: tuple[float, ...]) -> None: ...


class Part(Protocol):
    """A row of fewer numbers."""

    def __call__(self, to: Floats, at: int, source: Floats, start: int, count: int, width: int) -> None:
        """``count`` and ``width`` are constants."""


class Is(Protocol):
    """Whether all numbers of a row are the same one."""

    def __call__(self, source: Floats, at: int, value: float, width: int) -> bool:
        """``width`` is a constant."""
        ...


class Gather(Protocol):
    """The sum of ``count`` rows of ``source``, one behind the other, each with its own factor."""

    def __call__(
        self, to: Floats, at: int, source: Floats, start: int, factors: Floats, first: int, count: int, width: int
    ) -> None:
        """``width`` is a constant."""


class Take(Protocol):
    """Subtract ``count`` rows of ``source``, each with its own factor, from a row, and scale what is left."""

    def __call__(
        self,
        to: Floats,
        at: int,
        base: Floats,
        place: int,
        source: Floats,
        start: int,
        step: int,
        factors: Floats,
        first: int,
        stride: int,
        count: int,
        scale: float,
        width: int,
    ) -> None:
        """``width`` is a constant."""


row_copy = cast(Copy, intrinsic(prefer_literal=True)(_row_copy))
row_fill = cast(Fill, intrinsic(prefer_literal=True)(_row_fill))
row_put = cast(Put, intrinsic(_row_put))
row_part = cast(Part, intrinsic(prefer_literal=True)(_row_part))
row_is = cast(Is, intrinsic(prefer_literal=True)(_row_is))
row_scale = cast(Scaled, intrinsic(prefer_literal=True)(_row_scale))
row_add = cast(Scaled, intrinsic(prefer_literal=True)(_row_add))
row_take = cast(Take, intrinsic(prefer_literal=True)(_row_take))
row_gather = cast(Gather, intrinsic(prefer_literal=True)(_row_gather))
