"""Pieces of an MCAP file on demand: chunks as plain records, and single records; within the limits."""

import numpy as np
from numpy.typing import NDArray

from fuselog.replay.log.loss import Losses
from fuselog.replay.mcap_file import records
from fuselog.replay.mcap_file.chunks import Chunk, count_indexed, read_header
from fuselog.replay.mcap_file.contents import Block
from fuselog.replay.mcap_file.decompress import Decompressor, Limits
from fuselog.replay.mcap_file.source import Source


class Opener:
    """A file, and its chunks as plain records; a chunk that cannot be opened is a loss."""

    def __init__(self, source: Source, limits: Limits, losses: Losses, *, check_crc: bool) -> None:
        self._source = source
        self._limits = limits
        self._losses = losses
        self._decompressor = Decompressor(limits, check_crc=check_crc)

    def open(self, chunk: Chunk) -> Block | None:
        """The records of the chunk, or None when it is bad."""
        return self.admit(chunk, self.unpack(chunk))

    def unpack(self, chunk: Chunk) -> Block | ValueError:
        """The records of the chunk, or what is wrong with it; for any thread, as it notes nothing."""
        packed = chunk.end - chunk.offset
        if not chunk.bare and packed > self._limits.record_bytes:
            return ValueError(f"chunk of {packed} bytes, above the limit of {self._limits.record_bytes}")
        record = self._source.read(chunk.offset, chunk.end)
        if chunk.bare:
            return record, 0, len(record)
        try:
            data = self._decompressor.open(record, read_header(record, 0, len(record)))
        except ValueError as error:
            return error
        return data, 0, len(data)

    def admit(self, chunk: Chunk, block: Block | ValueError) -> Block | None:
        """The block of `unpack`, or None after noting the loss."""
        if not isinstance(block, ValueError):
            return block
        counts = self.indexed(chunk)
        self._losses.add(chunk.offset, str(block), sum(counts.values()) if counts else None)
        return None

    def fetch(self, chunk: Chunk) -> None:
        """Told before the chunk is opened."""
        if chunk.end - chunk.offset <= self._limits.record_bytes:
            self._source.fetch(chunk.offset, chunk.end)

    def indexed(self, chunk: Chunk) -> dict[int, int] | None:
        """Messages by channel that the message index of the chunk counts."""
        return count_indexed(self._source.read(chunk.end, chunk.index_end)) if chunk.index_end > chunk.end else None

    def record(self, offset: int, length: int) -> NDArray[np.uint8]:
        """One record of the file with its opcode and length; ValueError if it is cut, or above the limit."""
        if length > self._limits.record_bytes:
            raise ValueError(f"record of {length} bytes, above the limit of {self._limits.record_bytes}")
        record = self._source.read(offset, offset + length)
        if len(record) != length or length < records.FRAME:
            raise ValueError("the record lies outside of the file")
        return record
