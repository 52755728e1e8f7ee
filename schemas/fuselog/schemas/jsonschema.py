"""JSON Schema as embedded in logs, into the same tree as ROS 2 definitions and out of it."""

from typing import Any, Final, cast

import orjson

from fuselog.schemas.errors import SchemaError
from fuselog.schemas.tree import KINDS, Array, Node, Number, Open, Record, Text

_NUMBERS: Final = {"number": "float64", "integer": "int64", "boolean": "bool"}
_DEEPEST: Final = 64  # anything goes further down


def parse_jsonschema(schema_name: str, schema_text: str) -> Record | Open:
    """The tree of a JSON Schema; ``Open`` where it does not say, or when there is no schema at all.

    Raises SchemaError when the text is not a JSON object.
    """
    if not schema_text.strip():
        return Open()
    try:
        document = orjson.loads(schema_text)
    except orjson.JSONDecodeError as error:
        raise SchemaError(schema_name, f"not a JSON Schema: {error}") from error
    if not isinstance(document, dict):
        raise SchemaError(schema_name, "not a JSON Schema: not an object")
    whole = cast(dict[str, Any], document)
    node = _Document(whole).node(whole, schema_name, 0)
    return node if isinstance(node, Record) else Open()


def write_jsonschema(schema_name: str, root: Record) -> bytes:
    """The JSON Schema of messages of this shape; floats may be null, which stands for what JSON cannot write."""
    return orjson.dumps({"title": schema_name, **_written(root)})


_TYPES: Final[dict[int, object]] = {0: "integer", 1: "integer", 2: ["number", "null"], 3: "boolean"}


def _written(node: Node) -> dict[str, Any]:
    match node:
        case Number(kind):
            return {"type": _TYPES[KINDS[kind] % 4]}
        case Text():
            return {"type": "string"}
        case Array(element, length):
            limits = {} if length is None else {"minItems": length, "maxItems": length}
            return {"type": "array", "items": _written(element), **limits}
        case Record(_, fields):
            return {"type": "object", "properties": {name: _written(child) for name, child in fields.items()}}
        case Open():
            return {}


class _Document:
    """One schema document, and the nodes of the references in it, each made once."""

    def __init__(self, document: dict[str, Any]) -> None:
        self._document = document
        self._referred: dict[str, Node] = {}

    def node(self, schema: object, name: str, depth: int) -> Node:
        if not isinstance(schema, dict) or depth > _DEEPEST:
            return Open()
        schema = cast(dict[str, Any], schema)
        if "$ref" in schema:
            return self._reference(str(schema["$ref"]), depth)
        kind = _kind(schema)
        if kind in _NUMBERS:
            return Number(_NUMBERS[kind])
        if kind == "string":
            return Text()
        if kind == "array":
            return Array(self.node(schema.get("items"), f"{name}[]", depth + 1), _fixed_length(schema))
        properties = schema.get("properties")
        if isinstance(properties, dict) and properties:
            children = cast(dict[str, object], properties).items()
            return Record(name, {key: self.node(child, key, depth + 1) for key, child in children})
        return Open()

    def _reference(self, reference: str, depth: int) -> Node:
        """What ``#/definitions/Name`` refers to; ``Open`` when it is not here, or refers back to itself."""
        if reference not in self._referred:
            self._referred[reference] = Open()
            target: object = self._document
            for key in reference.removeprefix("#/").split("/"):
                target = cast(dict[str, object], target).get(key) if isinstance(target, dict) else None
            self._referred[reference] = self.node(target, reference.rsplit("/", maxsplit=1)[-1], depth + 1)
        return self._referred[reference]


def _kind(schema: dict[str, Any]) -> str:
    """The type, or the first that is not null of several."""
    kinds = schema.get("type")
    kinds = cast(list[object], kinds) if isinstance(kinds, list) else [kinds]
    return next((kind for kind in kinds if isinstance(kind, str) and kind != "null"), "")


def _fixed_length(schema: dict[str, Any]) -> int | None:
    least, most = schema.get("minItems"), schema.get("maxItems")
    return most if isinstance(most, int) and least == most else None
