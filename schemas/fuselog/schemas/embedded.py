"""Schemas as logs embed them, which are bytes, and as announcements and descriptions hold them, which is text."""

import base64
from typing import Final

from fuselog.schemas.errors import SchemaError

_BINARY: Final = ("protobuf", "flatbuffer")  # schema encodings whose data are no text: text holds them as base64


def schema_to_text(schema_encoding: str, data: bytes) -> str:
    """The data of a schema as text."""
    if schema_encoding in _BINARY:
        return base64.b64encode(data).decode()
    return data.decode(errors="replace")


def schema_to_bytes(schema_name: str, schema_encoding: str, text: str) -> bytes:
    """The data of a schema; raises SchemaError for a text that is not base64 where it must be."""
    if schema_encoding not in _BINARY:
        return text.encode()
    try:
        return base64.b64decode(text, validate=True)
    except ValueError as error:
        raise SchemaError(schema_name, f"the schema of {schema_encoding} is not base64: {error}") from error
