"""Attachment records of MCAP: what they are called, and their content."""

import struct
import zlib
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fuselog.replay.mcap_file import records

_TIMES = struct.Struct("<QQ")
_LENGTH = struct.Struct("<I")
_SIZE = struct.Struct("<Q")


class Head(NamedTuple):
    """What an Attachment record says before its content, which is ``record[begin : begin + size]``."""

    log_time: int
    create_time: int
    name: str
    media_type: str
    size: int
    begin: int


def read_head(record: NDArray[np.uint8]) -> Head:
    """The head of a record, given from its opcode on and perhaps cut behind the head; ValueError if it is broken."""
    try:
        if record[0] != records.ATTACHMENT:
            raise ValueError("no attachment where the index says")
        log_time, create_time = _TIMES.unpack_from(record.data, records.FRAME)
        name, at = _text(record, records.FRAME + _TIMES.size)
        media_type, at = _text(record, at)
        (size,) = _SIZE.unpack_from(record.data, at)
    except (struct.error, IndexError, UnicodeDecodeError) as error:
        raise ValueError("broken attachment") from error
    return Head(log_time, create_time, name, media_type, size, at + _SIZE.size)


def read_content(record: NDArray[np.uint8], *, check_crc: bool) -> bytes:
    """The content of a whole record; ValueError if it is cut, or its checksum is wrong."""
    head = read_head(record)
    end = head.begin + head.size
    if end + _LENGTH.size > len(record):
        raise ValueError("the attachment is longer than its record")
    (crc,) = _LENGTH.unpack_from(record.data, end)
    if check_crc and crc and zlib.crc32(record[records.FRAME : end].data) != crc:
        raise ValueError("attachment crc does not match")
    return record[head.begin : end].tobytes()


def _text(record: NDArray[np.uint8], at: int) -> tuple[str, int]:
    """(the text at ``at``, where it ends)."""
    (length,) = _LENGTH.unpack_from(record.data, at)
    begin = at + _LENGTH.size
    return record[begin : begin + length].tobytes().decode(), begin + length
