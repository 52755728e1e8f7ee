"""The hash of a ROS 2 message type (RIHS01, REP 2011): rmw_zenoh has it in its keys."""

import hashlib
import json
from typing import Any, Final

from fuselog.schemas.ros2msg import Field, fields_by_type

_KINDS: Final = {  # type_description_interfaces/msg/FieldType
    "int8": 2,
    "uint8": 3,
    "int16": 4,
    "uint16": 5,
    "int32": 6,
    "uint32": 7,
    "int64": 8,
    "uint64": 9,
    "float32": 10,
    "float64": 11,
    "char": 3,  # in a .msg an unsigned byte; no type that fuselog has uses it, so no published hash confirms it
    "bool": 15,
    "byte": 16,
    "string": 17,
    "wstring": 18,
}
_NESTED: Final = 1
_BOUNDED_TEXT: Final = 4  # more than the unbounded one
_FIXED, _BOUNDED, _UNBOUNDED = 48, 96, 144  # more than the element


def rihs01(schema_name: str, schema_text: str) -> str:
    """``RIHS01_`` and 64 hexadecimal digits of ``pkg/msg/Type``, from its definition with all that it needs.

    SHA-256 of the JSON that describes the fields; comments, defaults and constants do not count. Raises SchemaError.
    """
    root, *others = fields_by_type(schema_name, schema_text).items()
    described = {
        "type_description": _described(*root),
        "referenced_type_descriptions": [_described(*other) for other in sorted(others)],
    }
    return f"RIHS01_{hashlib.sha256(json.dumps(described).encode()).hexdigest()}"


def _described(name: str, fields: list[Field]) -> dict[str, Any]:
    """A type as type_description_interfaces/msg/IndividualTypeDescription has it, in the order of its fields."""
    return {"type_name": name, "fields": [{"name": field.name, "type": _type(field)} for field in fields]}


def _type(field: Field) -> dict[str, Any]:
    kind = _KINDS.get(field.type, _NESTED) + (_BOUNDED_TEXT if field.bound else 0)
    capacity = int(field.length or 0)
    if field.length is not None:
        kind += _UNBOUNDED if not field.length else _BOUNDED if field.upto else _FIXED
    return {
        "type_id": kind,
        "capacity": capacity,
        "string_capacity": int(field.bound or 0),
        "nested_type_name": "" if field.type in _KINDS else field.type,
    }
