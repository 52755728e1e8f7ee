"""What a log holds, found before any message is read: from its summary when that is whole, else by a scan."""

import struct
import zlib
from collections.abc import Callable
from dataclasses import dataclass, field

import mcap.records
import numpy as np
from numpy.typing import NDArray

from fuselog.replay import records
from fuselog.replay.channels import Definitions, parse
from fuselog.replay.chunks import Chunk, from_index, from_rows, scan_rows
from fuselog.replay.loss import Losses

MAGIC = b"\x89MCAP0\r\n"
_FOOTER = struct.Struct("<BQQQI")  # opcode, length 20, summary start, summary offset start, crc
_LARGEST = 64 << 20  # bytes of a record that says something of the log; more are not looked at
_NO_ROWS = np.empty((0, 5), np.int64)

Block = tuple[NDArray[np.uint8], int, int]  # records lie in data[begin:end]
OpenChunk = Callable[[Chunk], Block | None]


@dataclass(slots=True)
class Contents:
    """The chunk table of a log with all that is known of its channels, in file order."""

    chunks: list[Chunk] = field(default_factory=list[Chunk])
    definitions: Definitions = field(default_factory=Definitions)
    statistics: mcap.records.Statistics | None = None
    metadata: list[tuple[int, int]] = field(default_factory=list[tuple[int, int]])  # content start, length
    profile: str = ""

    def message_counts(self) -> dict[int, int] | None:
        """Messages by channel as the statistics say, or None when they do not."""
        if self.statistics is None:
            return None
        by_channel = self.statistics.channel_message_counts
        return by_channel if by_channel or self.statistics.message_count == 0 else None


def survey(data: NDArray[np.uint8], open_chunk: OpenChunk, losses: Losses) -> Contents:
    """The contents of the file ``data``; every damage met on the way is noted in ``losses``."""
    contents = Contents(profile=_read_profile(data, losses))
    footer = _read_footer(data)
    summary = _read_summary(data, footer, losses) if footer else _NO_ROWS
    contents.statistics = _read_statistics(data, summary, losses)
    _define(data, summary, contents.definitions, losses)
    if not _use_index(data, summary, contents, losses):
        _use_scan(data, contents, open_chunk, losses, sealed=footer is not None)
    for channel, schema in contents.definitions.missing_schemas():
        losses.add(0, f"channel {channel}: its schema {schema} is declared nowhere", 0)
    return contents


def learn(block: Block, definitions: Definitions) -> None:
    """Take in the Schema and Channel records among the records of a block; ValueError if one is broken."""
    data, begin, end = block
    _, n, _, whole = records.measure(data, begin, end)
    found = np.empty((n, 3), np.int64)
    records.find_definitions(data, begin, whole, found)
    for opcode, at, length in found.tolist():
        definitions.add(opcode, data[at : at + length].tobytes())


def _read_profile(data: NDArray[np.uint8], losses: Losses) -> str:
    rows, _ = scan_rows(data, len(MAGIC), min(len(data), len(MAGIC) + records.FRAME + (1 << 20)))
    try:
        if not len(rows) or rows[0, 0] != records.HEADER:
            raise ValueError("no header")
        return parse(mcap.records.Header.read, _content(data, rows[0])).profile
    except ValueError as error:
        losses.add(len(MAGIC), str(error), 0)
        return ""


def _read_footer(data: NDArray[np.uint8]) -> tuple[int, int] | None:
    """(summary start, summary crc), or None when the file does not end as a log does."""
    at = len(data) - len(MAGIC) - _FOOTER.size
    if at < len(MAGIC) or data[-len(MAGIC) :].tobytes() != MAGIC:
        return None
    opcode, length, start, _, crc = _FOOTER.unpack_from(data.data, at)
    return (start, crc) if (opcode, length) == (records.FOOTER, records.FOOTER_SIZE) else None


def _read_summary(data: NDArray[np.uint8], footer: tuple[int, int], losses: Losses) -> NDArray[np.int64]:
    """The records of the summary section; none when there is no summary or it is damaged."""
    start, crc = footer
    end = len(data) - len(MAGIC)
    if start == 0:
        return _NO_ROWS
    if not len(MAGIC) <= start < end:
        losses.add(end - 20, "the summary lies outside of the file", 0)
        return _NO_ROWS
    if crc and zlib.crc32(data[start : end - 4].data) != crc:
        losses.add(start, "summary crc does not match", 0)
        return _NO_ROWS
    rows, reached = scan_rows(data, start, end)
    if reached != end:
        losses.add(reached, "broken record in the summary", 0)
        return _NO_ROWS
    return rows


