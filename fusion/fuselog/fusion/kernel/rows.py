"""Rows of a matrix in flat memory, each operation one sequence of vector instructions of a fixed width.

LLVM turns loops of a short constant length into scalar code; a row as one vector is several times faster. Multiply
and add stay two roundings, so that every instruction set gives the same bytes. Kernels work on bare pointers, because
counting references to arrays would cost more than the arithmetic. Where these point at lanes, every number of a row is
one of each filter, and so is a factor.
"""
# Numba passes compiler objects to an intrinsic that have no types to check.
# pyright: reportUnknownMemberType=false, reportUnknownArgumentType=false, reportUnknownVariableType=false
# pyright: reportUnknownParameterType=false, reportMissingParameterType=false, reportUnknownLambdaType=false

import math
from collections.abc import Iterator
from typing import Any, Protocol, cast

from llvmlite import ir  # pyright: ignore[reportMissingTypeStubs]  llvmlite ships no stubs
from numba import types  # pyright: ignore[reportMissingTypeStubs]  numba ships no stubs
from numba.core import cgutils  # pyright: ignore[reportMissingTypeStubs]  numba ships no stubs
from numba.extending import intrinsic  # pyright: ignore[reportMissingTypeStubs]  numba ships no stubs

from fuselog.fusion.kernel.lanes import LANES, LanesAt, lanes, mask

Floats = Any  # a pointer to float64

_BYTES = 8  # of a float64
_TILE = 4  # numbers of the smallest vector that all processors have, or put together
_NARROW = 8  # lanes up to which four rows fit the registers of every processor
_LEAST = 2.0**-400  # what a subtraction leaves below it is 0: denormal numbers take long, products of larger are none


class _Place:
    """How rows lie where a pointer points: of single numbers, or of one number of each filter."""

    def __init__(self, pointer: Any) -> None:
        self.each = LANES if isinstance(pointer, LanesAt) else 1
        self.number = lanes if isinstance(pointer, LanesAt) else types.float64

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
        builder.store(row, place, align=_BYTES)


def _spread(builder: Any, value: Any, width: int) -> Any:
    """A row of ``width`` numbers that are all ``value``."""
    mask = [0] * width
    if isinstance(value.type, ir.VectorType):
        one, mask = value, [*range(LANES)] * width
    else:
        one = ir.Constant(ir.VectorType(ir.DoubleType(), width), ir.Undefined)
        one = builder.insert_element(one, value, ir.Constant(ir.IntType(32), 0))
    order = ir.Constant(ir.VectorType(ir.IntType(32), len(mask)), mask)
    return builder.shuffle_vector(one, ir.Constant(one.type, ir.Undefined), order)


def _flush(builder: Any, row: Any) -> Any:
    """The vector with 0 in place of numbers nearer to it than ``_LEAST``; NaN stays."""
    bits = ir.VectorType(ir.IntType(64), row.type.count)
    unsigned = builder.and_(builder.bitcast(row, bits), ir.Constant(bits, [2**63 - 1] * row.type.count))
    size = builder.bitcast(unsigned, row.type)
    keeps = builder.fcmp_unordered(">=", size, ir.Constant(row.type, [_LEAST] * row.type.count))
    return builder.select(keeps, row, ir.Constant(row.type, [0.0] * row.type.count))


def _unpack(builder: Any, values: Any) -> list[Any]:
    return [builder.extract_value(values, i) for i in range(values.type.count)]


def _fixed(width: Any) -> bool:
    return isinstance(width, types.IntegerLiteral)


def _row_copy(typing, to, at, source, start, width):  # noqa: ARG001  numba reads this signature
    """to[at : at + width] = source[start : start + width]."""
    place = _Place(to)

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:  # noqa: ARG001  numba's protocol
        row = place.load(builder, arguments[2], arguments[3], width.literal_value)
        place.store(builder, row, arguments[0], arguments[1])
        return context.get_dummy_value()

    return (types.void(to, types.intp, source, types.intp, width), emit) if _fixed(width) else None


def _row_scale(typing, to, at, source, start, factor, width):  # noqa: ARG001  numba reads this signature
    """to[at : at + width] = factor * source[start : start + width]."""
    place = _Place(to)

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:  # noqa: ARG001  numba's protocol
        row = place.load(builder, arguments[2], arguments[3], width.literal_value)
        scaled = builder.fmul(_spread(builder, arguments[4], width.literal_value), row)
        place.store(builder, scaled, arguments[0], arguments[1])
        return context.get_dummy_value()

    signature = types.void(to, types.intp, source, types.intp, place.number, width)
    return (signature, emit) if _fixed(width) else None


