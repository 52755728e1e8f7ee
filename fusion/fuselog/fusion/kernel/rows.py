"""Rows of a matrix in flat memory, each operation one sequence of vector instructions of a fixed width.

LLVM turns loops of a short constant length into scalar code; a row as one vector is several times faster. Multiply
and add stay two roundings, so that every instruction set gives the same bytes. Kernels work on bare pointers, because
counting references to arrays would cost more than the arithmetic.
"""
# Numba passes compiler objects to an intrinsic that have no types to check.
# pyright: reportUnknownMemberType=false, reportUnknownArgumentType=false, reportUnknownVariableType=false
# pyright: reportUnknownParameterType=false, reportMissingParameterType=false, reportUnknownLambdaType=false

from collections.abc import Iterator
from typing import Any, Protocol, cast

from llvmlite import ir  # pyright: ignore[reportMissingTypeStubs]  llvmlite ships no stubs
from numba import types  # pyright: ignore[reportMissingTypeStubs]  numba ships no stubs
from numba.core import cgutils  # pyright: ignore[reportMissingTypeStubs]  numba ships no stubs
from numba.extending import intrinsic  # pyright: ignore[reportMissingTypeStubs]  numba ships no stubs

Floats = Any  # a pointer to float64

_BYTES = 8  # of a float64
_BLOCK = 4  # rows and columns that are transposed at a time
_NARROW = 8  # lanes up to which four rows fit the registers of every processor
_LEAST = 2.0**-400  # what a subtraction leaves below it is 0: denormal numbers take long, products of larger are none


def _row(builder: Any, pointer: Any, offset: Any, width: int) -> Any:
    """Pointer to ``width`` numbers from ``offset``, as one vector."""
    place = builder.gep(pointer, [offset])
    return builder.bitcast(place, ir.VectorType(ir.DoubleType(), width).as_pointer())


def _spread(builder: Any, value: Any, width: int) -> Any:
    """A vector that holds ``value`` everywhere."""
    vector = ir.VectorType(ir.DoubleType(), width)
    one = builder.insert_element(ir.Constant(vector, ir.Undefined), value, ir.Constant(ir.IntType(32), 0))
    mask = ir.Constant(ir.VectorType(ir.IntType(32), width), [0] * width)
    return builder.shuffle_vector(one, ir.Constant(vector, ir.Undefined), mask)


def _load(builder: Any, place: Any) -> Any:
    return builder.load(place, align=_BYTES)


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

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:  # noqa: ARG001  numba's protocol
        source = _row(builder, arguments[2], arguments[3], width.literal_value)
        target = _row(builder, arguments[0], arguments[1], width.literal_value)
        builder.store(_load(builder, source), target, align=_BYTES)
        return context.get_dummy_value()

    return (types.void(to, types.intp, source, types.intp, width), emit) if _fixed(width) else None


def _row_scale(typing, to, at, source, start, factor, width):  # noqa: ARG001  numba reads this signature
    """to[at : at + width] = factor * source[start : start + width]."""

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:  # noqa: ARG001  numba's protocol
        lanes = width.literal_value
        row = _load(builder, _row(builder, arguments[2], arguments[3], lanes))
        scaled = builder.fmul(_spread(builder, arguments[4], lanes), row)
        builder.store(scaled, _row(builder, arguments[0], arguments[1], lanes), align=_BYTES)
        return context.get_dummy_value()

    signature = types.void(to, types.intp, source, types.intp, types.float64, width)
    return (signature, emit) if _fixed(width) else None


def _row_add(typing, to, at, source, start, factor, width):  # noqa: ARG001  numba reads this signature
    """to[at : at + width] += factor * source[start : start + width]."""

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:  # noqa: ARG001  numba's protocol
        lanes = width.literal_value
        row = _load(builder, _row(builder, arguments[2], arguments[3], lanes))
        target = _row(builder, arguments[0], arguments[1], lanes)
        scaled = builder.fmul(_spread(builder, arguments[4], lanes), row)
        builder.store(builder.fadd(_load(builder, target), scaled), target, align=_BYTES)
        return context.get_dummy_value()

    signature = types.void(to, types.intp, source, types.intp, types.float64, width)
    return (signature, emit) if _fixed(width) else None


