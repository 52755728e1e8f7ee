"""A CDR message as plain Python values: slower than columns, but all of it, whatever its strings and lengths."""

import struct
from collections.abc import Callable
from typing import Any, Final, Literal

from fuselog.schemas.errors import SchemaError
from fuselog.schemas.tree import Array, Node, Number, Record, Text, dtype_of

_HEADER: Final = 4  # bytes; alignment counts from behind it
_BIG_ENDIAN, _LITTLE_ENDIAN = b"\x00\x00", b"\x00\x01"  # it begins with one of them
_LETTERS: Final = {
    "bool": "?",
    "byte": "B",
    "char": "B",
    "uint8": "B",
    "int8": "b",
    "uint16": "H",
    "int16": "h",
    "uint32": "I",
    "int32": "i",
    "float32": "f",
    "uint64": "Q",
    "int64": "q",
    "float64": "d",
}


class CdrReader:
    """Reads messages of one type (XCDR1, both endiannesses): records as dictionaries, arrays as lists."""

    def __init__(self, root: Record) -> None:
        self._schema = root.name
        self._read = _reader(root)

    def read(self, payload: bytes | memoryview) -> dict[str, Any]:
        """The fields of a message by name; raises SchemaError for a payload that is too short, or is not CDR."""
        header = bytes(payload[:2])
        if header not in (_BIG_ENDIAN, _LITTLE_ENDIAN) or len(payload) < _HEADER:
            raise SchemaError(self._schema, f"a payload of {len(payload)} bytes without the header of CDR")
        body = _Body(bytes(payload[_HEADER:]), little_endian=header == _LITTLE_ENDIAN)
        try:
            return self._read(body)
        except _ShortError as error:
            raise SchemaError(self._schema, f"a payload of {len(payload)} bytes is not a whole message") from error


class _ShortError(Exception):
    """A number, a text or a count reaches beyond the end of the payload."""


class _Body:
    """The bytes of a message behind its header, read from the first to the last."""

    def __init__(self, data: bytes, *, little_endian: bool) -> None:
        self._data, self._size = data, len(data)
        self._order: Literal["little", "big"] = "little" if little_endian else "big"
        self._sign, self._utf16 = ("<", "utf-16-le") if little_endian else (">", "utf-16-be")
        self._at = 0  # of the next byte

    def numbers(self, letter: str, size: int, count: int) -> tuple[Any, ...]:
        """The next ``count`` numbers of one kind, aligned to their size in bytes."""
        if not count:
            return ()
        first = (self._at + size - 1) & -size
        self._at = first + count * size
        if self._at > self._size:
            raise _ShortError
        return struct.unpack_from(f"{self._sign}{count}{letter}", self._data, first)

    def count(self) -> int:
        """The next count, of what takes a byte each at least."""
        first = (self._at + 3) & -4
        self._at = first + 4
        count = int.from_bytes(self._data[first : self._at], self._order)
        if self._at + count > self._size:
            raise _ShortError
        return count

    def text(self) -> str:
        """The next string, which ends with a zero byte unless nothing is there at all."""
        raw = self._take(self.count())
        if raw and raw[-1] != 0:
            raise _ShortError
        return raw[:-1].decode(errors="replace")

    def wide_text(self) -> str:
        """The next wide string: units of 2 bytes, as Fast-CDR writes them since version 2."""
        return self._take(2 * self.count()).decode(self._utf16, "replace")

    def _take(self, size: int) -> bytes:
        first, self._at = self._at, self._at + size
        if self._at > self._size:
            raise _ShortError
        return self._data[first : self._at]


def _reader(node: Node) -> Callable[[_Body], Any]:
    """What reads the values of ``node``, chosen once for all messages."""
    match node:
        case Number(kind):
            letter, size = _LETTERS[kind], dtype_of(kind).itemsize
            return lambda body: body.numbers(letter, size, 1)[0]
        case Text(wide):
            return _Body.wide_text if wide else _Body.text
        case Record(_, fields):
            readers = [(name, _reader(child)) for name, child in fields.items()]
            return lambda body: {name: read(body) for name, read in readers}
        case Array(Number(kind), length):
            letter, size = _LETTERS[kind], dtype_of(kind).itemsize
            return lambda body: list(body.numbers(letter, size, body.count() if length is None else length))
        case Array(element, length):
            read = _reader(element)
            return lambda body: [read(body) for _ in range(body.count() if length is None else length)]
        case _:
            raise AssertionError(node)