def _row_add(typing, to, at, source, start, factor, width):  # noqa: ARG001  numba reads this signature
    """to[at : at + width] += factor * source[start : start + width]."""
    place = _Place(to)

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:  # noqa: ARG001  numba's protocol
        row = place.load(builder, arguments[2], arguments[3], width.literal_value)
        scaled = builder.fmul(_spread(builder, arguments[4], width.literal_value), row)
        before = place.load(builder, arguments[0], arguments[1], width.literal_value)
        place.store(builder, builder.fadd(before, scaled), arguments[0], arguments[1])
        return context.get_dummy_value()

    signature = types.void(to, types.intp, source, types.intp, place.number, width)
    return (signature, emit) if _fixed(width) else None


def _row_increase(typing, to, at, values, width):  # noqa: ARG001  numba reads this signature
    """to[at : at + width] += values."""
    place = _Place(to)

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:  # noqa: ARG001  numba's protocol
        before = place.load(builder, arguments[0], arguments[1], width.literal_value)
        row = ir.Constant(before.type, ir.Undefined)
        for number, value in enumerate(_unpack(builder, arguments[2])):
            for lane in range(place.each):
                at = ir.Constant(ir.IntType(32), lane)
                own = value if place.each == 1 else builder.extract_element(value, at)
                row = builder.insert_element(row, own, ir.Constant(ir.IntType(32), number * place.each + lane))
        place.store(builder, builder.fadd(before, row), arguments[0], arguments[1])
        return context.get_dummy_value()

    row = types.UniTuple(place.number, len(values))
    return (types.void(to, types.intp, row, width), emit) if _fixed(width) else None


def _row_sum(typing, to, at, source, starts, factors, width):  # noqa: ARG001  numba reads this signature
    """to[at : at + width] = the sum of factors[i] * source[starts[i] : starts[i] + width]."""
    place = _Place(to)

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:  # noqa: ARG001  numba's protocol
        to, at, source, starts, factors, _ = arguments
        long, total = width.literal_value, None
        for start, factor in zip(_unpack(builder, starts), _unpack(builder, factors), strict=True):
            term = builder.fmul(_spread(builder, factor, long), place.load(builder, source, start, long))
            total = term if total is None else builder.fadd(total, term)
        place.store(builder, total, to, at)
        return context.get_dummy_value()

    signature = types.void(
        to,
        types.intp,
        source,
        types.UniTuple(types.intp, len(starts)),
        types.UniTuple(place.number, len(factors)),
        width,
    )
    return (signature, emit) if _fixed(width) else None


def _row_take(typing, to, at, base, place, source, start, step, factors, first, stride, count, scale, width):  # noqa: ARG001  numba reads this signature
    """to[at:] = scale * (base[place:] - sum over c < count of factors[first + c stride] * source[start + c step :]).

    What was made last should come last, or all else would wait for it.
    """
    there = _Place(to)

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:  # noqa: ARG001  numba's protocol
        to, at, base, place, source, start, step, factors, first, stride, count, scale, _ = arguments
        long = width.literal_value
        total = cgutils.alloca_once_value(builder, there.load(builder, base, place, long))
        with cgutils.for_range(builder, count) as loop:
            row = there.load(builder, source, builder.add(start, builder.mul(loop.index, step)), long)
            factor = there.load_number(builder, factors, builder.add(first, builder.mul(loop.index, stride)))
            scaled = builder.fmul(_spread(builder, factor, long), row)
            builder.store(builder.fsub(builder.load(total), scaled), total)
        scaled = builder.fmul(_spread(builder, scale, long), builder.load(total))
        there.store(builder, scaled, to, at)
        return context.get_dummy_value()

    one, two, three = ([types.intp] * count for count in (1, 2, 3))
    signature = types.void(to, *one, base, *one, source, *two, factors, *three, there.number, width)
    return (signature, emit) if _fixed(width) else None


