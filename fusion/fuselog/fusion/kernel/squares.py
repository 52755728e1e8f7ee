"""Square matrices in flat memory, row by row as in ``rows``: P, and what a step makes of it."""
# Numba passes compiler objects to an intrinsic that have no types to check.
# pyright: reportUnknownMemberType=false, reportUnknownArgumentType=false, reportUnknownVariableType=false
# pyright: reportUnknownParameterType=false, reportMissingParameterType=false, reportUnknownLambdaType=false

import itertools
import math
from collections.abc import Iterator, Sequence
from typing import Any, Protocol, cast

from llvmlite import ir  # pyright: ignore[reportMissingTypeStubs]  llvmlite ships no stubs
from numba import types  # pyright: ignore[reportMissingTypeStubs]  numba ships no stubs
from numba.core import cgutils  # pyright: ignore[reportMissingTypeStubs]  numba ships no stubs
from numba.extending import intrinsic  # pyright: ignore[reportMissingTypeStubs]  numba ships no stubs

from fuselog.fusion.kernel.lanes import mask
from fuselog.fusion.kernel.rows import Floats, Place, every, fixed, shuffle, spread, unpack

_TILE = 4  # numbers of the smallest vector that all processors have, or put together
_NARROW = 8  # lanes up to which four rows fit the registers of every processor
_LEAST = 2.0**-400  # what a subtraction leaves below it is 0: denormal numbers take long, products of larger are none

Sparse = Sequence[Sequence[int]]  # the columns that each row has something in


class _Matrix:
    """Where a matrix lies whose rows have ``long`` numbers."""

    def __init__(self, builder: Any, place: Place, pointer: Any, start: Any, long: int) -> None:
        self.builder, self.long = builder, long
        self._place, self._pointer, self._start = place, pointer, start

    def load(self, i: int, j: int, width: int) -> Any:
        """Numbers of row i from column j on."""
        return self._place.load(self.builder, self._pointer, self._offset(i, j), width)

    def store(self, numbers: Any, i: int, j: int) -> None:
        """Put numbers there."""
        self._place.store(self.builder, numbers, self._pointer, self._offset(i, j))

    def _offset(self, i: int, j: int) -> Any:
        return self.builder.add(self._start, self._start.type(i * self.long + j))


def congruence(F: Sparse) -> "Congruence":
    """A kernel's function for F P F', given which numbers of F there are; none in a row that is that of I.

    P is exactly symmetric, the result so but for rounding.
    """
    ends = [sum(map(len, F[:i])) for i in range(len(F) + 1)]

    def make(typing, to, at, source, start, w, factors, width):  # noqa: ARG001  numba reads this signature
        """The matrix at ``at`` = F times the one at ``start`` times F'; w is scratch of two."""
        place = Place(to)

        def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:  # noqa: ARG001  numba's protocol
            to, at, source, start, w, factors, _ = arguments
            long, values = width.literal_value, unpack(builder, factors)
            terms = [values[first:last] for first, last in itertools.pairwise(ends)]
            P, result = _Matrix(builder, place, source, start, long), _Matrix(builder, place, to, at, long)
            by = _by_rows if place.each == 1 else _by_numbers
            by(F, terms, P, result, *(_Matrix(builder, place, w, at.type(n), long) for n in (0, long * long)))
            return context.get_dummy_value()

        row = types.UniTuple(place.number, len(factors))
        signature = types.void(to, types.intp, source, types.intp, w, row, width)
        return (signature, emit) if fixed(width) else None

    return cast(Congruence, intrinsic(prefer_literal=True)(make))


def _by_rows(F: Sparse, terms: list[Any], P: _Matrix, to: _Matrix, FP: _Matrix, turned: _Matrix) -> None:
    """F P; its columns as rows; F times these."""
    builder, long = P.builder, P.long
    moved = [*map(bool, F), *[False] * (long - len(F))]
    for i, columns in enumerate(F):
        if moved[i]:
            FP.store(_sum(builder, terms[i], [P.load(c, 0, long) for c in columns], long), i, 0)
    if long > _TILE:
        _settle(builder)
    for first, rows in _blocks(long):
        for column in range(0, long, 2):
            pairs = [(FP if moved[i] else P).load(i, column, 2) for i in range(first, first + rows)]
            for c, found in enumerate(_two_columns(builder, 1, pairs), column):
                (turned if moved[c] else to).store(found, c, first)
    for i, columns in enumerate(F):
        if moved[i]:
            rows_of = [(turned if moved[c] else to).load(c, 0, long) for c in columns]
            to.store(_sum(builder, terms[i], rows_of, long), i, 0)


