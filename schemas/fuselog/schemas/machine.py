"""The decoding machine: one compiled loop that runs a program over many CDR messages.

Positions are counted from byte 4 of the payload, as alignment is in XCDR1. Every operation checks its bytes
against the end of the message before it touches them, and every turn of a loop consumes at least one byte,
so a message costs at most time linear in its length.
"""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fuselog.schemas.compiled import HOST_IS_BIG_ENDIAN, copy, kernel, leaf, load
from fuselog.schemas.messages import Fault
from fuselog.schemas.tree import KINDS

WORDS: Final = 5  # of an operation: its code and up to four operands
LOAD: Final = 0  # kind count column: numbers into neighbouring columns
SKIP: Final = 1  # size count: over numbers of one size
STRING: Final = 2  # unit column: over a string, noting where it lies; column -1 does not
STAMP: Final = 3  # kind scale: adds the integer here to the stamp, and stays
NUMBERS: Final = 4  # kind column: over a sequence of numbers; its count into the column
ITEMS: Final = 5  # kind first count column: elements of the sequence just passed; NaN where it ends
COUNT_ELEMENTS: Final = 6  # register column: starts a loop over as many elements as the message says
TIMES: Final = 7  # register count: starts a loop over a fixed number of elements
WHILE: Final = 8  # register limit exit: the next element, or to `exit` at the limit or after the last
JUMP: Final = 9  # target
BEGIN: Final = 10  # size text: notes where the text begins, at the next multiple of size, and stays
END: Final = 11  # text: notes its length up to here

_HEADER: Final = 4  # bytes of encapsulation
_INT8: Final = KINDS["int8"]
_BOOL: Final = KINDS["bool"]
_UINT16: Final = KINDS["uint16"]
_INT16: Final = KINDS["int16"]
_UINT32: Final = KINDS["uint32"]
_INT32: Final = KINDS["int32"]
_FLOAT32: Final = KINDS["float32"]
_UINT64: Final = KINDS["uint64"]
_INT64: Final = KINDS["int64"]
_FLOAT64: Final = KINDS["float64"]
_GOOD: Final = int(Fault.NONE)
_SIZE: Final = int(Fault.SIZE)
_SCHEMA: Final = int(Fault.SCHEMA)


class Program(NamedTuple):
    """What to do with every message."""

    operations: NDArray[np.int64]  # (m, WORDS)
    depth: int  # how many loops they nest
    stamp_parts: int  # that they read
    gaps: bool  # whether a message may lack elements that have a column


class Rows(NamedTuple):
    """What the machine fills, one row per message; of a text or another stretch of bytes, where it lies."""

    t_ns: NDArray[np.int64]  # (n,)
    values: NDArray[np.float64]  # (n, width)
    fault: NDArray[np.uint8]  # (n,)
    text_start: NDArray[np.int64]  # (n, texts)
    text_length: NDArray[np.int64]  # (n, texts)


@kernel
def run(
    program: Program,
    data: NDArray[np.uint8],
    start: NDArray[np.int64],
    length: NDArray[np.int64],
    rows: Rows,
) -> None:
    """Decode ``data[start[i] : start[i] + length[i]]`` into row i of the outputs, for every i."""
    loops = np.zeros((2, program.depth), np.int64)
    for row in range(start.size):
        if program.gaps:
            rows.values[row] = np.nan
        _clear(rows, row)
        found = _encapsulation(data, start[row], length[row])
        if found == _GOOD:
            found = _message(program, data, start[row] + _HEADER, length[row] - _HEADER, rows, row, loops)
        if found != _GOOD:
            rows.values[row] = np.nan
            _clear(rows, row)
        rows.fault[row] = found


@leaf
def _clear(rows: Rows, row: int) -> None:
    rows.t_ns[row] = 0
    for text in range(rows.text_start.shape[1]):
        rows.text_start[row, text] = rows.text_length[row, text] = 0


@leaf
def _encapsulation(data: NDArray[np.uint8], start: int, length: int) -> int:
    if start < 0 or length < _HEADER or length > data.size or start > data.size - length:
        return _SIZE
    if data[start] != 0 or data[start + 1] > 1:
        return _SCHEMA
    return _GOOD


