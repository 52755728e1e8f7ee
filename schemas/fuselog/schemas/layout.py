"""A message type as a table: which columns its fields make, and what fits into none."""

from collections.abc import Iterator, Sequence
from typing import Final, NamedTuple

from fuselog.schemas.errors import SchemaError
from fuselog.schemas.paths import COUNT, Path, find_node, join_path, split_path
from fuselog.schemas.tree import Array, Node, Number, Open, Record, Text, is_time, kind_of, time_parts

_MOST_ELEMENTS: Final = 64  # of a fixed array of messages
_MOST_COLUMNS: Final = 10_000


class ColumnKind(NamedTuple):
    """What a column holds for each message: one element, ``length`` of them, or as many as the message says.

    ``element`` is a primitive (``float64``), ``string``, ``time`` or ``duration`` (whole ns, of the fields ``parts``
    that hold seconds and nanoseconds).
    """

    element: str
    array: bool = False
    length: int | None = None
    parts: tuple[str, str] | None = None

    def __str__(self) -> str:
        length = "" if self.length is None else self.length
        return f"{self.element}[{length}]" if self.array else self.element


class Layout(NamedTuple):
    """The columns by path, in the order of the message; and what has none, with the reason."""

    columns: dict[str, ColumnKind]
    left_out: dict[str, str]


def lay_out(schema: str, root: Node, fields: Sequence[str] | None) -> Layout:
    """The columns of ``fields``, each a path with all that is below it; of the whole message when None.

    A field without a type is taken for a number. Raises SchemaError for a field that is not there, and for one of
    ``fields`` that makes no column.
    """
    columns: dict[str, ColumnKind] = {}
    left_out: dict[str, str] = {}
    for text in [None] if fields is None else fields:
        path = () if text is None else split_path(schema, text)
        node = find_node(schema, root, path)
        found, left = dict[str, ColumnKind](), dict[str, str]()
        listed = [(path, ColumnKind("float64"))] if path and isinstance(node, Open) else _columns(path, node)
        for at, kind in listed:
            if isinstance(kind, str):
                left[join_path(at)] = kind
            else:
                found[join_path(at)] = kind
        if text is not None and text in left:
            raise SchemaError(schema, f"{text}: {left[text]}")
        columns |= found
        left_out |= left
    if len(columns) > _MOST_COLUMNS:
        raise SchemaError(schema, f"{len(columns)} columns, more than {_MOST_COLUMNS}; name the fields that you need")
    return Layout(columns, left_out)


def _columns(path: Path, node: Node) -> Iterator[tuple[Path, ColumnKind | str]]:
    """The columns at and below ``path``, or why there is none."""
    match node:
        case Number(kind):
            yield path, ColumnKind(kind)
        case Text():
            yield path, ColumnKind("string")
        case Record(name, fields) if is_time(node):
            element = "duration" if name.endswith("Duration") else "time"
            yield path, ColumnKind(element, parts=time_parts(fields))
        case Record(_, fields):
            for name, child in fields.items():
                yield from _columns((*path, name), child)
        case Array(Number(kind), length):
            yield path, ColumnKind(kind, True, length)
        case Array(Text(wide=False), length):
            yield path, ColumnKind("string", True, length)
        case Array(element, int(length)) if length <= _MOST_ELEMENTS:
            for index in range(length):
                yield from _columns((*path, index), element)
        case Array(element, None):
            yield (*path, COUNT), ColumnKind("uint32")
            yield path, f"{kind_of(node)}, of which the elements make no column; ask for {_example(path, element)}"
        case Array():
            yield path, f"{kind_of(node)}, more than {_MOST_ELEMENTS} elements; ask for {join_path((*path, 0))}"
        case _:
            yield path, "its type is not known from the schema; name the fields that you need"


def _example(path: Path, element: Node) -> str:
    """A path into element 0 that makes a column, if there is one."""
    below = _columns((*path, 0), element)
    return join_path(next((at for at, kind in below if isinstance(kind, ColumnKind)), (*path, COUNT)))