def _by_numbers(F: Sparse, terms: list[Any], P: _Matrix, to: _Matrix, FP: _Matrix, _: _Matrix) -> None:
    """The same of lanes, for which the numbers of a column are as near as those of a row."""
    builder, n = P.builder, len(F)
    for i, columns in enumerate(F):
        for j in range(n) if columns else ():
            FP.store(_sum(builder, terms[i], [P.load(c, j, 1) for c in columns], 1), i, j)
    for i, columns in enumerate(F):
        for j in range(n):
            if columns and F[j]:
                number = _sum(builder, terms[i], [FP.load(j, c, 1) for c in columns], 1)
            elif columns:
                number = FP.load(i, j, 1)
            else:
                number = FP.load(j, i, 1) if F[j] else P.load(j, i, 1)
            to.store(number, i, j)


def _sum(builder: Any, factors: list[Any], rows: list[Any], width: int) -> Any:
    """The sum of the rows, each times its own factor, in their order."""
    total = None
    for factor, row in zip(factors, rows, strict=True):
        term = builder.fmul(spread(builder, factor, width), row)
        total = term if total is None else builder.fadd(total, term)
    return total


def increase(places: Sparse) -> "Increase":
    """A kernel's function that adds numbers to those of a matrix at these places, row by row.

    One by one they would have to be in memory before a row is read.
    """

    def make(typing, to, at, values, width):  # noqa: ARG001  numba reads this signature
        """The matrix at ``at`` += values."""
        place = Place(to)

        def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:  # noqa: ARG001  numba's protocol
            long, left = width.literal_value, iter(unpack(builder, arguments[2]))
            P = _Matrix(builder, place, arguments[0], arguments[1], long)
            for i, columns in enumerate(places):
                if place.each > 1:
                    for j in columns:
                        P.store(builder.fadd(P.load(i, j, 1), next(left)), i, j)
                elif columns:
                    before, more = P.load(i, 0, long), _row_of(builder, {j: next(left) for j in columns}, long)
                    chosen = ir.Constant(ir.VectorType(ir.IntType(1), long), [int(j in columns) for j in range(long)])
                    P.store(builder.select(chosen, builder.fadd(before, more), before), i, 0)
            return context.get_dummy_value()

        row = types.UniTuple(place.number, len(values))
        return (types.void(to, types.intp, row, width), emit) if fixed(width) else None

    return cast(Increase, intrinsic(prefer_literal=True)(make))


def _row_of(builder: Any, numbers: dict[int, Any], long: int) -> Any:
    """A row with some numbers in it."""
    row = ir.Constant(ir.VectorType(ir.DoubleType(), long), ir.Undefined)
    for column, value in numbers.items():
        row = builder.insert_element(row, value, ir.Constant(ir.IntType(32), column))
    return row


def _flush(builder: Any, row: Any) -> Any:
    """The vector with 0 in place of numbers nearer to it than ``_LEAST``; NaN stays."""
    bits = ir.VectorType(ir.IntType(64), row.type.count)
    unsigned = builder.and_(builder.bitcast(row, bits), ir.Constant(bits, [2**63 - 1] * row.type.count))
    size = builder.bitcast(unsigned, row.type)
    keeps = builder.fcmp_unordered(">=", size, ir.Constant(row.type, [_LEAST] * row.type.count))
    return builder.select(keeps, row, ir.Constant(row.type, [0.0] * row.type.count))


def _take_outer(typing, to, at, left, a, right, b, count, height, width, upper):  # noqa: ARG001  numba reads this signature
    """Row i < height of the matrix ``to`` -= sum over c < count of left[a + c width + i] * row c from ``b`` of right.

    ``upper``: only from the block of the diagonal on; what is left of it keeps what it had. Less than ``_LEAST`` is 0.
    """
    place = Place(to)

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
                    scaled = builder.fmul(spread(builder, factor, long), row)
                    builder.store(builder.fsub(builder.load(total), scaled), total)
            for each, total in zip(places, totals, strict=True):
                place.store(builder, _flush(builder, builder.load(total)), to, each)
        return context.get_dummy_value()

    signature = types.void(to, types.intp, left, types.intp, right, types.intp, types.intp, height, width, upper)
    return (signature, emit) if fixed(width) and fixed(height) and isinstance(upper, types.BooleanLiteral) else None


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


def _mirror(typing, to, at, width):  # noqa: ARG001  numba reads this signature
    """What lies below the diagonal of the width x width matrix at ``at`` becomes what lies above it."""
    place = Place(to)

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:  # noqa: ARG001  numba's protocol
        long = width.literal_value
        P = _Matrix(builder, place, arguments[0], arguments[1], long)
        if long > _TILE:
            _settle(builder)
        for first, rows in _blocks(long):
            for j in range(first, long, 2):
                pairs = [P.load(first + r, j, 2) for r in range(rows)]
                for row, column in enumerate(_two_columns(builder, place.each, pairs), j):
                    whole = column
                    if row < first + rows:  # of a row that crosses the diagonal, what lies on and behind it stays
                        choice = [c if first + c < row else rows + c for c in range(rows)]
                        whole = shuffle(builder, column, P.load(row, first, rows), choice, place.each)
                    P.store(whole, row, first)
        return context.get_dummy_value()

    return (types.void(to, types.intp, width), emit) if fixed(width) else None


