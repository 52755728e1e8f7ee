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

from fuselog.replay.log.channels import Channel, Definitions, parse
from fuselog.replay.mcap_file import records
from fuselog.replay.mcap_file.chunks import scan_rows
from fuselog.replay.mcap_file.decompress import Limits
from fuselog.replay.mcap_file.mapped import map_file
from fuselog.replay.mcap_file.records import FRAME
from fuselog.replay.mcap_file.summary import MAGIC
from fuselog.replay.mcap_file.walk import MessageWalk
from fuselog.replay.recover.damage import Damage, Damages
from fuselog.replay.recover.stretches import BEHIND, Stretch, stretches_of
from fuselog.replay.recover.torn import TornChunks, count_indexed
from fuselog.schemas.errors import LogError
from fuselog.schemas.messages import Messages

Item: TypeAlias = Messages | mcap.records.Attachment | mcap.records.Metadata
Counts: TypeAlias = NDArray[np.int64]  # (65536,) by channel

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
        self.counts: Counts = np.zeros(records.CHANNELS, np.int64)  # messages read
        self.header = mcap.records.Header(profile="", library="")
        self._indexed_lost: Counts = np.zeros(
            records.CHANNELS, np.int64
        )  # those that the index of a damaged chunk counts
        self._data = map_file(self.path)
        self._limits = limits or Limits()
        self._trust = trust_damaged
        self._chunks = TornChunks(self._data, self._limits, trust_damaged=trust_damaged)
        self._wanted = np.zeros(records.CHANNELS, np.uint8)
        self._walk = MessageWalk()
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
        for stretch in stretches_of(self._data):
            self._records += stretch.opcode != 0
            match stretch.opcode:
                case records.SCHEMA | records.CHANNEL:
                    lost = not self.complete
                    self._define(stretch.opcode, self._data, stretch.begin + FRAME, stretch.end, stretch, lost=lost)
                case records.MESSAGE:
                    yield from self._bare(stretch)
                case records.CHUNK:
                    yield from self._chunk(stretch)
                case records.ATTACHMENT:
                    yield from self._attachment(stretch)
                case records.METADATA:
                    yield from self._metadata(stretch)
                case records.DATA_END:
                    self._end_data(stretch)
                case 0:
                    lost = not self.complete and stretch.end > len(MAGIC)
                    self._damage(stretch, stretch.reason, lost=lost or stretch.reason == BEHIND)
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
        for stretch in stretches_of(self._data[:end], start):
            if stretch.opcode in (records.SCHEMA, records.CHANNEL):
                self._define(stretch.opcode, self._data, stretch.begin + FRAME, stretch.end, stretch, lost=False)
            elif stretch.opcode == records.STATISTICS:
                try:
                    self.statistics = parse(mcap.records.Statistics.read, self._content(stretch))
                except ValueError as error:
                    self._damage(stretch, f"statistics: {error}", lost=False)

    def _define(
        self, opcode: int, data: NDArray[np.uint8], begin: int, end: int, stretch: Stretch, *, lost: bool
    ) -> None:
        """Learn the content ``data[begin:end]`` of a Schema or Channel record that lies in ``stretch``."""
        known = len(self.definitions)
        try:
            if end - begin > self._limits.record_bytes:
                raise ValueError(f"definition of {end - begin} bytes, above the limit of {self._limits.record_bytes}")
            self.definitions.add(opcode, data[begin:end].tobytes())
        except ValueError as error:
            self._damage(stretch, str(error), lost=lost)
        if len(self.definitions) > self._limits.channels:
            raise LogError(self.path, 0, f"more than {self._limits.channels} channels, which is the limit")
        if len(self.definitions) > known:
            self._wanted[list(self.definitions.numbers())] = 1

    def _bare(self, stretch: Stretch) -> Iterator[Messages]:
        if stretch.end - stretch.begin > self._limits.record_bytes:
            self._damage(stretch, f"messages of {stretch.end - stretch.begin} bytes, above the limit")
            return
        yield from self._take(self._data, stretch.begin, stretch.end, stretch)

    def _chunk(self, stretch: Stretch) -> Iterator[Messages]:
        indexed = count_indexed(self._data, stretch.end)
        before, known = self.counts.copy(), self.damages.count
        opened = self._chunks.open(stretch, sum(indexed.values()) if indexed else None)
        if opened.damage is not None:
            self.damages.add(opened.damage)
        yield from self._take(opened.records, 0, len(opened.records), stretch)
        if self.damages.count > known:
            for channel, n in indexed.items():
                self._indexed_lost[channel] += max(n - int(self.counts[channel] - before[channel]), 0)

    def _take(self, data: NDArray[np.uint8], begin: int, end: int, stretch: Stretch) -> Iterator[Messages]:
        """The messages of records, as they lie; what they define is learned first."""
        definitions, whole = records.measure(data, begin, end)
        if whole != end:
            self._damage(stretch, f"record at byte {whole - begin} of the chunk points outside of it")
        if definitions and stretch.opcode == records.CHUNK:
            found = np.empty((definitions, 3), np.int64)
            records.find_definitions(data, begin, whole, found)
            for opcode, at, length in found.tolist():
                self._define(opcode, data, at, at + length, stretch, lost=True)
        met: Counts = np.zeros(records.CHANNELS, np.int64)
        messages, _, short, _ = self._walk.take(data, begin, whole, self._wanted, met)
        if short:
            self._damage(stretch, "messages shorter than their own header", messages=short)
        for channel in np.flatnonzero((met > 0) & (self._wanted == 0)).tolist():
            reason = f"messages of channel {channel}, which is declared nowhere"
            self._damage(stretch, reason, messages=int(met[channel]))
            met[channel] = 0
        self.counts += met
        if len(messages):
            yield messages

    def _attachment(self, stretch: Stretch) -> Iterator[mcap.records.Attachment]:
        try:
            content = self._content(stretch)
            attachment = parse(mcap.records.Attachment.read, content)
            end = 32 + len(attachment.name.encode()) + len(attachment.media_type.encode()) + len(attachment.data)
            (crc,) = struct.unpack_from("<I", content, end)
            if crc and zlib.crc32(content[:end]) != crc and not self._trust:
                raise ValueError("crc does not match")
        except (ValueError, struct.error) as error:
            self._damage(stretch, f"attachment: {error}", messages=0)
        else:
            yield attachment

    def _metadata(self, stretch: Stretch) -> Iterator[mcap.records.Metadata]:
        try:
            yield parse(mcap.records.Metadata.read, self._content(stretch))
        except ValueError as error:
            self._damage(stretch, f"metadata: {error}", messages=0)

    def _end_data(self, stretch: Stretch) -> None:
        self.complete = True
        (crc,) = struct.unpack_from("<I", self._data.data, stretch.begin + FRAME)
        if crc and zlib.crc32(self._data[: stretch.begin].data) != crc:
            self.damages.add(Damage(0, stretch.begin, "crc of the data does not match", lost=not self.damages.count))

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

    def _content(self, stretch: Stretch) -> bytes:
        """The content of a record; ValueError above the limit."""
        if stretch.end - stretch.begin > self._limits.record_bytes:
            raise ValueError(
                f"record of {stretch.end - stretch.begin} bytes, above the limit of {self._limits.record_bytes}"
            )
        return self._data[stretch.begin + FRAME : stretch.end].tobytes()

    def _damage(self, stretch: Stretch, reason: str, *, lost: bool = True, messages: int | None = None) -> None:
        self.damages.add(Damage(stretch.begin, stretch.end, reason, lost=lost, messages=messages))
