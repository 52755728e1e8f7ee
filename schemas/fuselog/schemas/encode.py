"""Columns into CDR messages that differ only in their numbers: one template, and a place for each column."""

import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from fuselog.schemas.errors import SchemaError
from fuselog.schemas.paths import Path, find_node, join_path, split_path, stamp_leaves
from fuselog.schemas.ros2msg import parse_ros2msg
from fuselog.schemas.tree import KINDS, Array, Node, Number, Record, Text, dtype_of
from fuselog.schemas.write import WRITTEN, write_messages

_T = TypeVar("_T", int, str)
_HEADER: Final = b"\x00\x01\x00\x00"  # CDR, little endian


@dataclass(frozen=True, slots=True)
class _Slot:
    """Where a number lies in the template, and how it is stored."""

    offset: int
    kind: str  # of ``KINDS``

    @property
    def dtype(self) -> "np.dtype[np.generic]":
        """Little endian."""
        return dtype_of(self.kind).newbyteorder("<")


class CdrEncoder:
    """Encodes n messages at once, little endian, all with the same strings and the same sequence lengths.

    ``columns`` are the varying fields (``pose.covariance`` or, with its length given, ``state`` stand for all
    their elements); ``constants`` fixes strings and numbers, ``lengths`` the element counts of sequences.
    What is in neither is zero or empty. ``stamp`` takes the ns of ``encode``.

    Raises SchemaError: a path that is not there, is of the wrong type, or lies in a sequence too short.
    """

    def __init__(
        self,
        schema_name: str,
        schema_text: str,
        *,
        columns: Sequence[str],
        constants: Mapping[str, str | float] | None = None,
        lengths: Mapping[str, int] | None = None,
        stamp: str | None = "header.stamp",
    ) -> None:
        root = parse_ros2msg(schema_name, schema_text)
        layout = _Layout(schema_name, root, constants or {}, lengths or {})
        slots = [(path, slot) for text in columns for path, slot in layout.numbers(text)]
        self.paths = tuple(path for path, _ in slots)
        self.size = len(layout.template)
        self._schema = schema_name
        self.template = bytes(layout.template)  # a message whose columns are 0
        self._template = np.frombuffer(self.template, np.uint8)
        self._kinds = [slot.kind for _, slot in slots]
        self._runs = _runs([slot for _, slot in slots])
        self._stamp, self._stamp_kind = np.empty((0, 3), np.int64), ""
        if stamp is not None:
            leaves = stamp_leaves(schema_name, root, split_path(schema_name, stamp))
            parts = [(layout.numbers(join_path(path))[0][1], scale) for path, scale in leaves]
            self._stamp = np.array([(slot.offset, KINDS[slot.kind], scale) for slot, scale in parts], np.int64)
            self._stamp_kind = parts[0][0].kind

    def encode(
        self, t_ns: NDArray[np.int64], values: NDArray[np.float64], *, out: NDArray[np.uint8] | None = None
    ) -> tuple[NDArray[np.uint8], int]:
        """The messages of ``t_ns`` (n,) and ``values`` (n, width), one after another, and the size of each.

        They are written to ``out`` (n * size,) when it is given. Whole numbers are stored exactly. Raises
        SchemaError for a value or stamp that its field cannot hold.
        """
        n = len(t_ns)
        if values.shape != (n, len(self.paths)):
            raise ValueError(f"values are {values.shape}, not {(n, len(self.paths))}")
        data = np.empty(n * self.size, np.uint8) if out is None else out
        columns = np.ascontiguousarray(t_ns, np.int64), np.ascontiguousarray(values, np.float64)
        refused = write_messages(data, self._template, *columns, self._runs, self._stamp)
        if refused != WRITTEN:
            path, kind = (self.paths[refused], self._kinds[refused]) if refused >= 0 else ("stamp", self._stamp_kind)
            raise SchemaError(self._schema, f"{path} has values that {dtype_of(kind).name} cannot hold")
        return data, self.size


