"""Message definitions; bytes to columns, columns to bytes."""

from fuselog.schemas.catalogue import definition, known_definitions
from fuselog.schemas.codec import Codec, MessageType, compile_codec, field_paths, layout, stamp_path
from fuselog.schemas.encode import CdrEncoder
from fuselog.schemas.errors import ConfigError, FuselogError, LogError, SchemaError
from fuselog.schemas.layout import ColumnKind, Layout
from fuselog.schemas.messages import Columns, Fault, Messages, Ragged, pack
from fuselog.schemas.plain import PlainEncoder
from fuselog.schemas.rihs import rihs01

__all__ = [
    "CdrEncoder",
    "Codec",
    "ColumnKind",
    "Columns",
    "ConfigError",
    "Fault",
    "FuselogError",
    "Layout",
    "LogError",
    "MessageType",
    "Messages",
    "PlainEncoder",
    "Ragged",
    "SchemaError",
    "compile_codec",
    "definition",
    "field_paths",
    "known_definitions",
    "layout",
    "pack",
    "rihs01",
    "stamp_path",
]
