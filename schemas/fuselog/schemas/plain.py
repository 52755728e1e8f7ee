"""One message from plain Python data: for those that come seldom and differ in more than their numbers."""

import struct
from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from fuselog.schemas.errors import SchemaError
from fuselog.schemas.paths import Path, join_path
from fuselog.schemas.ros2msg import parse_ros2msg
from fuselog.schemas.tree import Array, Node, Number, Record, Text, dtype_of, is_time, kind_of

_HEADER: Final = b"\x00\x01\x00\x00"  # CDR, little endian
_SECOND: Final = 1_000_000_000


class PlainEncoder:
    """Encodes messages, little endian, from dictionaries by field name, lists, strings and numbers.

    What a dictionary does not have is zero or empty; a time may be given as ns.
    """

    def __init__(self, schema_name: str, schema_text: str) -> None:
        self._schema = schema_name
        self._root = parse_ros2msg(schema_name, schema_text)

    def encode(self, message: Mapping[str, Any]) -> bytes:
        """The CDR of one message. Raises SchemaError for a field that is not there, or cannot hold what is given."""
        out = bytearray(_HEADER)
        self._write(out, (), self._root, message)
        return bytes(out)

    def _write(self, out: bytearray, path: Path, node: Node, given: Any) -> None:
        match node:
            case Number(kind):
                self._write_number(out, path, kind, given)
            case Text(False) if isinstance(given, str):
                raw = given.encode() + b"\0"
                _write_count(out, len(raw))
                out += raw
            case Record() if is_time(node) and isinstance(given, int):
                for child, number in zip(node.fields.items(), divmod(given, _SECOND), strict=True):
                    self._write(out, (*path, child[0]), child[1], number)
            case Record(_, fields) if isinstance(given, Mapping):
                self._write_record(out, path, fields, given)  # pyright: ignore[reportUnknownArgumentType]  plain data of any shape
            case Array(element, length) if isinstance(given, list | tuple):
                values = list[Any](given)  # pyright: ignore[reportUnknownArgumentType]  the same
                if length is None:
                    _write_count(out, len(values))
                elif length != len(values):
                    raise self._wrong(path, node, given)
                for index, each in enumerate(values):
                    self._write(out, (*path, index), element, each)
            case _:
                raise self._wrong(path, node, given)

    def _write_record(self, out: bytearray, path: Path, fields: Mapping[str, Node], given: Mapping[str, Any]) -> None:
        for name in given:
            if name not in fields:
                raise SchemaError(self._schema, f"no field {join_path((*path, name))}")
        for name, child in fields.items():
            self._write(out, (*path, name), child, given.get(name, _nothing(child)))

    def _write_number(self, out: bytearray, path: Path, kind: str, given: Any) -> None:
        dtype = dtype_of(kind).newbyteorder("<")
        try:
            raw = np.array(given, dtype).tobytes()
        except (ValueError, TypeError, OverflowError) as error:
            raise self._wrong(path, Number(kind), given) from error
        _align(out, dtype.itemsize)
        out += raw

    def _wrong(self, path: Path, node: Node, given: Any) -> SchemaError:
        return SchemaError(self._schema, f"{join_path(path)} is {kind_of(node)} and cannot hold {given!r}")


def _nothing(node: Node) -> Any:
    """What stands for a field that is not given."""
    match node:
        case Text():
            return ""
        case Record():
            return {}
        case Array(element, length):
            return [_nothing(element)] * (length or 0)
        case _:
            return 0


def _write_count(out: bytearray, count: int) -> None:
    _align(out, 4)
    out += struct.pack("<I", count)


def _align(out: bytearray, size: int) -> None:
    out += bytes(-(len(out) - len(_HEADER)) % size)
