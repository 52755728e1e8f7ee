"""ROS 2 message definitions, as embedded in logs: concatenated ``.msg`` texts into a tree."""

import re
from collections.abc import Iterator
from typing import Final, NamedTuple

from fuselog.schemas.errors import SchemaError
from fuselog.schemas.tree import KINDS, Array, Node, Number, Record, Text

_SEPARATOR: Final = re.compile(r"^=+[ \t]*$", re.MULTILINE)
_TITLE: Final = re.compile(r"\s*MSG:[ \t]*(\S+)[ \t]*")
_FIELD: Final = re.compile(
    r"(?P<type>[A-Za-z][\w/]*)(?:<=(?P<bound>\d+))?(?:\[(?P<upto><=)?(?P<length>\d*)\])?"
    r"[ \t]+(?P<name>[A-Za-z]\w*)[ \t]*(?P<rest>.*)"
)
_ALWAYS_THERE: Final = {
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec",
    "builtin_interfaces/Duration": "int32 sec\nuint32 nanosec",
}
_STRINGS: Final = ("string", "wstring")
_MOST_ELEMENTS: Final = 2**31
_MOST_NESTED: Final = 64
_MOST_FIELDS: Final = 100_000


class Field(NamedTuple):
    """A field as it is written: a primitive or ``pkg/msg/Type``, and in digits what bounds its text and its length.

    ``length`` is None for one value, empty for as many as come; with ``upto`` it is the most that may come.
    """

    name: str
    type: str
    bound: str
    length: str | None
    upto: bool


def fields_by_type(schema_name: str, schema_text: str) -> dict[str, list[Field]]:
    """The fields of ``schema_name`` and of every type that it needs, by ``pkg/msg/Type``, the first one first.

    Raises SchemaError as ``parse_ros2msg`` does.
    """
    parse_ros2msg(schema_name, schema_text)
    texts = _split(short_name(schema_name), schema_text)
    found: dict[str, list[Field]] = {}
    waiting = [short_name(schema_name)]
    while waiting:
        name = waiting.pop()
        if _full_name(name) in found:
            continue
        found[_full_name(name)] = [_field(name, match) for match in _fields(schema_name, name, texts[name])] or [
            _NOTHING
        ]
        waiting += types_used(name, texts[name])
    return found


_NOTHING: Final = Field("structure_needs_at_least_one_member", "uint8", "", None, upto=False)


def _field(owner: str, match: re.Match[str]) -> Field:
    kind = match["type"]
    plain = kind in KINDS or kind in _STRINGS
    written = kind if plain else _full_name(_qualified(owner, kind))
    return Field(match["name"], written, match["bound"] or "", match["length"], upto=bool(match["upto"]))


def _full_name(name: str) -> str:
    """``pkg/msg/Type`` of ``pkg/Type``."""
    return "/msg/".join(name.split("/"))


def parse_ros2msg(schema_name: str, schema_text: str) -> Record:
    """The tree of ``schema_name`` from its concatenated definition.

    Dependencies follow the first definition, each after a line of ``=`` and a line ``MSG: pkg/Type``.
    Constants, default values, bounds and comments do not change the bytes and are skipped; an empty
    message holds one uint8, as rosidl makes it.

    Raises SchemaError: a line that is not a field, a type that is not defined, a type that holds itself.
    """
    return _Definitions(schema_name, schema_text).record(short_name(schema_name), ())


class _Definitions:
    """The texts of all types, turned into records on demand, each once."""

    def __init__(self, schema_name: str, schema_text: str) -> None:
        self._schema = schema_name
        self._texts = _split(short_name(schema_name), schema_text)
        self._records: dict[str, Record] = {}
        self._sizes: dict[str, int] = {}

    def record(self, name: str, holders: tuple[str, ...]) -> Record:
        if name in holders:
            raise SchemaError(self._schema, f"{name} holds itself: {' -> '.join((*holders, name))}")
        if len(holders) > _MOST_NESTED:
            raise SchemaError(self._schema, f"nested deeper than {_MOST_NESTED} levels at {name}")
        if name not in self._records:
            self._records[name] = self._parse(name, (*holders, name))
        return self._records[name]

    def _parse(self, name: str, holders: tuple[str, ...]) -> Record:
        fields: dict[str, Node] = {}
        size = 1
        for match in _fields(self._schema, name, self._texts[name]):
            node = self._type(name, match["type"], holders)
            fields[match["name"]] = self._shaped(node, match["length"], match["upto"])
            size += self._sizes[node.name] if isinstance(node, Record) else 1
        if size > _MOST_FIELDS:
            raise SchemaError(self._schema, f"{name} has more than {_MOST_FIELDS} fields")
        self._sizes[name] = size
        return Record(name, fields or {"structure_needs_at_least_one_member": Number("uint8")})

    def _shaped(self, node: Node, length: str | None, upto: str | None) -> Node:
        if length is None:
            return node
        if not length or upto:
            return Array(node, None)
        if not 0 < int(length) <= _MOST_ELEMENTS:
            raise SchemaError(self._schema, f"an array of {length} elements")
        return Array(node, int(length))

    def _type(self, owner: str, name: str, holders: tuple[str, ...]) -> Node:
        if name in KINDS:
            return Number(name)
        if name in _STRINGS:
            return Text(wide=name == "wstring")
        qualified = _qualified(owner, name)
        if qualified not in self._texts:
            known = ", ".join(sorted(self._texts))
            raise SchemaError(self._schema, f"{owner} needs {qualified}, not defined here (there are: {known})")
        return self.record(qualified, holders)


def types_used(name: str, text: str) -> list[str]:
    """The ``pkg/Type`` of every message field of one definition, in order, repeated as they come."""
    types = (match["type"] for match in _fields(name, name, text))
    return [_qualified(name, kind) for kind in types if kind not in KINDS and kind not in _STRINGS]


def short_name(name: str) -> str:
    """``pkg/Type`` of ``pkg/msg/Type``."""
    parts = name.split("/")
    return f"{parts[0]}/{parts[-1]}" if len(parts) > 1 else name


def _fields(schema: str, owner: str, text: str) -> Iterator[re.Match[str]]:
    """The lines of a definition that are fields; constants and comments are passed over."""
    for line in map(str.strip, text.splitlines()):
        if not line or line.startswith("#"):
            continue
        match = _FIELD.fullmatch(line)
        if match is None:
            raise SchemaError(schema, f"not a field of {owner}: {line!r}")
        if not match["rest"].startswith("="):
            yield match


def _qualified(owner: str, name: str) -> str:
    """A type name as ``owner`` means it: of another package, of its own, or the one short name ``Header``."""
    if "/" in name:
        return short_name(name)
    return "std_msgs/Header" if name == "Header" else f"{owner.split('/', maxsplit=1)[0]}/{name}"


def _split(root: str, schema_text: str) -> dict[str, str]:
    first, *others = _SEPARATOR.split(schema_text.replace("\r\n", "\n"))
    texts = {root: _TITLE.sub("", first, count=1) if _TITLE.match(first) else first}
    for other in others:
        title = _TITLE.match(other)
        if title is not None:
            texts.setdefault(short_name(title[1]), other[title.end() :])
    return {**_ALWAYS_THERE, **texts}
