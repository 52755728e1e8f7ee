"""All that can be read of a file that may be damaged, in file order, with what is wrong with the rest."""

import os
import struct
import zlib
from collections.abc import Iterator
from os import PathLike
from typing import TypeAlias

import mcap.records
import numpy as np
from numpy.typing import NDArray

from fuselog.replay import records
from fuselog.replay.channels import Channel, Definitions, parse
from fuselog.replay.chunks import scan_rows
from fuselog.replay.contents import MAGIC
from fuselog.replay.damage import Damage, Damages
from fuselog.replay.decompress import Limits
from fuselog.replay.mapped import map_file
from fuselog.replay.parts import BEHIND, Part, parts_of
from fuselog.replay.records import FRAME
from fuselog.replay.torn import TornChunks, count_indexed
from fuselog.schemas.errors import LogError
from fuselog.schemas.messages import Messages

Item: TypeAlias = Messages | mcap.records.Attachment | mcap.records.Metadata
Counts: TypeAlias = NDArray[np.int64]  # (65536,) by channel

_CHANNELS = 1 << 16  # channel numbers are u16
_FOOTER = struct.Struct("<BQQQI")  # opcode, length 20, summary start, summary offset start, crc


class Salvage:
    """One reading of a file, from its first byte to its last, that loses as little as possible.

    Unlike `Log` it needs no index, opens the whole blocks of chunks that are cut, and goes on behind broken
    records. What a checksum says is wrong counts as lost, unless ``trust_damaged``: then its whole records
    are taken. Raises LogError when there is no file, no record in it, or more channels than the limit.
    """

    def __init__(self, path: str | PathLike[str], *, limits: Limits | None = None, trust_damaged: bool = False) -> None:
        self.path = os.fspath(path)
        self.damages = Damages()
        self.definitions = Definitions()
        self.statistics: mcap.records.Statistics | None = None
        self.complete = False  # whether the end of the data was met
        self.counts: Counts = np.zeros(_CHANNELS, np.int64)  # messages read
        self.header = mcap.records.Header(profile="", library="")
        self._indexed_lost: Counts = np.zeros(_CHANNELS, np.int64)  # those that the index of a damaged chunk counts
        self._data = map_file(self.path)
        self._limits = limits or Limits()
        self._trust = trust_damaged
        self._chunks = TornChunks(self._data, self._limits, trust_damaged=trust_damaged)
        self._wanted = np.zeros(_CHANNELS, np.uint8)
        self._records = 0
        self._read_header()
        self._read_summary()

    @property
    def size(self) -> int:
        """Bytes of the file."""
        return len(self._data)

    def channels(self) -> dict[int, Channel]:
        """The channels known so far, by number."""
        return self.definitions.resolve(None)

    def items(self) -> Iterator[Item]:
        """Messages, a chunk at a time as they lie, and attachments and metadata; all in file order.

        When it has come to its end, `damages`, `counts` and `lost` are complete.
        """
        for part in parts_of(self._data):
            self._records += part.opcode != 0
            match part.opcode:
                case records.SCHEMA | records.CHANNEL:
                    lost = not self.complete
                    self._define(part.opcode, self._data, part.begin + FRAME, part.end, part, lost=lost)
                case records.MESSAGE:
                    yield from self._bare(part)
                case records.CHUNK:
                    yield from self._chunk(part)
                case records.ATTACHMENT:
                    yield from self._attachment(part)
                case records.METADATA:
                    yield from self._metadata(part)
                case records.DATA_END:
                    self._end_data(part)
                case 0:
                    lost = not self.complete and part.end > len(MAGIC)
                    self._damage(part, part.reason, lost=lost or part.reason == BEHIND)
                case _:
                    pass
        if not self._records:
            raise LogError(self.path, 0, "not an MCAP: there is no record in it")
        self._compare()

    def lost(self, channel: int) -> int:
        """How many messages of the channel are known to be lost, after all was read."""
        promised = self._promised()
        if promised is not None:
            return max(promised.get(channel, 0) - int(self.counts[channel]), 0)
        return int(self._indexed_lost[channel])

    def _read_header(self) -> None:
        if self._data[: len(MAGIC)].tobytes() != MAGIC:
            return
        rows, _ = scan_rows(self._data, len(MAGIC), min(self.size, len(MAGIC) + FRAME + (1 << 20)))
        if len(rows) and rows[0, 0] == records.HEADER:
            try:
                content = self._data[rows[0, 1] : rows[0, 1] + rows[0, 2]].tobytes()
                self.header = parse(mcap.records.Header.read, content)
            except ValueError as error:
                self.damages.add(Damage(len(MAGIC), int(rows[0, 1] + rows[0, 2]), f"header: {error}", lost=False))

    def _read_summary(self) -> None:
        """Take definitions and statistics from a whole summary first: it has a checksum of its own."""
        at, end = self.size - len(MAGIC) - _FOOTER.size, self.size - len(MAGIC)
        if at < len(MAGIC) or self._data[end:].tobytes() != MAGIC:
            return
        opcode, length, start, _, crc = _FOOTER.unpack_from(self._data.data, at)
        if (opcode, length) != (records.FOOTER, records.FOOTER_SIZE) or not len(MAGIC) <= start < at:
            return
        if crc and zlib.crc32(self._data[start : end - 4].data) != crc:
            self.damages.add(Damage(start, self.size, "summary crc does not match", lost=False))
            return
        for part in parts_of(self._data[:end], start):
            if part.opcode in (records.SCHEMA, records.CHANNEL):
                self._define(part.opcode, self._data, part.begin + FRAME, part.end, part, lost=False)
            elif part.opcode == records.STATISTICS:
                try:
                    self.statistics = parse(mcap.records.Statistics.read, self._content(part))
                except ValueError as error:
                    self._damage(part, f"statistics: {error}", lost=False)

    def _define(self, opcode: int, data: NDArray[np.uint8], begin: int, end: int, part: Part, *, lost: bool) -> None:
        """Learn the content ``data[begin:end]`` of a Schema or Channel record that lies in ``part``."""
        known = len(self.definitions)
        try:
            if end - begin > self._limits.record_bytes:
                raise ValueError(f"definition of {end - begin} bytes, above the limit of {self._limits.record_bytes}")
            self.definitions.add(opcode, data[begin:end].tobytes())
        except ValueError as error:
            self._damage(part, str(error), lost=lost)
        if len(self.definitions) > self._limits.channels:
            raise LogError(self.path, 0, f"more than {self._limits.channels} channels, which is the limit")
        if len(self.definitions) > known:
            self._wanted[list(self.definitions.numbers)] = 1

    def _bare(self, part: Part) -> Iterator[Messages]:
        if part.end - part.begin > self._limits.record_bytes:
            self._damage(part, f"messages of {part.end - part.begin} bytes, above the limit")
            return
        yield from self._take(self._data, part.begin, part.end, part)

    def _chunk(self, part: Part) -> Iterator[Messages]:
        indexed = count_indexed(self._data, part.end)
        before, known = self.counts.copy(), self.damages.count
        opened = self._chunks.open(part, sum(indexed.values()) if indexed else None)
        if opened.damage is not None:
            self.damages.add(opened.damage)
        yield from self._take(opened.records, 0, len(opened.records), part)
        if self.damages.count > known:
            for channel, n in indexed.items():
                self._indexed_lost[channel] += max(n - int(self.counts[channel] - before[channel]), 0)

    def _take(self, data: NDArray[np.uint8], begin: int, end: int, part: Part) -> Iterator[Messages]:
        """The messages of records, as they lie; what they define is learned first."""
        n, definitions, short, whole = records.measure(data, begin, end)
        if whole != end:
            self._damage(part, f"record at byte {whole - begin} of the chunk points outside of it")
        if short:
            self._damage(part, "messages shorter than their own header", messages=short)
        if definitions and part.opcode == records.CHUNK:
            found = np.empty((definitions, 3), np.int64)
            records.find_definitions(data, begin, whole, found)
            for opcode, at, length in found.tolist():
                self._define(opcode, data, at, at + length, part, lost=True)
        stream, times, extent = np.empty(n, np.int32), np.empty((3, n), np.int64), np.empty((2, n), np.int64)
        met: Counts = np.zeros(_CHANNELS, np.int64)
        n, _ = records.fill(data, begin, whole, self._wanted, met, stream, times, extent)
        for channel in np.flatnonzero((met > 0) & (self._wanted == 0)).tolist():
            self._damage(part, f"messages of channel {channel}, which is declared nowhere", messages=int(met[channel]))
            met[channel] = 0
        self.counts += met
        if n:
            yield Messages(
                stream=stream[:n],
                data=data,
                start=extent[0, :n],
                length=extent[1, :n],
                log_time=times[0, :n],
                publish_time=times[1, :n],
                sequence=times[2, :n],
            )

    def _attachment(self, part: Part) -> Iterator[mcap.records.Attachment]:
        try:
            content = self._content(part)
            attachment = parse(mcap.records.Attachment.read, content)
            end = 32 + len(attachment.name.encode()) + len(attachment.media_type.encode()) + len(attachment.data)
            (crc,) = struct.unpack_from("<I", content, end)
            if crc and zlib.crc32(content[:end]) != crc and not self._trust:
                raise ValueError("crc does not match")
        except (ValueError, struct.error) as error:
            self._damage(part, f"attachment: {error}", messages=0)
        else:
            yield attachment

    def _metadata(self, part: Part) -> Iterator[mcap.records.Metadata]:
        try:
            yield parse(mcap.records.Metadata.read, self._content(part))
        except ValueError as error:
            self._damage(part, f"metadata: {error}", messages=0)

    def _end_data(self, part: Part) -> None:
        self.complete = True
        (crc,) = struct.unpack_from("<I", self._data.data, part.begin + FRAME)
        if crc and zlib.crc32(self._data[: part.begin].data) != crc:
            self.damages.add(Damage(0, part.begin, "crc of the data does not match", lost=not self.damages.count))

    def _compare(self) -> None:
        """Note each channel of which another number of messages came than the statistics promise."""
        promised = self._promised()
        for channel in sorted((promised or {}).keys() | set(np.flatnonzero(self.counts).tolist())):
            expected = (promised or {}).get(channel, 0)
            came, lost = int(self.counts[channel]), int(self._indexed_lost[channel])
            if promised is not None and came + lost != expected:
                reason = f"channel {channel}: {came} messages read, {expected} in the statistics"
                missing = max(expected - came - lost, 0)
                self.damages.add(Damage(0, 0, reason, lost=missing > 0, messages=missing))

    def _promised(self) -> dict[int, int] | None:
        statistics = self.statistics
        if statistics is None or (statistics.message_count and not statistics.channel_message_counts):
            return None
        return statistics.channel_message_counts

    def _content(self, part: Part) -> bytes:
        """The content of a record; ValueError above the limit."""
        if part.end - part.begin > self._limits.record_bytes:
            raise ValueError(f"record of {part.end - part.begin} bytes, above the limit of {self._limits.record_bytes}")
        return self._data[part.begin + FRAME : part.end].tobytes()

    def _damage(self, part: Part, reason: str, *, lost: bool = True, messages: int | None = None) -> None:
        self.damages.add(Damage(part.begin, part.end, reason, lost=lost, messages=messages))
