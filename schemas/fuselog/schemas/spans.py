"""Stretches of CDR bytes to lists: sequences and fixed arrays of numbers, exact to the last bit, and of strings."""

import struct

import numpy as np
from numpy.typing import NDArray

from fuselog.schemas.compiled import HOST_IS_BIG_ENDIAN, kernel, load
from fuselog.schemas.errors import SchemaError
from fuselog.schemas.messages import Ragged
from fuselog.schemas.paths import Path, find_node, join_path
from fuselog.schemas.tree import Array, Node, Number, Text, dtype_of, kind_of

Ints = NDArray[np.int64]


def find_listable(schema: str, root: Node, path: Path) -> Node:
    """The node at ``path``, if it can be a `Ragged`: a number, or an array of numbers or strings; else SchemaError."""
    node = find_node(schema, root, path)
    match node:
        case Number() | Array(Number() | Text(wide=False)):
            return node
        case _:
            raise SchemaError(schema, f"{join_path(path)} is {kind_of(node)}: not a list of numbers or strings")


def read_spans(node: Node, data: NDArray[np.uint8], message: Ints, start: Ints, length: Ints) -> Ragged:
    """What the n messages hold at ``data[start[i] : start[i] + length[i]]``; ``message`` (n,) is where each begins.

    ``node`` is one of `find_listable`, and the bytes are those that the machine has walked over. Nothing for length 0.
    """
    match node:
        case Number(kind) | Array(Number(kind)):
            counted = isinstance(node, Array) and node.length is None
            dtype = dtype_of(kind)
            offsets = np.zeros(len(start) + 1, np.int64)
            count_elements(data, message, start, length, counted, dtype.itemsize, offsets)
            raw = np.empty(int(offsets[-1]) * dtype.itemsize, np.uint8)
            copy_elements(data, message, start, length, dtype.itemsize, offsets, raw)
            values = raw != 0 if kind == "bool" else raw.view(dtype)
            return Ragged(values=values, offsets=offsets)
        case _:
            fixed = node.length if isinstance(node, Array) else None
            return _read_strings(fixed, data, message, start, length)


@kernel
def count_elements(
    data: NDArray[np.uint8], message: Ints, start: Ints, length: Ints, counted: bool, size: int, offsets: Ints
) -> None:
    """Fill ``offsets`` (n + 1,) with the running number of elements; ``counted`` spans begin with it."""
    for i in range(start.size):
        n = length[i] // size
        if counted and length[i] > 0:
            swapped = (data[message[i] + 1] == 0) != HOST_IS_BIG_ENDIAN
            n = min(n, np.int64(load(data, start[i], swapped, np.uint32)))
        offsets[i + 1] = offsets[i] + n


@kernel
def copy_elements(
    data: NDArray[np.uint8],
    message: Ints,
    start: Ints,
    length: Ints,
    size: int,
    offsets: Ints,
    target: NDArray[np.uint8],
) -> None:
    """Copy the elements, which end with their spans, to ``target``, in the byte order of this machine."""
    for i in range(start.size):
        n, to = (offsets[i + 1] - offsets[i]) * size, offsets[i] * size
        source = start[i] + length[i] - n
        if n > 0 and size > 1 and (data[message[i] + 1] == 0) != HOST_IS_BIG_ENDIAN:
            for k in range(n):
                target[to + k] = data[source + k // size * size + size - 1 - k % size]
        else:
            for k in range(n):
                target[to + k] = data[source + k]


@kernel
def find_changes(data: NDArray[np.uint8], message: Ints, start: Ints, length: Ints, differs: NDArray[np.bool_]) -> None:
    """Mark the messages (n,) whose span is not, byte for byte and in byte order, that of the message before."""
    for i in range(start.size):
        same = i > 0 and length[i] == length[i - 1]
        if same and length[i] > 0:
            same = data[message[i] + 1] == data[message[i - 1] + 1]
            for k in range(length[i]):
                same &= data[start[i] + k] == data[start[i - 1] + k]
        differs[i] = not same


def _read_strings(fixed: int | None, data: NDArray[np.uint8], message: Ints, start: Ints, length: Ints) -> Ragged:
    """Lists of strings; equal ones, as the names of joints are, are read once."""
    known: dict[tuple[bytes, bool], list[str]] = {}
    texts: list[str] = []
    offsets = np.zeros(len(start) + 1, np.int64)
    view = data.data
    for i, (first, at, size) in enumerate(zip(message.tolist(), start.tolist(), length.tolist(), strict=True)):
        if size:
            key = bytes(view[at : at + size]), bool(data[first + 1] == 0)
            found = known.get(key)
            if found is None:
                found = known[key] = _strings_of(*key, fixed)
            texts += found
        offsets[i + 1] = len(texts)
    return Ragged(values=texts, offsets=offsets)


def _strings_of(raw: bytes, big_endian: bool, fixed: int | None) -> list[str]:
    count = struct.Struct(">I" if big_endian else "<I")
    at, n = (0, fixed) if fixed is not None else (4, count.unpack_from(raw, 0)[0])
    texts: list[str] = []
    for _ in range(n):
        at += -at % 4
        size = count.unpack_from(raw, at)[0]
        at += 4 + size
        texts.append(raw[at - size : at - (size > 0)].decode("utf-8", "replace"))
    return texts
