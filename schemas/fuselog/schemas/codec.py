"""The choice of decoder: what a channel says of its encoding, once, into something that decodes batches."""

from collections.abc import Callable, Sequence
from typing import Final, Protocol, TypedDict

import numpy as np
from numpy.typing import NDArray

from fuselog.schemas.cdr import CdrCodec
from fuselog.schemas.errors import SchemaError
from fuselog.schemas.json_columns import JsonCodec
from fuselog.schemas.jsonschema import parse_jsonschema
from fuselog.schemas.layout import Layout, lay_out
from fuselog.schemas.messages import Columns
from fuselog.schemas.paths import guess_stamp, list_paths
from fuselog.schemas.ros2msg import parse_ros2msg
from fuselog.schemas.tree import Node


class MessageType(TypedDict):
    """What a channel says of its messages: how they are encoded, and their definition."""

    encoding: str
    schema_encoding: str
    schema_name: str
    schema_text: str | bytes


class Codec(Protocol):
    """Decodes the payloads of one channel, a batch at a time."""

    @property
    def paths(self) -> tuple[str, ...]:
        """The numeric fields, in the order of the columns."""
        ...

    def decode(
        self,
        data: NDArray[np.uint8],
        start: NDArray[np.int64],
        length: NDArray[np.int64],
        *,
        out: Columns | None = None,
    ) -> Columns:
        """Columns of the payloads ``data[start[i] : start[i] + length[i]]``; a bad one gives its fault.

        ``out``: n rows whose numbers, stamps and faults are written over, and come back.
        """
        ...


def compile_codec(
    *,
    encoding: str,
    schema_encoding: str,
    schema_name: str,
    schema_text: str | bytes,
    fields: Sequence[str],
    stamp: str | None,
    lists: Sequence[str] = (),
) -> Codec:
    """The decoder of ``fields`` of one channel.

    A field is a path: ``angular_velocity.z``, ``pose.covariance[0]``; a fixed array or a submessage of
    numbers as a whole, one column per leaf; ``transforms[2].transform.rotation.x``, NaN when there are fewer;
    ``transforms[]``, how many there are; or a string, which goes to ``Columns.texts``. ``stamp`` is a
    builtin_interfaces/Time or a 64-bit number of ns, and fills ``Columns.t_ns``. ``lists`` are arrays of numbers
    or strings of any length, and numbers that float64 would round; they go to ``Columns.lists``.

    Raises SchemaError: an encoding that is not supported, a schema that cannot be read, a field not in it.
    """
    root = _tree(encoding, schema_encoding, schema_name, schema_text)
    return _CODECS[encoding](schema_name, root, fields, stamp, lists)


def field_paths(*, encoding: str, schema_encoding: str, schema_name: str, schema_text: str | bytes) -> dict[str, str]:
    """All paths of a schema with their kinds; element 0 stands for the elements of an array of messages."""
    return list_paths(_tree(encoding, schema_encoding, schema_name, schema_text))


def stamp_path(*, encoding: str, schema_encoding: str, schema_name: str, schema_text: str | bytes) -> str | None:
    """Where the stamp probably is: ``header.stamp``, else a top-level field named like one, else None."""
    return guess_stamp(_tree(encoding, schema_encoding, schema_name, schema_text))


def layout(
    *,
    encoding: str,
    schema_encoding: str,
    schema_name: str,
    schema_text: str | bytes,
    fields: Sequence[str] | None = None,
) -> Layout:
    """The columns that ``fields`` of a type make in a table, all fields when None; see `lay_out`."""
    return lay_out(schema_name, _tree(encoding, schema_encoding, schema_name, schema_text), fields)


_PARSERS: Final[dict[tuple[str, str], Callable[[str, str], Node]]] = {
    ("cdr", "ros2msg"): parse_ros2msg,
    ("json", "jsonschema"): parse_jsonschema,
    ("json", ""): parse_jsonschema,
}
_CODECS: Final[dict[str, Callable[[str, Node, Sequence[str], str | None, Sequence[str]], Codec]]] = {
    "cdr": CdrCodec,
    "json": JsonCodec,
}


def _tree(encoding: str, schema_encoding: str, schema_name: str, schema_text: str | bytes) -> Node:
    parse = _PARSERS.get((encoding, schema_encoding))
    if parse is None:
        supported = ", ".join(f"{of} with {schema or 'no'} schema" for of, schema in _PARSERS)
        found = f"{encoding or 'no'} encoding with {schema_encoding or 'no'} schema"
        raise SchemaError(schema_name, f"{found} is not supported (supported: {supported})")
    text = schema_text if isinstance(schema_text, str) else schema_text.decode("utf-8", "replace")
    return parse(schema_name, text)