def _row_increase(typing, to, at, values, width):  # noqa: ARG001  numba reads this signature
    """to[at : at + width] += values."""

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:  # noqa: ARG001  numba's protocol
        lanes = width.literal_value
        row = ir.Constant(ir.VectorType(ir.DoubleType(), lanes), ir.Undefined)
        for lane, value in enumerate(_unpack(builder, arguments[2])):
            row = builder.insert_element(row, value, ir.Constant(ir.IntType(32), lane))
        target = _row(builder, arguments[0], arguments[1], lanes)
        builder.store(builder.fadd(_load(builder, target), row), target, align=_BYTES)
        return context.get_dummy_value()

    return (types.void(to, types.intp, values, width), emit) if _fixed(width) else None


def _row_sum(typing, to, at, source, starts, factors, width):  # noqa: ARG001  numba reads this signature
    """to[at : at + width] = the sum of factors[i] * source[starts[i] : starts[i] + width]."""

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:  # noqa: ARG001  numba's protocol
        to, at, source, starts, factors, _ = arguments
        lanes, total = width.literal_value, None
        for start, factor in zip(_unpack(builder, starts), _unpack(builder, factors), strict=True):
            term = builder.fmul(_spread(builder, factor, lanes), _load(builder, _row(builder, source, start, lanes)))
            total = term if total is None else builder.fadd(total, term)
        builder.store(total, _row(builder, to, at, lanes), align=_BYTES)
        return context.get_dummy_value()

    signature = types.void(
        to,
        types.intp,
        source,
        types.UniTuple(types.intp, len(starts)),
        types.UniTuple(types.float64, len(factors)),
        width,
    )
    return (signature, emit) if _fixed(width) else None


def _row_take(typing, to, at, base, place, source, start, step, factors, first, stride, count, scale, width):  # noqa: ARG001  numba reads this signature
    """to[at:] = scale * (base[place:] - sum over c < count of factors[first + c stride] * source[start + c step :]).

    What was made last should come last, or all else would wait for it.
    """

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:  # noqa: ARG001  numba's protocol
        to, at, base, place, source, start, step, factors, first, stride, count, scale, _ = arguments
        lanes = width.literal_value
        total = cgutils.alloca_once_value(builder, _load(builder, _row(builder, base, place, lanes)))
        with cgutils.for_range(builder, count) as loop:
            row = _load(builder, _row(builder, source, builder.add(start, builder.mul(loop.index, step)), lanes))
            factor = _load(builder, builder.gep(factors, [builder.add(first, builder.mul(loop.index, stride))]))
            scaled = builder.fmul(_spread(builder, factor, lanes), row)
            builder.store(builder.fsub(builder.load(total), scaled), total)
        scaled = builder.fmul(_spread(builder, scale, lanes), builder.load(total))
        builder.store(scaled, _row(builder, to, at, lanes), align=_BYTES)
        return context.get_dummy_value()

    one, two, three = ([types.intp] * count for count in (1, 2, 3))
    signature = types.void(to, *one, base, *one, source, *two, factors, *three, types.float64, width)
    return (signature, emit) if _fixed(width) else None


def _take_outer(typing, to, at, left, a, right, b, count, height, width, upper):  # noqa: ARG001  numba reads this signature
    """Row i < height of the matrix ``to`` -= sum over c < count of left[a + c width + i] * row c from ``b`` of right.

    ``upper``: only from the block of the diagonal on; what is left of it keeps what it had. Less than ``_LEAST`` is 0.
    """

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:  # noqa: ARG001  numba's protocol
        to, at, left, a, right, b, count, *_ = arguments
        stride, number = width.literal_value, at.type
        for first, rows, column in _bands(height.literal_value, stride, upper.literal_value):
            lanes = stride - column
            targets = [
                _row(builder, to, builder.add(at, number((first + r) * stride + column)), lanes) for r in range(rows)
            ]
            totals = [cgutils.alloca_once_value(builder, _load(builder, target)) for target in targets]
            with cgutils.for_range(builder, count) as loop:
                line = builder.mul(loop.index, number(stride))
                row = _load(builder, _row(builder, right, builder.add(builder.add(b, number(column)), line), lanes))
                for r, total in enumerate(totals):
                    factor = _load(builder, builder.gep(left, [builder.add(builder.add(a, number(first + r)), line)]))
                    scaled = builder.fmul(_spread(builder, factor, lanes), row)
                    builder.store(builder.fsub(builder.load(total), scaled), total)
            for target, total in zip(targets, totals, strict=True):
                builder.store(_flush(builder, builder.load(total)), target, align=_BYTES)
        return context.get_dummy_value()

    signature = types.void(to, types.intp, left, types.intp, right, types.intp, types.intp, height, width, upper)
    return (signature, emit) if _fixed(width) and _fixed(height) and isinstance(upper, types.BooleanLiteral) else None