def _row_gather(typing, to, at, source, start, factors, first, count, width):  # noqa: ARG001  numba reads this signature
    """to[at:] = the sum over c < count of factors[first + c] * source[start + c width :]."""
    place = _Place(to)

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:  # noqa: ARG001  numba's protocol
        to, at, source, start, factors, first, count, _ = arguments
        long = width.literal_value
        row = ir.VectorType(ir.DoubleType(), long * place.each)
        total = cgutils.alloca_once_value(builder, ir.Constant(row, [0.0] * row.count))
        with cgutils.for_range(builder, count) as loop:
            line = builder.mul(loop.index, at.type(long))
            factor = place.load_number(builder, factors, builder.add(first, loop.index))
            term = builder.fmul(
                _spread(builder, factor, long), place.load(builder, source, builder.add(start, line), long)
            )
            builder.store(builder.fadd(builder.load(total), term), total)
        place.store(builder, builder.load(total), to, at)
        return context.get_dummy_value()

    one, two = ([types.intp] * count for count in (1, 2))
    signature = types.void(to, *one, source, *one, factors, *two, width)
    return (signature, emit) if _fixed(width) else None


def _take_outer(typing, to, at, left, a, right, b, count, height, width, upper):  # noqa: ARG001  numba reads this signature
    """Row i < height of the matrix ``to`` -= sum over c < count of left[a + c width + i] * row c from ``b`` of right.

    ``upper``: only from the block of the diagonal on; what is left of it keeps what it had. Less than ``_LEAST`` is 0.
    """
    place = _Place(to)

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:  # noqa: ARG001  numba's protocol
        to, at, left, a, right, b, count, *_ = arguments
        stride, number = width.literal_value, at.type
        bands = _bands if place.each == 1 else _tiles
        for first, rows, column, long in bands(height.literal_value, stride, upper.literal_value):
            places = [builder.add(at, number((first + r) * stride + column)) for r in range(rows)]
            totals = [cgutils.alloca_once_value(builder, place.load(builder, to, each, long)) for each in places]
            with cgutils.for_range(builder, count) as loop:
                line = builder.mul(loop.index, number(stride))
                row = place.load(builder, right, builder.add(builder.add(b, number(column)), line), long)
                for r, total in enumerate(totals):
                    factor = place.load_number(builder, left, builder.add(builder.add(a, number(first + r)), line))
                    scaled = builder.fmul(_spread(builder, factor, long), row)
                    builder.store(builder.fsub(builder.load(total), scaled), total)
            for each, total in zip(places, totals, strict=True):
                place.store(builder, _flush(builder, builder.load(total)), to, each)
        return context.get_dummy_value()

    signature = types.void(to, types.intp, left, types.intp, right, types.intp, types.intp, height, width, upper)
    return (signature, emit) if _fixed(width) and _fixed(height) and isinstance(upper, types.BooleanLiteral) else None


def _bands(height: int, stride: int, upper: bool) -> Iterator[tuple[int, int, int, int]]:
    """Rows to work on together: first row, how many, first column, to the end. As many as registers hold."""
    for block, many in _blocks(stride):
        column = block if upper else 0
        together = _TILE if stride - column <= _NARROW else 2
        last = min(block + many, height)
        for first in range(block, last, together):
            yield first, min(together, last - first), column, stride - column


