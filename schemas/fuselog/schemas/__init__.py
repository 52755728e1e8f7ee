"""Message definitions; bytes to columns, columns to bytes."""

from fuselog.schemas.catalogue import definition, known_definitions
from fuselog.schemas.codec import Codec, MessageType, compile_codec, field_paths, layout, stamp_path
from fuselog.schemas.embedded import schema_to_bytes, schema_to_text
from fuselog.schemas.encode import CdrEncoder
from fuselog.schemas.errors import ConfigError, FuselogError, LogError, SchemaError
from fuselog.schemas.layout import ColumnKind, Layout
from fuselog.schemas.messages import Columns, Fault, Messages, Ragged, pack
from fuselog.schemas.plain import PlainEncoder
from fuselog.schemas.rihs import rihs01
from fuselog.schemas.transcode import Transcoder, make_transcoder, missing_extra

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
    "Transcoder",
    "compile_codec",
    "definition",
    "field_paths",
    "known_definitions",
    "layout",
    "make_transcoder",
    "missing_extra",
    "pack",
    "rihs01",
    "schema_to_bytes",
    "schema_to_text",
    "stamp_path",
]
