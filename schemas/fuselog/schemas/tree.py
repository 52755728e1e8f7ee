"""The shape of a message as a small tree: what every schema language is parsed into."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final, TypeAlias

import numpy as np

KINDS: Final = {
    "bool": 3,
    "byte": 0,
    "char": 0,
    "uint8": 0,
    "int8": 1,
    "uint16": 4,
    "int16": 5,
    "uint32": 8,
    "int32": 9,
    "float32": 10,
    "uint64": 12,
    "int64": 13,
    "float64": 14,
}
"""Primitive types by name; the code is 4 log2(size in bytes) + (0 unsigned, 1 signed, 2 float, 3 bool)."""


_LETTERS: Final = "uifb"  # numpy's, by the lowest two bits of a kind


def dtype_of(kind: str) -> "np.dtype[np.generic]":
    """The numpy type of a primitive, in the byte order of this machine."""
    code = KINDS[kind]
    return np.dtype(f"{_LETTERS[code % 4]}{1 << code // 4}")


@dataclass(frozen=True, slots=True)
class Number:
    """A primitive number; ``kind`` is a key of ``KINDS``."""

    kind: str


@dataclass(frozen=True, slots=True)
class Text:
    """A string; ``wide`` ones are UTF-16."""

    wide: bool = False


@dataclass(frozen=True, slots=True)
class Open:
    """Anything, as nothing is known: a JSON value without a schema."""


@dataclass(frozen=True, slots=True)
class Array:
    """``length`` elements of one shape; None when the message says how many."""

    element: "Node"
    length: int | None


@dataclass(frozen=True, slots=True)
class Record:
    """Named fields in the order in which they are serialised."""

    name: str
    fields: "dict[str, Node]"


Node: TypeAlias = Number | Text | Open | Array | Record

_SECONDS: Final = ("sec", "secs", "seconds")
_NANOSECONDS: Final = ("nanosec", "nsec", "nsecs", "nanos", "nanoseconds")


def time_parts(names: Iterable[str]) -> tuple[str, str] | None:
    """The names of whole seconds and nanoseconds, if these are all: as in builtin_interfaces/Time."""
    match sorted(names, key=lambda name: name in _NANOSECONDS):
        case [seconds, nanoseconds] if seconds in _SECONDS and nanoseconds in _NANOSECONDS:
            return seconds, nanoseconds
        case _:
            return None


def is_time(node: Node) -> bool:
    """Whether ``node`` is a record of whole seconds and nanoseconds and nothing else."""
    return (
        isinstance(node, Record) and time_parts(node.fields) is not None and all(map(is_integer, node.fields.values()))
    )


def is_integer(node: Node) -> bool:
    """Whether ``node`` is a signed or unsigned integer of any size."""
    return isinstance(node, Number) and KINDS[node.kind] % 4 < 2


def kind_of(node: Node) -> str:
    """``node`` in one word, for messages: ``float64[9]``, ``string``, ``geometry_msgs/Point[]``."""
    match node:
        case Number(kind):
            return kind
        case Text(wide):
            return "wstring" if wide else "string"
        case Open():
            return "any"
        case Array(element, length):
            return f"{kind_of(element)}[{'' if length is None else length}]"
        case Record(name):
            return name