@leaf
def _message(
    program: Program,
    data: NDArray[np.uint8],
    base: int,
    end: int,
    rows: Rows,
    row: int,
    loops: NDArray[np.int64],
) -> int:
    """Run the program over the message whose byte 4 is ``data[base]``, where all positions count from."""
    swapped = (data[base - _HEADER + 1] == 0) != HOST_IS_BIG_ENDIAN
    ops, values, count, index = program.operations, rows.values[row], loops[0], loops[1]
    at = 0  # of the next byte
    first = items = 0  # where the last sequence of numbers began, and how many it holds
    stamps = step = 0
    while step < ops.shape[0]:
        code, a, b, c, d = ops[step, 0], ops[step, 1], ops[step, 2], ops[step, 3], ops[step, 4]
        step += 1
        if code == LOAD:
            at = _aligned(at, _size(a))
            if b * _size(a) > end - at:
                return _SIZE
            _numbers(data, base + at, a, b, values[c:], swapped)
            at += b * _size(a)
        elif code == SKIP:
            at = _aligned(at, a) + a * b
        elif code == WHILE:
            if index[a] >= b or index[a] >= count[a]:
                step = c
            else:
                index[a] += 1
        elif code == JUMP:
            step = a
        elif code == BEGIN:
            rows.text_start[row, b] = base + _aligned(at, a)
        elif code == END:
            rows.text_length[row, a] = base + at - rows.text_start[row, a]
        elif code == TIMES:
            count[a], index[a] = b, 0
        elif code == ITEMS:
            have = min(max(items - b, 0), c)
            _numbers(data, base + first + b * _size(a), a, have, values[d:], swapped)
        elif code == STAMP:
            at = _aligned(at, _size(a))
            if _size(a) > end - at:
                return _SIZE
            rows.t_ns[row] += b * _integer(data, base + at, a, swapped)
            stamps += 1
        else:  # what begins with a count of at least as many bytes
            at = _aligned(at, 4) + 4
            if at > end:
                return _SIZE
            n = int(load(data, base + at - 4, swapped, np.uint32))
            if n > end - at:
                return _SIZE
            if code == STRING:
                at += a * n
                if at > end or (a == 1 and n > 0 and data[base + at - 1] != 0):
                    return _SIZE
                if b >= 0:
                    rows.text_start[row, b] = base + at - a * n
                    rows.text_length[row, b] = a * n - (a == 1 and n > 0)
            else:
                if b >= 0:
                    values[b] = n
                if code == COUNT_ELEMENTS:
                    count[a], index[a] = n, 0
                else:
                    first, items = _aligned(at, _size(a)) if n > 0 else at, n
                    at = first + n * _size(a)
        if at > end:
            return _SIZE
    return _GOOD if stamps == program.stamp_parts else _SCHEMA


@leaf
def _size(kind: int) -> int:
    return 1 << (kind >> 2)


@leaf
def _aligned(at: int, size: int) -> int:
    return (at + size - 1) & -size


@leaf
def _numbers(
    data: NDArray[np.uint8], at: int, kind: int, count: int, values: NDArray[np.float64], swapped: bool
) -> None:
    """The ``count`` numbers from ``data[at]`` on, into the first of ``values``."""
    if kind == _FLOAT64 and not swapped:
        copy(values, 0, data, at, 8 * count)
    elif kind == _FLOAT64:
        for i in range(count):
            values[i] = load(data, at + 8 * i, swapped, np.float64)
    else:
        for i in range(count):
            values[i] = _number(data, at + i * _size(kind), kind, swapped)


@leaf
def _number(data: NDArray[np.uint8], at: int, kind: int, swapped: bool) -> float:
    if kind == _FLOAT32:
        return np.float64(load(data, at, swapped, np.float32))
    if kind == _UINT64:
        return np.float64(load(data, at, swapped, np.uint64))
    if kind == _BOOL:
        return 1.0 if data[at] != 0 else 0.0
    return np.float64(_integer(data, at, kind, swapped))


@leaf
def _integer(data: NDArray[np.uint8], at: int, kind: int, swapped: bool) -> int:
    if kind == _INT8:
        return int(load(data, at, swapped, np.int8))
    if kind == _UINT16:
        return int(load(data, at, swapped, np.uint16))
    if kind == _INT16:
        return int(load(data, at, swapped, np.int16))
    if kind == _UINT32:
        return int(load(data, at, swapped, np.uint32))
    if kind == _INT32:
        return int(load(data, at, swapped, np.int32))
    if kind in (_UINT64, _INT64):
        return int(load(data, at, swapped, np.int64))
    return int(data[at])
