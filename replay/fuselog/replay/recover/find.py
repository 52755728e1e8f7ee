"""Where records go on in a file whose record lengths cannot be trusted."""

import numpy as np
from numpy.typing import NDArray

from fuselog.replay.mcap_file.records import (
    CHUNK,
    DATA_END,
    DATA_END_SIZE,
    FOOTER,
    FOOTER_SIZE,
    FRAME,
    Integer,
    read_u64,
)
from fuselog.schemas.compiled import inline, kernel

# Bytes that the content of a record has at least, by opcode.
_LEAST = np.array([0, 8, 20, 14, 16, 22, 40, 6, 64, 36, 48, 46, 8, 20, 17, 4], np.int64)
_CHUNK_HEAD = 40  # bytes of a chunk's content beside its compression and its payload
_COMPRESSION = 28  # where the length of the compression's name lies in a chunk's content
_LONGEST_COMPRESSION = 4  # bytes: "zstd"
_ENOUGH = 3  # records in a row that are taken for records


@inline
def next_record(data: NDArray[np.uint8], at: Integer, end: Integer) -> Integer:
    """Where the record at ``at`` ends, or -1 if it does not look like one that MCAP knows."""
    if at + FRAME > end:
        return np.int64(-1)
    opcode, length = np.int64(data[at]), read_u64(data, at + 1)
    if opcode < 1 or opcode > 15 or length < _LEAST[opcode] or length > end - at - FRAME:
        return np.int64(-1)
    if (opcode == FOOTER and length != FOOTER_SIZE) or (opcode == DATA_END and length != DATA_END_SIZE):
        return np.int64(-1)
    return np.int64(at + FRAME + length)


@inline
def payload_size(data: NDArray[np.uint8], at: Integer, end: Integer) -> Integer:
    """Bytes of the payload of the chunk at ``at``, as the chunk's own header says; -1 if it has none."""
    if at + FRAME + _CHUNK_HEAD > end:
        return np.int64(-1)
    head = at + FRAME + _COMPRESSION
    name = np.int64(data[head]) | np.int64(data[head + 1]) << 8 | np.int64(data[head + 2]) << 16
    name |= np.int64(data[head + 3]) << 24
    if name > _LONGEST_COMPRESSION or head + 4 + name + 8 > end:
        return np.int64(-1)
    return read_u64(data, head + 4 + name)


@inline
def name_size(data: NDArray[np.uint8], at: Integer) -> Integer:
    """Bytes of the name of the compression of the chunk at ``at``, for which `payload_size` is not -1."""
    return np.int64(data[at + FRAME + _COMPRESSION])


@inline
def agrees(data: NDArray[np.uint8], at: Integer, end: Integer) -> bool:
    """Whether the record at ``at``, of any opcode, has the length that a chunk of its payload would have."""
    size = payload_size(data, at, end)
    return bool(size >= 0 and read_u64(data, at + 1) == _CHUNK_HEAD + name_size(data, at) + size)


@inline
def in_a_row(data: NDArray[np.uint8], at: Integer, end: Integer) -> bool:
    """Whether records begin at ``at``: some in a row, a chunk, or what ends a log."""
    for _ in range(_ENOUGH):
        following = next_record(data, at, end)
        if following < 0:
            return False
        if data[at] == CHUNK:
            return agrees(data, at, end)
        if following == end or data[at] == FOOTER:
            return True
        at = following
    return True


@kernel
def find_records(data: NDArray[np.uint8], begin: int, end: int) -> int:
    """The first place from ``begin`` on where records go on, ``end`` if there is none."""
    for at in range(begin, end - FRAME):
        if in_a_row(data, at, end):
            return at
    return end


@kernel
def begins_at(data: NDArray[np.uint8], at: int, end: int) -> bool:
    """Whether a record may begin at ``at``, or the file ends there; a chunk with a damaged length may, too."""
    if at == end or next_record(data, at, end) >= 0:
        return True
    return bool(at < end and data[at] == CHUNK and 0 <= payload_size(data, at, end) < end - at)


@kernel
def chunk_end(data: NDArray[np.uint8], at: int, end: int) -> tuple[int, bool]:
    """Where a chunk at ``at`` ends by its own header, -1 if it has none; whether its length says the same."""
    size = payload_size(data, at, end)
    if size < 0 or size > 2**62:
        return -1, False
    return int(at + FRAME + _CHUNK_HEAD + name_size(data, at) + size), agrees(data, at, end)