def _holds(dtype: "np.dtype[np.generic]", values: NDArray[np.number]) -> bool:
    """Whether an integer type holds all values exactly; floats and bools take anything."""
    if dtype.kind in "fb":
        return True
    if values.size == 0:
        return True
    limits = np.iinfo(dtype.str)
    inside = limits.min <= values.min() and values.max() < limits.max + 1
    return bool(inside and (values.dtype.kind in "iu" or np.array_equal(np.rint(values), values)))


def _runs(slots: list[_Slot]) -> NDArray[np.int64]:
    """(runs, 4): columns first to last - 1 that lie one after another from an offset on, stored as one kind."""
    breaks = [0]
    for column, (before, after) in enumerate(pairwise(slots), start=1):
        if (after.kind, after.offset) != (before.kind, before.offset + before.dtype.itemsize):
            breaks.append(column)
    ends = [*breaks[1:], len(slots)]
    runs = [(a, b, slots[a].offset, KINDS[slots[a].kind]) for a, b in zip(breaks, ends, strict=True) if a < b]
    return np.array(runs, np.int64).reshape(-1, 4)


class _Layout:
    """The template, written once from the first byte to the last, and the slot of every number in it."""

    def __init__(
        self, schema: str, root: Record, constants: Mapping[str, str | float], lengths: Mapping[str, int]
    ) -> None:
        self.template = bytearray(_HEADER)
        self.slots: dict[Path, _Slot] = {}
        self._schema = schema
        self._root = root
        self._lengths = {split_path(schema, text): length for text, length in lengths.items()}
        self._strings = {split_path(schema, text): at for text, at in constants.items() if isinstance(at, str)}
        self._used: set[Path] = set()
        self._write((), root)
        self._all_used()
        for text, number in constants.items():
            if not isinstance(number, str):
                self._fill(text, number)

    def numbers(self, text: str) -> list[tuple[str, _Slot]]:
        """The slot at ``text``, or the slots of all numbers below it."""
        path = split_path(self._schema, text)
        found = [(join_path(at), slot) for at, slot in self.slots.items() if at[: len(path)] == path]
        if not found:
            node = find_node(self._schema, self._root, path)  # says what there is instead
            raise SchemaError(self._schema, f"{text} holds no number here ({type(node).__name__.lower()})")
        return found

    def _fill(self, text: str, number: float) -> None:
        for _, slot in self.numbers(text):
            if not _holds(slot.dtype, np.array(number)):
                raise SchemaError(self._schema, f"{text} cannot hold {number} ({slot.dtype.name})")
            stored = np.array(number).astype(slot.dtype).tobytes()
            self.template[slot.offset : slot.offset + len(stored)] = stored

    def _write(self, path: Path, node: Node) -> None:
        match node:
            case Number(kind):
                size = dtype_of(kind).itemsize
                self._align(size)
                self.slots[path] = _Slot(len(self.template), kind)
                self.template += bytes(size)
            case Text(wide):
                self._write_text(self._given(self._strings, path, ""), wide)
            case Record(_, fields):
                for name, child in fields.items():
                    self._write((*path, name), child)
            case Array(element, length):
                if length is None:
                    length = self._given(self._lengths, path, 0)
                    self._write_count(length)
                for index in range(length):
                    self._write((*path, index), element)
            case _:
                raise AssertionError(node)

    def _write_text(self, text: str, wide: bool) -> None:
        raw = text.encode("utf-16-le") if wide else text.encode() + b"\0"
        self._write_count(len(raw) // (2 if wide else 1))
        self.template += raw

    def _write_count(self, count: int) -> None:
        self._align(4)
        self.template += struct.pack("<I", count)

    def _align(self, size: int) -> None:
        self.template += bytes(-(len(self.template) - len(_HEADER)) % size)

    def _given(self, given: Mapping[Path, _T], path: Path, default: _T) -> _T:
        if path in given:
            self._used.add(path)
        return given.get(path, default)

    def _all_used(self) -> None:
        for path in {*self._lengths, *self._strings} - self._used:
            kind = "sequence" if path in self._lengths else "string"
            find_node(self._schema, self._root, path)  # says what there is instead
            raise SchemaError(self._schema, f"{join_path(path)} is no {kind} here")
