"""The chunk table: where each chunk lies, its time range and channels, from the index or from a scan."""

import struct
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from fuselog.replay.mcap_file import records

SPAN = 4 << 20  # bytes of neighbouring unchunked messages that are read together
_ROWS = 1 << 14
_INDEX_ENTRY = np.dtype([("channel", "<u2"), ("offset", "<u8")])


@dataclass(frozen=True, slots=True)
class Chunk:
    """One block of messages: a Chunk record, or neighbouring messages outside chunks (``bare``)."""

    offset: int  # of its first record in the file
    end: int
    start_ns: int  # earliest and latest log time, as the file says
    finish_ns: int
    channels: NDArray[np.uint16] | None  # that its message index names; None without an index
    index_end: int  # its message index lies in [end, index_end)
    bare: bool = False


@dataclass(frozen=True, slots=True)
class ChunkHeader:
    """What a Chunk record says of its payload, which is ``file[begin:end]``."""

    start_ns: int
    finish_ns: int
    size: int  # bytes, uncompressed
    crc: int  # of the uncompressed bytes, 0 = not given
    compression: str
    begin: int
    end: int


def read_header(data: NDArray[np.uint8], offset: int, end: int) -> ChunkHeader:
    """The header of the Chunk record that takes up ``data[offset:end]``; ValueError if there is none."""
    try:
        opcode, length = struct.unpack_from("<BQ", data.data, offset)
    except struct.error as error:
        raise ValueError("broken chunk header") from error
    if opcode != records.CHUNK or offset + records.FRAME + length != end:
        raise ValueError("no chunk where the index says")
    header = parse_header(data, offset, end)
    if header.end > end:
        raise ValueError("chunk payload longer than its record")
    return header


def parse_header(data: NDArray[np.uint8], offset: int, end: int) -> ChunkHeader:
    """The chunk header in ``data[offset:end]``, whatever opcode and length are before it; ValueError if it is cut.

    Its payload may reach beyond ``end``.
    """
    at = offset + records.FRAME + 32
    try:
        start, finish, size, crc, name = struct.unpack_from("<QQQII", data.data, offset + records.FRAME)
        compression = data[at : min(at + name, end)].tobytes().decode()
        (packed,) = struct.unpack_from("<Q", data.data, at + name)
    except (struct.error, UnicodeDecodeError) as error:
        raise ValueError("broken chunk header") from error
    begin = at + name + 8
    return ChunkHeader(clamp(start), clamp(finish), size, crc, compression, begin, begin + packed)


def clamp(time: int) -> int:
    """A u64 time of the file as int64 ns."""
    return min(time, records.MAX_TIME)


def from_index(size: int, contents: list[bytes]) -> list[Chunk]:
    """The chunks of a file of ``size`` bytes by its ChunkIndex records; ValueError if they cannot be there."""
    chunks: list[Chunk] = []
    for content in contents:
        try:
            start, finish, offset, length, entries = struct.unpack_from("<QQQQI", content)
            (index_bytes,) = struct.unpack_from("<Q", content, 36 + entries)
        except struct.error as error:
            raise ValueError("broken chunk index") from error
        end = offset + length
        if entries % _INDEX_ENTRY.itemsize or end + index_bytes > size:
            raise ValueError("chunk index points outside of the file")
        named = np.frombuffer(content[36 : 36 + entries], _INDEX_ENTRY)["channel"]
        chunks.append(Chunk(offset, end, clamp(start), clamp(finish), named if entries else None, end + index_bytes))
    chunks.sort(key=lambda chunk: chunk.offset)
    if any(a.end > b.offset for a, b in pairwise(chunks)):
        raise ValueError("chunk index names overlapping chunks")
    return chunks


def scan_rows(data: NDArray[np.uint8], begin: int, end: int) -> tuple[NDArray[np.int64], int]:
    """Every top-level record from ``begin`` -> (rows of `records.scan`, where the last whole record ends)."""
    parts: list[NDArray[np.int64]] = []
    done = False
    while not done:
        rows = np.empty((_ROWS, 5), np.int64)
        n, begin, done = records.scan(data, begin, end, SPAN, rows)
        parts.append(rows[:n].copy())
    return np.concatenate(parts), begin


def from_rows(data: NDArray[np.uint8], rows: NDArray[np.int64]) -> tuple[list[Chunk], list[tuple[int, str]]]:
    """The chunks among scanned rows, in file order, and (offset, reason) of those with a broken header."""
    chunks: list[Chunk] = []
    broken: list[tuple[int, str]] = []
    index_of = _indexes_after_chunks(data, rows)
    for row, (_, index_end) in index_of.items():
        if row < 0 or rows[row, 0] != records.CHUNK:
            broken.append((index_end, "a message index without its chunk"))
    for i in np.flatnonzero((rows[:, 0] == records.CHUNK) | (rows[:, 0] == records.MESSAGE)).tolist():
        opcode, start, length, first, last = rows[i].tolist()
        if opcode == records.MESSAGE:
            chunks.append(Chunk(start, start + length, first, last, None, start + length, bare=True))
            continue
        offset, end = start - records.FRAME, start + length
        try:
            header = read_header(data, offset, end)
        except ValueError as error:
            broken.append((offset, str(error)))
            continue
        channels, index_end = index_of.get(i, (None, end))
        chunks.append(Chunk(offset, end, header.start_ns, header.finish_ns, channels, index_end))
    return chunks, broken


def _indexes_after_chunks(
    data: NDArray[np.uint8], rows: NDArray[np.int64]
) -> dict[int, tuple[NDArray[np.uint16], int]]:
    """Row of a chunk -> channels of the MessageIndex records right behind it, and where those end."""
    is_index = (rows[:, 0] == records.MESSAGE_INDEX) & (rows[:, 2] >= 6)
    edges = np.flatnonzero(np.diff(np.concatenate(([False], is_index, [False])).astype(np.int8)))
    found: dict[int, tuple[NDArray[np.uint16], int]] = {}
    for begin, end in edges.reshape(-1, 2).tolist():
        at = rows[begin:end, 1]
        channels = (data[at] + data[at + 1].astype(np.int64) * 256).astype(np.uint16)
        found[begin - 1] = channels, int(rows[end - 1, 1] + rows[end - 1, 2])
    return found


def count_indexed(index: NDArray[np.uint8]) -> dict[int, int] | None:
    """Messages by channel as the message index behind a chunk counts them; None without a usable one."""
    counts: dict[int, int] = {}
    rows, _ = scan_rows(index, 0, len(index))
    for opcode, at, length, _, _ in rows.tolist():
        if opcode == records.MESSAGE_INDEX and length >= 6:
            channel, pairs = struct.unpack_from("<HI", index.data, at)
            counts[channel] = counts.get(channel, 0) + min(pairs, length - 6) // 16
    return counts or None
