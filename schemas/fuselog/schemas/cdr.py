"""CDR payloads (XCDR1, both endiannesses) of any ROS 2 schema into columns."""

from collections.abc import Sequence
from typing import Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from fuselog.schemas.machine import Rows, run
from fuselog.schemas.messages import Columns, Fault, empty_rows
from fuselog.schemas.paths import expand, join_path, split_path, stamp_leaves
from fuselog.schemas.program import Want, assemble
from fuselog.schemas.spans import find_changes, find_listable, read_spans
from fuselog.schemas.tree import Node, Text

_MANY: Final = 64  # texts that it pays to compare first
_Scalar = TypeVar("_Scalar", bound=np.generic)


class CdrCodec:
    """Decodes chosen fields of one message type.

    ``paths`` are the numeric leaves of the fields that were asked for, one column each; string leaves go to
    ``Columns.texts``, and ``lists`` to ``Columns.lists``. A message is walked to its last field whatever was
    asked for, so that a truncated one is a fault always. Wide strings are a count and as many units of 2 bytes,
    as Fast-CDR writes them since version 2.
    """

    def __init__(
        self, schema_name: str, root: Node, fields: Sequence[str], stamp: str | None, lists: Sequence[str] = ()
    ) -> None:
        want = Want()
        columns: list[int] = []  # of the machine's output, one per path
        paths: list[str] = []
        self._texts: dict[str, tuple[int, str]] = {}
        leaves = [leaf for text in fields for leaf in expand(schema_name, root, split_path(schema_name, text))]
        for path, node in leaves:
            leaf = want.at(path)
            name = join_path(path)
            if isinstance(node, Text):
                leaf.column = self._texts.setdefault(name, (len(self._texts), _encoding(node)))[0]
                continue
            leaf.column = leaf.column if leaf.column >= 0 else len(paths)
            columns.append(leaf.column)
            paths.append(name)
        if stamp is not None:
            for path, scale in stamp_leaves(schema_name, root, split_path(schema_name, stamp)):
                want.at(path).stamp_scale = scale
        self._lists: dict[str, tuple[int, Node]] = {}
        for text in lists:
            node = find_listable(schema_name, root, split_path(schema_name, text))
            column = want.at(split_path(schema_name, text)).span = len(self._texts) + len(self._lists)
            self._lists[text] = column, node
        self.paths = tuple(paths)
        self._repeated = [(at, column) for at, column in enumerate(columns) if at != column]
        self._program = assemble(root, want)
        none = np.empty(0, np.int64)
        self.decode(np.empty(0, np.uint8), none, none)  # the machine is compiled now, not at the first sample

    def decode(
        self,
        data: NDArray[np.uint8],
        start: NDArray[np.int64],
        length: NDArray[np.int64],
        *,
        out: Columns | None = None,
    ) -> Columns:
        """Columns (n, width) of the payloads ``data[start[i] : start[i] + length[i]]``.

        Never raises for what is in the bytes, nor when ``start`` or ``length`` point outside ``data``: such a
        message is a row with its fault. ``out``: n rows whose numbers, stamps and faults are written over.
        """
        n = len(start)
        if len(length) != n:
            raise ValueError(f"{n} starts and {len(length)} lengths")
        payloads = _fixed(np.ascontiguousarray(data, np.uint8))
        starts = _fixed(np.ascontiguousarray(start, np.int64))
        text_start, text_length = np.empty((2, n, len(self._texts) + len(self._lists)), np.int64)
        t_ns, values, fault = empty_rows(n, len(self.paths)) if out is None else (out.t_ns, out.values, out.fault)
        rows = Rows(t_ns, values, fault, text_start, text_length)
        run(self._program, payloads, starts, _fixed(np.ascontiguousarray(length, np.int64)), rows)
        for column, source in self._repeated:
            values[:, column] = np.where(fault == Fault.NONE, values[:, source], np.nan)
        texts = {
            name: _strings(payloads, starts, text_start[:, column], text_length[:, column], encoding)
            for name, (column, encoding) in self._texts.items()
        }
        lists = {
            name: read_spans(node, payloads, starts, *map(np.ascontiguousarray, (text_start.T[k], text_length.T[k])))
            for name, (k, node) in self._lists.items()
        }
        return Columns(t_ns=t_ns, values=values, paths=self.paths, fault=fault, texts=texts, lists=lists)


def _encoding(node: Text) -> str:
    return "utf-16" if node.wide else "utf-8"


def _fixed(array: NDArray[_Scalar]) -> NDArray[_Scalar]:
    """A read-only view: the one kind of array that the machine is compiled for."""
    view = array.view()
    view.flags.writeable = False
    return view


def _strings(
    data: NDArray[np.uint8],
    message: NDArray[np.int64],
    start: NDArray[np.int64],
    length: NDArray[np.int64],
    encoding: str,
) -> list[str]:
    """The texts; those that stay the same from message to message, as frames do, are decoded once."""
    times = [1] * len(message)
    if len(message) >= _MANY:
        start, length = np.ascontiguousarray(start), np.ascontiguousarray(length)
        differs = np.empty(len(message), np.bool_)
        find_changes(data, message, start, length, differs)
        changes = np.flatnonzero(differs)
        times = np.diff(changes, append=len(message)).tolist()
        message, start, length = message[changes], start[changes], length[changes]
    known: dict[bytes, str] = {}
    texts: list[str] = []
    view = data.data
    for first, at, size, n in zip(message.tolist(), start.tolist(), length.tolist(), times, strict=True):
        raw = bytes(view[at : at + size])
        if encoding == "utf-16" and size:
            texts += [raw.decode("utf-16-le" if view[first + 1] else "utf-16-be", "replace")] * n
            continue
        text = known.get(raw)
        if text is None:
            text = known[raw] = raw.decode(encoding, "replace")
        texts += [text] * n
    return texts