def _tiles(height: int, stride: int, upper: bool) -> Iterator[tuple[int, int, int, int]]:
    """The same of lanes, in pieces of rows, as each number is a vector."""
    for first in range(0, height, 2):
        for column in range(first // _TILE * _TILE if upper else 0, stride, _TILE):
            yield first, min(2, height - first), column, _TILE


def _transpose(typing, to, at, source, start, width):  # noqa: ARG001  numba reads this signature
    """The width x width matrix at ``at`` becomes the transpose of the one at ``start``."""
    place = _Place(to)

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:  # noqa: ARG001  numba's protocol
        to, at, source, start, _ = arguments
        long, number = width.literal_value, at.type
        _settle(builder)
        for i, rows in _blocks(long):
            for j in range(0, long, 2):
                starts = [builder.add(start, number((i + r) * long + j)) for r in range(rows)]
                for c, column in enumerate(_two_columns(builder, place, source, starts)):
                    place.store(builder, column, to, builder.add(at, number((j + c) * long + i)))
        return context.get_dummy_value()

    return (types.void(to, types.intp, source, types.intp, width), emit) if _fixed(width) else None


def _mirror(typing, to, at, width):  # noqa: ARG001  numba reads this signature
    """What lies below the diagonal of the width x width matrix at ``at`` becomes what lies above it."""
    place = _Place(to)

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:  # noqa: ARG001  numba's protocol
        to, at, _ = arguments
        long = width.literal_value

        def offset(row: int, column: int) -> Any:
            return builder.add(at, at.type(row * long + column))

        _settle(builder)
        for i, rows in _blocks(long):
            for j in range(i, long, 2):
                columns = _two_columns(builder, place, to, [offset(i + r, j) for r in range(rows)])
                for row, column in enumerate(columns, j):
                    whole = column
                    if row < i + rows:  # of a row that crosses the diagonal, what lies on and behind it stays
                        own = place.load(builder, to, offset(row, i), rows)
                        choice = [c if i + c < row else rows + c for c in range(rows)]
                        whole = _shuffle(builder, column, own, choice, place.each)
                    place.store(builder, whole, to, offset(row, i))
        return context.get_dummy_value()

    return (types.void(to, types.intp, width), emit) if _fixed(width) else None


def _rows_finite(typing, source, at, height, width):  # noqa: ARG001  numba reads this signature
    """Whether the sum of each column of the matrix at ``at`` is finite, as it is not where a number is not."""
    place = _Place(source)

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:  # noqa: ARG001  numba's protocol
        source, at, *_ = arguments
        long = width.literal_value
        rows = [
            place.load(builder, source, builder.add(at, at.type(i * long)), long) for i in range(height.literal_value)
        ]
        while len(rows) > 1:
            rows = [builder.fadd(p, q) for p, q in zip(rows[::2], rows[1::2], strict=False)] + (
                rows[-1:] if len(rows) % 2 else []
            )
        return _all_finite(builder, rows[0], place.each)

    signature = (mask if place.each > 1 else types.boolean)(source, types.intp, height, width)
    return (signature, emit) if _fixed(width) and _fixed(height) else None


def _all_finite(builder: Any, row: Any, each: int) -> Any:
    """Whether all numbers of a row are, for each lane."""
    words = ir.VectorType(ir.IntType(64), row.type.count)
    size = builder.and_(builder.bitcast(row, words), ir.Constant(words, [2**63 - 1] * words.count))
    found = builder.fcmp_ordered("<", builder.bitcast(size, row.type), ir.Constant(row.type, [math.inf] * words.count))
    if each == 1:
        bits = ir.IntType(words.count)
        return builder.icmp_unsigned("==", builder.bitcast(found, bits), bits(2**words.count - 1))
    lane_bits = ir.Constant(ir.VectorType(ir.IntType(1), each), [1] * each)
    for number in range(words.count // each):
        order = [number * each + lane for lane in range(each)]
        part = builder.shuffle_vector(
            found, ir.Constant(found.type, ir.Undefined), ir.Constant(ir.VectorType(ir.IntType(32), each), order)
        )
        lane_bits = builder.and_(lane_bits, part)
    return lane_bits


def _pack_upper(typing, to, at, source, start, height, width):  # noqa: ARG001  numba reads this signature
    """to[at:] = what lies on and above the diagonal of a matrix, row by row; a few numbers behind that are lost."""
    place = _Place(to)

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:  # noqa: ARG001  numba's protocol
        to, at, source, start, *_ = arguments
        high, long, packed = height.literal_value, width.literal_value, 0
        for i in range(high):
            wide = -(-(high - i) // _TILE) * _TILE
            row = place.load(builder, source, builder.add(start, start.type(i * (long + 1))), wide)
            place.store(builder, row, to, builder.add(at, at.type(packed)))
            packed += high - i
        return context.get_dummy_value()

    signature = types.void(to, types.intp, source, types.intp, height, width)
    return (signature, emit) if _fixed(width) and _fixed(height) else None


def _blocks(long: int) -> Iterator[tuple[int, int]]:
    """First row and how many: as rows are read later, for what was stored in pieces has to reach the cache before."""
    first = 0
    while first < long:
        rows = _NARROW if long - first >= _NARROW else _TILE
        yield first, rows
        first += rows


def _settle(builder: Any) -> None:
    """What was written is read again from memory: there, parts of rows are put together for less."""
    builder.asm(ir.FunctionType(ir.VoidType(), []), "", "~{memory}", [], True)


def _two_columns(builder: Any, place: _Place, source: Any, starts: list[Any]) -> list[Any]:
    """Two columns of rows of which each begins at one of ``starts``."""
    pairs = [place.load(builder, source, start, 2) for start in starts]
    even, odd = (_concatenate(builder, pairs[first::2], place.each) for first in (0, 1))
    half = [(number, len(starts) + number) for number in range(0, len(starts), 2)]
    return [_shuffle(builder, even, odd, [n + c for two in half for n in two], place.each) for c in (0, 1)]


def _concatenate(builder: Any, rows: list[Any], each: int) -> Any:
    """One row of all, as many numbers in each."""
    while len(rows) > 1:
        numbers = [*range(2 * rows[0].type.count // each)]
        rows = [_shuffle(builder, p, q, numbers, each) for p, q in zip(rows[::2], rows[1::2], strict=True)]
    return rows[0]


def _shuffle(builder: Any, p: Any, q: Any, numbers: list[int], each: int) -> Any:
    """A row of numbers of p and, behind these, q."""
    order = [number * each + lane for number in numbers for lane in range(each)]
    return builder.shuffle_vector(p, q, ir.Constant(ir.VectorType(ir.IntType(32), len(order)), order))


class Copy(Protocol):
    """A row (``row_copy``), or a matrix with rows and columns changed (``transpose``)."""

    def __call__(self, to: Floats, at: int, source: Floats, start: int, width: int) -> None:
        """``width`` is a constant."""


class Scaled(Protocol):
    """As ``Copy``, the source times ``factor``."""

    def __call__(self, to: Floats, at: int, source: Floats, start: int, factor: float, width: int) -> None:
        """``width`` is a constant."""


class Sum(Protocol):
    """The sum of some rows of ``source``, each with its own factor."""

    def __call__(
        self, to: Floats, at: int, source: Floats, starts: tuple[int, ...], factors: tuple[float, ...], width: int
    ) -> None:
        """``width`` is a constant."""


class Increase(Protocol):
    """Add as many numbers to a row as it has: one by one they would have to be in memory before the row is read."""

    def __call__(self, to: Floats, at: int, values: tuple[float, ...], width: int) -> None:
        """``width`` is a constant."""


class Outer(Protocol):
    """Subtract a sum of outer products from a matrix."""

    def __call__(
        self,
        to: Floats,
        at: int,
        left: Floats,
        a: int,
        right: Floats,
        b: int,
        count: int,
        height: int,
        width: int,
        upper: bool,
    ) -> None:
        """``height``, ``width`` and ``upper`` are constants."""


class Gather(Protocol):
    """The sum of ``count`` rows of ``source``, one behind the other, each with its own factor."""

    def __call__(
        self, to: Floats, at: int, source: Floats, start: int, factors: Floats, first: int, count: int, width: int
    ) -> None:
        """``width`` is a constant."""


class Pack(Protocol):
    """A symmetric matrix as its upper triangle."""

    def __call__(self, to: Floats, at: int, source: Floats, start: int, height: int, width: int) -> None:
        """``height`` and ``width`` are constants."""


class Finite(Protocol):
    """Whether a matrix has finite numbers only."""

    def __call__(self, source: Floats, at: int, height: int, width: int) -> bool:
        """``height`` and ``width`` are constants."""


class Mirror(Protocol):
    """Make a matrix symmetric."""

    def __call__(self, to: Floats, at: int, width: int) -> None:
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
row_increase = cast(Increase, intrinsic(prefer_literal=True)(_row_increase))
row_sum = cast(Sum, intrinsic(prefer_literal=True)(_row_sum))
row_scale = cast(Scaled, intrinsic(prefer_literal=True)(_row_scale))
row_add = cast(Scaled, intrinsic(prefer_literal=True)(_row_add))
row_take = cast(Take, intrinsic(prefer_literal=True)(_row_take))
row_gather = cast(Gather, intrinsic(prefer_literal=True)(_row_gather))
rows_finite = cast(Finite, intrinsic(prefer_literal=True)(_rows_finite))
pack_upper = cast(Pack, intrinsic(prefer_literal=True)(_pack_upper))
transpose = cast(Copy, intrinsic(prefer_literal=True)(_transpose))
take_outer = cast(Outer, intrinsic(prefer_literal=True)(_take_outer))
mirror = cast(Mirror, intrinsic(prefer_literal=True)(_mirror))
