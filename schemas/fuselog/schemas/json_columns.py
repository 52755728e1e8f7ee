"""JSON payloads into the same columns as CDR."""

import json
import math
from collections.abc import Sequence
from typing import Any, Final, cast

import numpy as np
import orjson
from numpy.typing import NDArray

from fuselog.schemas.errors import SchemaError
from fuselog.schemas.messages import Columns, Fault, Ragged, empty_rows
from fuselog.schemas.paths import COUNT, Path, expand, find_node, join_path, split_path, stamp_leaves
from fuselog.schemas.spans import find_listable
from fuselog.schemas.tree import KINDS, Array, Node, Number, Open, Text, dtype_of, time_parts

_MOST_NS: Final = 2**63 - 1


class JsonCodec:
    """Decodes chosen fields of JSON messages.

    An element beyond the end of an array is NaN, and so is null; a field that is missing or not a number
    makes the row ``Fault.SCHEMA``, a payload that is not JSON ``Fault.SIZE``. Stamps are whole ns, or an
    object of seconds and nanoseconds, and exact. Without a schema every field is taken for a number.
    """

    def __init__(
        self, schema_name: str, root: Node, fields: Sequence[str], stamp: str | None, lists: Sequence[str] = ()
    ) -> None:
        leaves = [leaf for text in fields for leaf in expand(schema_name, root, split_path(schema_name, text))]
        self._numbers = [path for path, node in leaves if not isinstance(node, Text)]
        self._texts = {join_path(path): path for path, node in leaves if isinstance(node, Text)}
        self._stamp = None if stamp is None else _stamp_path(schema_name, root, stamp)
        self._lists = {
            text: (path, find_listable(schema_name, root, path))
            for text, path in ((text, split_path(schema_name, text)) for text in lists)
        }
        self.paths = tuple(join_path(path) for path in self._numbers)

    def decode(
        self,
        data: NDArray[np.uint8],
        start: NDArray[np.int64],
        length: NDArray[np.int64],
        *,
        out: Columns | None = None,
    ) -> Columns:
        """Columns (n, width) of the payloads ``data[start[i] : start[i] + length[i]]``; it never raises."""
        n = len(start)
        if len(length) != n:
            raise ValueError(f"{n} starts and {len(length)} lengths")
        t_ns, values, fault = empty_rows(n, len(self.paths)) if out is None else (out.t_ns, out.values, out.fault)
        t_ns[:], values[:], fault[:] = 0, np.nan, Fault.NONE
        texts = {name: [""] * n for name in self._texts}
        lists: dict[str, list[list[Any]]] = {name: [[]] * n for name in self._lists}
        view = np.ascontiguousarray(data, np.uint8).data
        for row, (first, size) in enumerate(zip(start.tolist(), length.tolist(), strict=True)):
            try:
                document = _parsed(view, first, size)
                stamp = 0 if self._stamp is None else _nanoseconds(_found(document, self._stamp))
                numbers = [_number(_found(document, path)) for path in self._numbers]
                strings = [_string(_found(document, path)) for path in self._texts.values()]
                items = [_items(_found(document, path), node) for path, node in self._lists.values()]
            except _NotJsonError:
                fault[row] = Fault.SIZE
            except _ShapeError:
                fault[row] = Fault.SCHEMA
            else:
                t_ns[row], values[row] = stamp, numbers
                for name, string in zip(texts, strings, strict=True):
                    texts[name][row] = string
                for name, found in zip(lists, items, strict=True):
                    lists[name][row] = found
        ragged = {name: _ragged(lists[name], node) for name, (_, node) in self._lists.items()}
        return Columns(t_ns=t_ns, values=values, paths=self.paths, fault=fault, texts=texts, lists=ragged)


class _NotJsonError(Exception):
    """The payload is cut, outside the buffer, or not JSON."""


class _ShapeError(Exception):
    """The payload is JSON of another shape than was asked for."""


def _stamp_path(schema: str, root: Node, stamp: str) -> Path:
    path = split_path(schema, stamp)
    if path[-1] == COUNT:
        raise SchemaError(schema, f"{stamp} is a count, not a stamp")
    if not isinstance(find_node(schema, root, path), Open):
        stamp_leaves(schema, root, path)  # says what is wrong, if anything
    return path


def _parsed(view: memoryview, start: int, length: int) -> object:
    """The document; NaN and Infinity, which are not JSON but common, are read by the slower parser."""
    if start < 0 or length < 0 or start + length > len(view):
        raise _NotJsonError
    payload = bytes(view[start : start + length])
    try:
        return orjson.loads(payload)
    except orjson.JSONDecodeError:
        try:
            return json.loads(payload)
        except (ValueError, RecursionError) as error:
            raise _NotJsonError from error


def _found(document: object, path: Path) -> object:
    """What is at ``path``; None beyond the end of an array."""
    for token in path:
        match document, token:
            case dict(), str() if token in document:
                document = cast(dict[str, Any], document)[token]
            case list(), int():
                items = cast(list[Any], document)
                if token == COUNT:
                    return len(items)
                if token >= len(items):
                    return None
                document = items[token]
            case _:
                raise _ShapeError
    return document


def _number(value: object) -> float:
    if value is None:
        return math.nan
    if not isinstance(value, int | float):
        raise _ShapeError
    try:
        return float(value)
    except OverflowError as error:
        raise _ShapeError from error


def _string(value: object) -> str:
    if value is None:
        return ""
    if not isinstance(value, str):
        raise _ShapeError
    return value


def _items(value: object, node: Node) -> list[Any]:
    """The elements of an array, or the number as the only one; nothing for null. `_ShapeError` if one does not fit."""
    if value is None:
        return []
    items = cast(list[object], value) if isinstance(value, list) else [value]
    if isinstance(value, list) != isinstance(node, Array):
        raise _ShapeError
    element = node.element if isinstance(node, Array) else node
    if isinstance(element, Text):
        return [_string(item) for item in items]
    integer = isinstance(element, Number) and KINDS[element.kind] % 4 < 2
    return [_whole(item) if integer else _number(item) for item in items]


def _whole(value: object) -> int:
    if not isinstance(value, int) or isinstance(value, bool) or not -_MOST_NS <= value <= _MOST_NS:
        raise _ShapeError
    return value


def _ragged(rows: list[list[Any]], node: Node) -> Ragged:
    element = node.element if isinstance(node, Array) else node
    offsets = np.cumsum([0, *map(len, rows)])
    together = [item for row in rows for item in row]
    return Ragged(
        values=np.array(together, dtype_of(element.kind)) if isinstance(element, Number) else together, offsets=offsets
    )


def _nanoseconds(value: object) -> int:
    if isinstance(value, dict):
        fields = cast(dict[str, object], value)
        match [fields[name] for name in time_parts(fields) or ()]:
            case [int(whole), int(rest)]:
                value = whole * 1_000_000_000 + rest
            case _:
                raise _ShapeError
    if not isinstance(value, int) or isinstance(value, bool) or not -_MOST_NS <= value <= _MOST_NS:
        raise _ShapeError
    return value