def _read_statistics(
    data: NDArray[np.uint8], summary: NDArray[np.int64], losses: Losses
) -> mcap.records.Statistics | None:
    for row in summary[summary[:, 0] == records.STATISTICS]:
        try:
            return parse(mcap.records.Statistics.read, _content(data, row))
        except ValueError as error:
            losses.add(int(row[1]), f"statistics: {error}", 0)
    return None


def _define(data: NDArray[np.uint8], rows: NDArray[np.int64], definitions: Definitions, losses: Losses) -> None:
    for row in rows[(rows[:, 0] == records.SCHEMA) | (rows[:, 0] == records.CHANNEL)]:
        try:
            definitions.add(int(row[0]), _content(data, row))
        except ValueError as error:
            losses.add(int(row[1]), str(error))


def _use_index(data: NDArray[np.uint8], summary: NDArray[np.int64], contents: Contents, losses: Losses) -> bool:
    """Take chunks and metadata from the summary, if it names all of them and declares all their channels."""
    try:
        chunks = from_index(data, _extents(summary, records.CHUNK_INDEX))
        metadata = [_indexed_metadata(data, row) for row in summary[summary[:, 0] == records.METADATA_INDEX]]
    except ValueError as error:
        losses.add(0, f"summary not used: {error}", 0)
        return False
    statistics, definitions = contents.statistics, contents.definitions
    told = statistics is not None
    whole = (
        len(chunks) > 0
        and not definitions.missing_schemas()
        and all(chunk.channels is not None or told for chunk in chunks)
        and definitions.cover({id for c in chunks if c.channels is not None for id in c.channels.tolist()})
        and (statistics is None or statistics.chunk_count == len(chunks))
        and (statistics is None or statistics.metadata_count == len(metadata))
        and (statistics is None or statistics.channel_count == len(definitions))
    )
    if whole:
        contents.chunks, contents.metadata = chunks, metadata
    return whole


def _use_scan(
    data: NDArray[np.uint8], contents: Contents, open_chunk: OpenChunk, losses: Losses, *, sealed: bool
) -> None:
    """Take everything from a walk over the data section, opening only chunks with undeclared channels."""
    rows, reached = scan_rows(data, len(MAGIC), len(data))
    is_end = (rows[:, 0] == records.DATA_END) & (rows[:, 2] == records.DATA_END_SIZE)
    if not (is_end | ((rows[:, 0] == records.FOOTER) & (rows[:, 2] == records.FOOTER_SIZE))).any():
        losses.add(reached, f"broken record at byte {reached}" if sealed else f"truncated at byte {reached}")
    elif not sealed:
        losses.add(len(data), f"truncated at byte {len(data)}: all data, but no whole summary", 0)
    contents.chunks, broken = from_rows(data, rows)
    for offset, reason in broken:
        losses.add(offset, reason)
    contents.metadata = _extents(rows, records.METADATA)
    definitions = contents.definitions
    _define(data, rows, definitions, losses)
    for chunk in contents.chunks:
        if chunk.bare or _declared(chunk, contents):
            continue
        block = open_chunk(chunk)
        if block is None:
            continue
        try:
            learn(block, definitions)
        except ValueError as error:
            losses.add(chunk.offset, str(error))


def _declared(chunk: Chunk, contents: Contents) -> bool:
    if chunk.channels is not None:
        return contents.definitions.cover(chunk.channels.tolist())
    total = contents.statistics.channel_count if contents.statistics else None
    return len(contents.definitions) == total and not contents.definitions.missing_schemas()


def _indexed_metadata(data: NDArray[np.uint8], row: NDArray[np.int64]) -> tuple[int, int]:
    index = parse(mcap.records.MetadataIndex.read, _content(data, row))
    if index.offset + index.length > len(data) or data[index.offset] != records.METADATA:
        raise ValueError("metadata index points to no metadata")
    return index.offset + records.FRAME, index.length - records.FRAME


def _extents(rows: NDArray[np.int64], opcode: int) -> list[tuple[int, int]]:
    return [(at, length) for at, length in rows[rows[:, 0] == opcode, 1:3].tolist()]


def _content(data: NDArray[np.uint8], row: NDArray[np.int64]) -> bytes:
    if row[2] > _LARGEST:
        raise ValueError(f"record of {row[2]} bytes, above the limit of {_LARGEST}")
    return data[int(row[1]) : int(row[1] + row[2])].tobytes()
