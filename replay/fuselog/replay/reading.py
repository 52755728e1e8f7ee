"""One reading of a log: chunk by chunk from bytes to messages, with a count of what came and what did not."""

from collections.abc import Callable, Set

import numpy as np
from numpy.typing import NDArray

from fuselog.replay import records
from fuselog.replay.chunks import Chunk, count_indexed, read_header
from fuselog.replay.contents import Block
from fuselog.replay.decompress import Decompressor, Limits
from fuselog.replay.loss import Losses
from fuselog.schemas.errors import LogError
from fuselog.schemas.messages import Messages

_CHANNELS = 1 << 16  # channel numbers are u16


class ChunkOpener:
    """The file of a log, and its chunks as plain records; a chunk that cannot be opened is a loss."""

    def __init__(self, path: str, data: NDArray[np.uint8], limits: Limits, losses: Losses, *, check_crc: bool) -> None:
        self._path = path
        self._mapped: NDArray[np.uint8] | None = data
        self._limits = limits
        self._losses = losses
        self._decompressor = Decompressor(limits, check_crc=check_crc)

    def close(self) -> None:
        """Drop the mapped file."""
        self._mapped = None

    @property
    def _data(self) -> NDArray[np.uint8]:
        if self._mapped is None:
            raise LogError(self._path, 0, "the log is closed")
        return self._mapped

    def open(self, chunk: Chunk) -> Block | None:
        """The records of the chunk, or None when it is bad."""
        return self.admit(chunk, self.unpack(chunk))

    def unpack(self, chunk: Chunk) -> Block | ValueError:
        """The records of the chunk, or what is wrong with it; for any thread, as it notes nothing."""
        if chunk.bare:
            return self._data, chunk.offset, chunk.end
        try:
            header = read_header(self._data, chunk.offset, chunk.end)
            data = self._decompressor.open(self._data, header)
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

    def indexed(self, chunk: Chunk) -> dict[int, int] | None:
        """Messages by channel that the message index of the chunk counts."""
        return count_indexed(self._data, chunk)

    def content(self, at: int, length: int) -> bytes:
        """The content of one record of the file; ValueError above the limit."""
        if length > self._limits.record_bytes:
            raise ValueError(f"record of {length} bytes, above the limit of {self._limits.record_bytes}")
        return self._data[at : at + length].tobytes()


class Reading:
    """Loads the messages of the ``chosen`` channels, and keeps the counts by channel."""

    def __init__(self, opener: ChunkOpener, losses: Losses, chosen: Set[int]) -> None:
        self._opener = opener
        self._losses = losses
        self._chosen = chosen
        self._wanted = np.zeros(_CHANNELS, np.uint8)
        self._wanted[list(chosen)] = 1
        self._counts = np.zeros(_CHANNELS, np.int64)  # met
        self._lost = np.zeros(_CHANNELS, np.int64)  # already accounted for as losses of chunks
        self._rows = np.empty((records.COLUMNS, 0), np.int64)  # of `fill`, for chunk after chunk

    def wants(self, chunk: Chunk) -> bool:
        """Whether the chunk may hold messages of the chosen channels."""
        return chunk.channels is None or bool(self._wanted[chunk.channels].any())

    def load(self, chunk: Chunk, unpack: Callable[[Chunk], Block | ValueError]) -> Messages | None:
        """The chosen messages of the chunk in time order, ties as they lie; None if there are none."""
        block = self._opener.admit(chunk, unpack(chunk))
        if block is None:
            self._count_lost(chunk, np.zeros(_CHANNELS, np.int64))
            return None
        data, begin, end = block
        messages, ordered, short, whole = self._fill(data, begin, end)
        if whole != end:
            lost = self._count_lost(chunk, records.count(data, begin, end, _CHANNELS))
            self._losses.add(chunk.offset, f"record at byte {whole} of the chunk points outside of it", lost)
        if short:
            self._losses.add(chunk.offset, "messages shorter than their own header", short)
        if not len(messages):
            return None
        if not ordered:
            messages = messages.take(np.argsort(messages.log_time, kind="stable"))
        if messages.log_time[0] < chunk.start_ns:
            self._losses.add(chunk.offset, "messages before the time range of their chunk: order not kept", 0)
        return messages

    def compare(self, promised: dict[int, int]) -> None:
        """Note each channel of which another number of messages came than the statistics promise."""
        for id in sorted(self._chosen | promised.keys()):
            came, lost, expected = int(self._counts[id]), int(self._lost[id]), promised.get(id, 0)
            if came + lost != expected:
                reason = f"channel {id}: {came} messages read, {expected} in the statistics"
                self._losses.add(0, reason, max(expected - came - lost, 0))

    def note_undeclared(self) -> None:
        """Note the messages that were met of channels not chosen; call it when all channels are."""
        for id in np.flatnonzero((self._counts > 0) & (self._wanted == 0)).tolist():
            self._losses.add(0, f"channel {id} is declared nowhere", int(self._counts[id]))

    def _fill(self, data: NDArray[np.uint8], begin: int, end: int) -> tuple[Messages, bool, int, int]:
        """(chosen messages as they lie, whether in time order, short messages, where the whole records end)."""
        most = (end - begin) // records.LEAST_MESSAGE
        if most > self._rows.shape[1]:
            self._rows = np.empty((records.COLUMNS, most), np.int64)
        n, ordered, short, whole = records.fill(data, begin, end, self._wanted, self._counts, self._rows)
        channel, sequence, log_time, publish_time, start, length = self._rows[:, :n].copy()
        messages = Messages(
            stream=channel.astype(np.int32),
            data=data,
            start=start,
            length=length,
            log_time=log_time,
            publish_time=publish_time,
            sequence=sequence,
        )
        return messages, ordered, short, whole

    def _count_lost(self, chunk: Chunk, came: NDArray[np.int64]) -> int | None:
        """Account for what the message index of a damaged chunk counts beyond what came of it."""
        counts = self._opener.indexed(chunk)
        if counts is None:
            return None
        total = 0
        for id, n in counts.items():
            missing = max(n - int(came[id]), 0)
            self._lost[id] += missing
            total += missing
        return total
