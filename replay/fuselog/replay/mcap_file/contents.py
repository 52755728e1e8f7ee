"""What a log holds, found before any message is read: from its summary when that is whole, else by a scan."""

from collections.abc import Callable
from dataclasses import dataclass, field

import mcap.records
import numpy as np
from numpy.typing import NDArray

from fuselog.replay.log.channels import Definitions, parse
from fuselog.replay.log.loss import Losses
from fuselog.replay.mcap_file import records
from fuselog.replay.mcap_file.chunks import Chunk, from_index, from_rows, scan_rows
from fuselog.replay.mcap_file.source import Source
from fuselog.replay.mcap_file.summary import MAGIC, Record, Section, read_header, read_statistics, read_summary

Block = tuple[NDArray[np.uint8], int, int]  # records lie in data[begin:end]
OpenChunk = Callable[[Chunk], Block | None]
Place = tuple[int, int]  # where a record begins in the file, and its length


@dataclass(slots=True)
class Contents:
    """The chunk table of a log with all that is known of its channels, in file order."""

    header: mcap.records.Header
    chunks: list[Chunk] = field(default_factory=list[Chunk])
    definitions: Definitions = field(default_factory=Definitions)
    statistics: mcap.records.Statistics | None = None
    metadata: list[Place] | None = None  # None: only a scan can tell
    attachments: list[Place] | None = None  # likewise

    def message_counts(self) -> dict[int, int] | None:
        """Messages by channel as the statistics say, or None when they do not."""
        if self.statistics is None:
            return None
        by_channel = self.statistics.channel_message_counts
        return by_channel if by_channel or self.statistics.message_count == 0 else None


def survey(source: Source, open_chunk: OpenChunk, losses: Losses) -> Contents:
    """The contents of a file; every damage met on the way is noted in ``losses``."""
    contents = Contents(read_header(source, losses))
    summary = read_summary(source, losses)
    if summary is not None:
        contents.statistics = read_statistics(summary, losses)
        _define(summary, contents.definitions, losses)
    if summary is None or not _use_index(source, summary, contents, losses):
        _use_scan(source, contents, open_chunk, losses, sealed=summary is not None)
    for channel, schema in contents.definitions.missing_schemas():
        losses.add(0, f"channel {channel}: its schema {schema} is declared nowhere", 0)
    return contents


def find_places(source: Source, opcode: int) -> list[Place]:
    """Where records with this opcode lie, found by a scan."""
    return _whole_file(source)[0].places(opcode)


def learn(block: Block, definitions: Definitions) -> None:
    """Take in the Schema and Channel records among the records of a block; ValueError if one is broken."""
    data, begin, end = block
    n, whole = records.measure(data, begin, end)
    found = np.empty((n, 3), np.int64)
    records.find_definitions(data, begin, whole, found)
    for opcode, at, length in found.tolist():
        definitions.add(opcode, data[at : at + length].tobytes())


def _define(section: Section, definitions: Definitions, losses: Losses) -> None:
    for record in section.records(records.SCHEMA, records.CHANNEL):
        try:
            definitions.add(record.opcode, record.content)
        except ValueError as error:
            losses.add(record.offset, str(error))


def _use_index(source: Source, summary: Section, contents: Contents, losses: Losses) -> bool:
    """Take the chunks from the summary, if it names all of them and declares all their channels."""
    try:
        chunks = from_index(source.size, [record.content for record in summary.records(records.CHUNK_INDEX)])
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
        and (statistics is None or statistics.channel_count == len(definitions))
    )
    if whole:
        contents.chunks = chunks
    if statistics is not None:
        metadata = summary.records(records.METADATA_INDEX)
        contents.metadata = _indexed(mcap.records.MetadataIndex.read, metadata, statistics.metadata_count)
        attachments = summary.records(records.ATTACHMENT_INDEX)
        contents.attachments = _indexed(mcap.records.AttachmentIndex.read, attachments, statistics.attachment_count)
    return whole


def _indexed(
    read: Callable[..., mcap.records.MetadataIndex | mcap.records.AttachmentIndex], index: list[Record], count: int
) -> list[Place] | None:
    """Where the records lie that an index names; None if it names not all of ``count``."""
    try:
        found = [parse(read, record.content) for record in index]
    except ValueError:
        return None
    return [(entry.offset, entry.length) for entry in found] if len(found) == count else None


def _use_scan(source: Source, contents: Contents, open_chunk: OpenChunk, losses: Losses, *, sealed: bool) -> None:
    """Take everything from a walk over the data section, opening only chunks with undeclared channels."""
    section, reached = _whole_file(source)
    rows = section.rows
    is_end = (rows[:, 0] == records.DATA_END) & (rows[:, 2] == records.DATA_END_SIZE)
    if not (is_end | ((rows[:, 0] == records.FOOTER) & (rows[:, 2] == records.FOOTER_SIZE))).any():
        losses.add(reached, f"broken record at byte {reached}" if sealed else f"truncated at byte {reached}")
    elif not sealed:
        losses.add(source.size, f"truncated at byte {source.size}: all data, but no whole summary", 0)
    contents.chunks, broken = from_rows(section.data, rows)
    for offset, reason in broken:
        losses.add(offset, reason)
    contents.metadata = section.places(records.METADATA)
    contents.attachments = section.places(records.ATTACHMENT)
    definitions = contents.definitions
    _define(section, definitions, losses)
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


def _whole_file(source: Source) -> tuple[Section, int]:
    """All records outside of chunks, and where the last whole one ends."""
    data = source.read_all()
    rows, reached = scan_rows(data, len(MAGIC), len(data))
    return Section(data, 0, rows), reached


def _declared(chunk: Chunk, contents: Contents) -> bool:
    if chunk.channels is not None:
        return contents.definitions.cover(chunk.channels.tolist())
    total = contents.statistics.channel_count if contents.statistics else None
    return len(contents.definitions) == total and not contents.definitions.missing_schemas()
