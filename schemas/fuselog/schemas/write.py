"""Numbers into messages of one size: a template copied for each, and every varying number stored in its place."""

import math
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from fuselog.schemas.compiled import copy, kernel, leaf, store
from fuselog.schemas.tree import KINDS

WRITTEN: Final = -1000

_BOOL, _FLOAT32, _FLOAT64 = KINDS["bool"], KINDS["float32"], KINDS["float64"]
_UINT64 = KINDS["uint64"]
_BEYOND_INT64, _BEYOND_UINT64 = 2.0**63, 2.0**64
_WRITTEN = WRITTEN


@kernel
def write_messages(
    data: NDArray[np.uint8],
    template: NDArray[np.uint8],
    t_ns: Any,
    values: Any,
    runs: Any,
    stamps: Any,
) -> int:
    """Write len(t_ns) messages one after another, little endian.

    ``runs`` (runs, 4): columns first to last - 1 of ``values`` lie from an offset on, as one of ``KINDS``. ``stamps``
    (parts, 3): the stamp in parts, each at an offset, as one of ``KINDS``, of so many ns. Returns ``WRITTEN``, or the
    column of a value that its field cannot hold, or -1 - part of the stamp.
    """
    size, width = len(template), values.shape[1]
    for n in range(len(t_ns)):
        begin, rest = n * size, t_ns[n]
        copy(data, begin, template, 0, size)
        for part in range(len(stamps)):
            whole = rest // stamps[part, 2]
            rest -= whole * stamps[part, 2]
            if not put_whole(data, begin + stamps[part, 0], whole, stamps[part, 1]):
                return -1 - part
        for run in range(len(runs)):
            first, last, at, kind = runs[run, 0], runs[run, 1], begin + runs[run, 2], runs[run, 3]
            if kind == _FLOAT64:
                copy(data, at, values, n * width + first, last - first)
                continue
            for column in range(first, last):
                if not put_number(data, at, values[n, column], kind):
                    return column
                at += 1 << (kind >> 2)
    return _WRITTEN


@leaf
def put_number(data: NDArray[np.uint8], at: int, value: float, kind: int) -> bool:
    """Store a number that is no float64; whether its field can hold it."""
    if kind == _FLOAT32:
        store(data, at, value, np.float32)
    elif kind == _BOOL:
        data[at] = value != 0.0
    elif not (-_BEYOND_INT64 <= value < _BEYOND_UINT64 and math.floor(value) == value):
        return False
    elif value >= _BEYOND_INT64:
        if kind != _UINT64:
            return False
        store(data, at, value, np.uint64)
    else:
        return put_whole(data, at, int(value), kind)
    return True


@leaf
def put_whole(data: NDArray[np.uint8], at: int, value: int, kind: int) -> bool:
    """Store a whole number; whether its field can hold it."""
    bits = 8 << (kind >> 2)
    if kind % 4 == 0:
        if value < 0 or (bits < 64 and value >> bits):
            return False
    elif bits < 64 and not -(1 << (bits - 1)) <= value < 1 << (bits - 1):
        return False
    if bits == 8:
        data[at] = value & 0xFF
    elif bits == 16:
        store(data, at, value, np.int16)
    elif bits == 32:
        store(data, at, value, np.int32)
    else:
        store(data, at, value, np.int64)
    return True
