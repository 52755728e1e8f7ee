"""Message definitions; bytes to columns, columns to bytes."""

from fuselog.schemas.catalogue import definition, known_definitions
from fuselog.schemas.codec import Codec, compile_codec, field_paths, stamp_path
from fuselog.schemas.encode import CdrEncoder
from fuselog.schemas.errors import ConfigError, FuselogError, LogError, SchemaError
from fuselog.schemas.messages import Columns, Fault, Messages

__all__ = [
    "CdrEncoder",
    "Codec",
    "Columns",
    "ConfigError",
    "Fault",
    "FuselogError",
    "LogError",
    "Messages",
    "SchemaError",
    "compile_codec",
    "definition",
    "field_paths",
    "known_definitions",
    "stamp_path",
]