def _bands(height: int, stride: int, upper: bool) -> Iterator[tuple[int, int, int]]:
    """Rows to work on together: first row, how many, first column. As many as registers hold, with what they share."""
    first = 0
    while first < height:
        column = first // _BLOCK * _BLOCK if upper else 0
        rows = min(_BLOCK if stride - column <= _NARROW else 2, height - first)
        yield first, rows, column
        first += rows


def _transpose(typing, to, at, source, start, width):  # noqa: ARG001  numba reads this signature
    """The width x width matrix at ``at`` becomes the transpose of the one at ``start``, by 4 x 4 blocks."""

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:  # noqa: ARG001  numba's protocol
        lanes = width.literal_value
        for i in range(0, lanes, _BLOCK):
            for j in range(0, lanes, _BLOCK):
                place = [builder.add(arguments[3], arguments[3].type((i + r) * lanes + j)) for r in range(_BLOCK)]
                block = [_load(builder, _row(builder, arguments[2], p, _BLOCK)) for p in place]
                for r, row in enumerate(_turn(builder, block)):
                    place_to = builder.add(arguments[1], arguments[1].type((j + r) * lanes + i))
                    builder.store(row, _row(builder, arguments[0], place_to, _BLOCK), align=_BYTES)
        return context.get_dummy_value()

    return (types.void(to, types.intp, source, types.intp, width), emit) if _fixed(width) else None


def _mirror(typing, to, at, width):  # noqa: ARG001  numba reads this signature
    """What lies below the diagonal of the width x width matrix at ``at`` becomes what lies above it."""

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:  # noqa: ARG001  numba's protocol
        to, at, _ = arguments
        lanes = width.literal_value

        def place(row: int, column: int) -> Any:
            return _row(builder, to, builder.add(at, at.type(row * lanes + column)), _BLOCK)

        mask = ir.VectorType(ir.IntType(32), _BLOCK)
        for i in range(0, lanes, _BLOCK):
            for j in range(i, lanes, _BLOCK):
                block = [_load(builder, place(i + r, j)) for r in range(_BLOCK)]
                for r, row in enumerate(_turn(builder, block)):
                    kept = row
                    if i == j:  # lanes of the turned block below the diagonal, its own on and above
                        choice = [c if c < r else _BLOCK + c for c in range(_BLOCK)]
                        kept = builder.shuffle_vector(row, block[r], ir.Constant(mask, choice))
                    builder.store(kept, place(j + r, i), align=_BYTES)
        return context.get_dummy_value()

    return (types.void(to, types.intp, width), emit) if _fixed(width) else None


def _turn(builder: Any, rows: list[Any]) -> list[Any]:
    """The columns of four vectors of four."""
    mask = ir.VectorType(ir.IntType(32), _BLOCK)

    def pick(pair: list[Any], lanes: list[int]) -> Any:
        return builder.shuffle_vector(pair[0], pair[1], ir.Constant(mask, lanes))

    low = [pick(pair, [0, 4, 2, 6]) for pair in (rows[:2], rows[2:])]
    high = [pick(pair, [1, 5, 3, 7]) for pair in (rows[:2], rows[2:])]
    first, second = [0, 1, 4, 5], [2, 3, 6, 7]
    return [pick(low, first), pick(high, first), pick(low, second), pick(high, second)]


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
transpose = cast(Copy, intrinsic(prefer_literal=True)(_transpose))
take_outer = cast(Outer, intrinsic(prefer_literal=True)(_take_outer))
mirror = cast(Mirror, intrinsic(prefer_literal=True)(_mirror))