def _rows_finite(typing, source, at, height, width):  # noqa: ARG001  numba reads this signature
    """Whether the sum of each column of the matrix at ``at`` is finite, as it is not where a number is not."""
    place = Place(source)

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
        return _all_finite(builder, rows[0], place)

    signature = (mask if place.each > 1 else types.boolean)(source, types.intp, height, width)
    return (signature, emit) if fixed(width) and fixed(height) else None


def _all_finite(builder: Any, row: Any, place: Place) -> Any:
    """Whether all numbers of a row are, for each lane."""
    words = ir.VectorType(ir.IntType(64), row.type.count)
    size = builder.and_(builder.bitcast(row, words), ir.Constant(words, [2**63 - 1] * words.count))
    found = builder.fcmp_ordered("<", builder.bitcast(size, row.type), ir.Constant(row.type, [math.inf] * words.count))
    return every(builder, found, place)


def _pack_upper(typing, to, at, source, start, height, width):  # noqa: ARG001  numba reads this signature
    """to[at:] = what lies on and above the diagonal of a matrix, row by row; a few numbers behind that are lost."""
    place = Place(to)

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:  # noqa: ARG001  numba's protocol
        to, at, source, start, *_ = arguments
        high, long, packed = height.literal_value, width.literal_value, 0
        for i in range(high):
            wide = -(-(high - i) // _TILE) * _TILE if place.each == 1 else high - i
            row = place.load(builder, source, builder.add(start, start.type(i * (long + 1))), wide)
            place.store(builder, row, to, builder.add(at, at.type(packed)))
            packed += high - i
        return context.get_dummy_value()

    signature = types.void(to, types.intp, source, types.intp, height, width)
    return (signature, emit) if fixed(width) and fixed(height) else None


def _blocks(long: int) -> Iterator[tuple[int, int]]:
    """First row and how many: as rows are read later, for what was stored in pieces has to reach the cache before."""
    first = 0
    while first < long:
        rows = _NARROW if long - first >= _NARROW else _TILE
        yield first, rows
        first += rows


def _settle(builder: Any) -> None:
    """What was written is read again from memory: there, parts of long rows are put together for less."""
    builder.asm(ir.FunctionType(ir.VoidType(), []), "", "~{memory}", [], True)


def _two_columns(builder: Any, each: int, pairs: list[Any]) -> list[Any]:
    """Two columns of rows of which these are two numbers each."""
    even, odd = (_concatenate(builder, pairs[first::2], each) for first in (0, 1))
    half = [(number, len(pairs) + number) for number in range(0, len(pairs), 2)]
    return [shuffle(builder, even, odd, [n + c for two in half for n in two], each) for c in (0, 1)]


def _concatenate(builder: Any, rows: list[Any], each: int) -> Any:
    """One row of all, as many numbers in each."""
    while len(rows) > 1:
        numbers = [*range(2 * rows[0].type.count // each)]
        rows = [shuffle(builder, p, q, numbers, each) for p, q in zip(rows[::2], rows[1::2], strict=True)]
    return rows[0]


class Congruence(Protocol):
    """F P F'."""

    def __call__(
        self, to: Floats, at: int, source: Floats, start: int, w: Floats, factors: tuple[float, ...], width: int
    ) -> None:
        """``factors``: the numbers of F row by row. ``width`` is a constant. The result is not in P's place."""


class Increase(Protocol):
    """P + Q."""

    def __call__(self, to: Floats, at: int, values: tuple[float, ...], width: int) -> None:
        """``values``: the numbers of Q row by row. ``width`` is a constant."""


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


class Pack(Protocol):
    """A symmetric matrix as its upper triangle."""

    def __call__(self, to: Floats, at: int, source: Floats, start: int, height: int, width: int) -> None:
        """``height`` and ``width`` are constants."""


class Finite(Protocol):
    """Whether a matrix has finite numbers only."""

    def __call__(self, source: Floats, at: int, height: int, width: int) -> bool:
        """``height`` and ``width`` are constants."""
        ...


class Mirror(Protocol):
    """Make a matrix symmetric."""

    def __call__(self, to: Floats, at: int, width: int) -> None:
        """``width`` is a constant."""


rows_finite = cast(Finite, intrinsic(prefer_literal=True)(_rows_finite))
pack_upper = cast(Pack, intrinsic(prefer_literal=True)(_pack_upper))
take_outer = cast(Outer, intrinsic(prefer_literal=True)(_take_outer))
mirror = cast(Mirror, intrinsic(prefer_literal=True)(_mirror))
