"""From a message tree and the wanted leaves to a program for the decoding machine."""

from dataclasses import dataclass, field
from typing import Final

import numpy as np

from fuselog.schemas.machine import (
    BEGIN,
    COUNT_ELEMENTS,
    END,
    ITEMS,
    JUMP,
    LOAD,
    NUMBERS,
    SKIP,
    STAMP,
    STRING,
    TIMES,
    WHILE,
    WORDS,
    Program,
)
from fuselog.schemas.paths import COUNT, Path
from fuselog.schemas.tree import KINDS, Array, Node, Number, Record, Text

_TO_THE_END: Final = 2**62


@dataclass(slots=True)
class Want:
    """What is wanted of one node: its column, its share of the stamp, its bytes, and the same of what it holds."""

    column: int = -1
    stamp_scale: int = 0
    span: int = -1  # the text that takes the bytes of the whole node
    below: "dict[str | int, Want]" = field(default_factory=lambda: {})

    def at(self, path: Path) -> "Want":
        """The want of the node at ``path``, made if there is none."""
        want = self
        for token in path:
            want = want.below.setdefault(token, Want())
        return want


def assemble(root: Node, want: Want) -> Program:
    """Operations that walk one message of shape ``root`` from its first byte to its last field."""
    assembler = _Assembler()
    assembler.node(root, want)
    rows = [[*row, *(0,) * (WORDS - len(row))] for row in assembler.rows]
    codes = [row[0] for row in rows]
    return Program(
        operations=np.array(rows, np.int64).reshape(len(rows), WORDS),
        depth=assembler.deepest,
        stamp_parts=codes.count(STAMP),
        gaps=ITEMS in codes or WHILE in codes,
    )


class _Assembler:
    """Appends operations; neighbours that do the same to the next bytes become one."""

    def __init__(self) -> None:
        self.rows: list[list[int]] = []
        self.deepest = 0
        self._fence = 0  # operations before it are jumped to or over, and must stay as they are
        self._depth = 0

    def node(self, node: Node, want: Want) -> None:
        if want.span >= 0:
            self._put(BEGIN, first_size(node), want.span)
        self._node(node, want)
        if want.span >= 0:
            self._put(END, want.span)

    def _node(self, node: Node, want: Want) -> None:
        match node:
            case Number(kind):
                self._number(KINDS[kind], want)
            case Text(wide):
                self._put(STRING, 2 if wide else 1, want.column)
            case Record(_, fields):
                for name, child in fields.items():
                    self.node(child, want.below.get(name, Want()))
            case Array(Number(kind), int(length)):
                self._fixed_numbers(KINDS[kind], length, want)
            case Array(Number(kind), None):
                self._numbers(KINDS[kind], want)
            case Array(element, length):
                self._elements(element, length, want)
            case _:
                raise AssertionError(node)

    def _put(self, *row: int) -> list[int]:
        self.rows.append(list(row))
        return self.rows[-1]

    def _last(self, operation: int) -> list[int] | None:
        """The last operation, if it is such a one and may still be changed."""
        if len(self.rows) > self._fence and self.rows[-1][0] == operation:
            return self.rows[-1]
        return None

    def _number(self, kind: int, want: Want) -> None:
        if want.stamp_scale:
            self._put(STAMP, kind, want.stamp_scale)
        if want.column < 0:
            self._skip(kind, 1)
            return
        match self._last(LOAD):
            case [_, before, count, first] if before == kind and first + count == want.column:
                self.rows[-1][2] += 1
            case _:
                self._put(LOAD, kind, 1, want.column)

    def _skip(self, kind: int, count: int) -> None:
        size = 1 << (kind >> 2)
        match self._last(SKIP):
            case [_, before, _] if before == size:
                self.rows[-1][2] += count
            case _ if count > 0:
                self._put(SKIP, size, count)
            case _:
                pass

    def _fixed_numbers(self, kind: int, length: int, want: Want) -> None:
        done = 0
        for index, below in _elements_wanted(want):
            self._skip(kind, index - done)
            self._number(kind, below)
            done = index + 1
        self._skip(kind, length - done)

    def _numbers(self, kind: int, want: Want) -> None:
        self._put(NUMBERS, kind, _count_column(want))
        for index, below in _elements_wanted(want):
            match self._last(ITEMS):
                case [_, _, start, count, first] if (start + count, first + count) == (index, below.column):
                    self.rows[-1][3] += 1
                case _:
                    self._put(ITEMS, kind, index, 1, below.column)

    def _elements(self, element: Node, length: int | None, want: Want) -> None:
        register, self._depth = self._depth, self._depth + 1
        self.deepest = max(self.deepest, self._depth)
        if length is None:
            self._put(COUNT_ELEMENTS, register, _count_column(want))
        else:
            self._put(TIMES, register, length)
        for index, below in _elements_wanted(want):
            self._while(register, index, element, Want(), again=True)
            self._while(register, index + 1, element, below, again=False)
        self._while(register, _TO_THE_END, element, Want(), again=True)
        self._depth = register

    def _while(self, register: int, limit: int, element: Node, want: Want, *, again: bool) -> None:
        top = len(self.rows)
        head = self._put(WHILE, register, limit, 0)
        self._fence = len(self.rows)
        self.node(element, want)
        if again:
            self._put(JUMP, top)
        head[3] = self._fence = len(self.rows)


def _count_column(want: Want) -> int:
    return want.below[COUNT].column if COUNT in want.below else -1


def _elements_wanted(want: Want) -> list[tuple[int, Want]]:
    return sorted((index, below) for index, below in want.below.items() if isinstance(index, int) and index >= 0)


def first_size(node: Node) -> int:
    """The size, which is the alignment, of what a number, a fixed array of them, or a sequence begins with."""
    match node:
        case Number(kind) | Array(Number(kind), int()):
            return 1 << (KINDS[kind] >> 2)
        case _:
            return 4
