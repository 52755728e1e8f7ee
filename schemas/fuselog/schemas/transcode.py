"""CDR messages into other encodings, one at a time, each with the schema that tells what it is then."""

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from typing import Final, Literal, TypeAlias

import orjson

from fuselog.schemas.jsonschema import write_jsonschema
from fuselog.schemas.ros2msg import parse_ros2msg
from fuselog.schemas.values import CdrReader

Encoding: TypeAlias = Literal["cdr", "json", "protobuf"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Transcoder:
    """What CDR messages of one ROS 2 type become.

    ``encoding``, ``schema_name``, ``schema_encoding`` and ``schema`` are what MCAP calls them for the result.
    ``convert`` raises SchemaError for a payload that is not a whole message; ``cdr`` is not looked at.
    """

    encoding: Encoding
    schema_name: str
    schema_encoding: str
    schema: bytes
    convert: Callable[[bytes | memoryview], bytes]


def make_transcoder(encoding: Encoding, schema_name: str, schema_text: str) -> Transcoder:
    """From CDR with a definition as ``parse_ros2msg`` takes it.

    JSON has the names and the structure of the fields, every digit of a number, and null for NaN and infinities.
    Protobuf is proto3: ``nav_msgs.Odometry``, fields numbered from 1 in their order, arrays repeated. Raises
    SchemaError for a definition that cannot be read; ModuleNotFoundError where ``missing_extra`` names one.
    """
    return _MAKERS[encoding](schema_name, schema_text)


def missing_extra(encoding: Encoding) -> str:
    """The extra of fuselog that an encoding needs and that is not installed; empty when nothing is missing."""
    try:
        if encoding == "protobuf":
            import_module("google.protobuf")
    except ModuleNotFoundError:
        return "protobuf"
    return ""


def _cdr(schema_name: str, schema_text: str) -> Transcoder:
    return Transcoder(
        encoding="cdr",
        schema_name=schema_name,
        schema_encoding="ros2msg",
        schema=schema_text.encode(),
        convert=bytes,
    )


def _json(schema_name: str, schema_text: str) -> Transcoder:
    root = parse_ros2msg(schema_name, schema_text)
    read = CdrReader(root).read
    return Transcoder(
        encoding="json",
        schema_name=schema_name,
        schema_encoding="jsonschema",
        schema=write_jsonschema(schema_name, root),
        convert=lambda payload: orjson.dumps(read(payload)),
    )


def _protobuf(schema_name: str, schema_text: str) -> Transcoder:
    from fuselog.schemas.protobuf import ProtobufWriter  # noqa: PLC0415  an extra

    root = parse_ros2msg(schema_name, schema_text)
    read, writer = CdrReader(root).read, ProtobufWriter(root)
    return Transcoder(
        encoding="protobuf",
        schema_name=writer.name,
        schema_encoding="protobuf",
        schema=writer.schema,
        convert=lambda payload: writer.write(read(payload)),
    )


_MAKERS: Final[dict[Encoding, Callable[[str, str], Transcoder]]] = {"cdr": _cdr, "json": _json, "protobuf": _protobuf}
