"""An MCAP file as a part of a log."""

from functools import partial

import mcap.records

from fuselog.replay.log.channels import Channel, Schema, parse
from fuselog.replay.log.loss import Loss, Losses
from fuselog.replay.log.part import Attachment
from fuselog.replay.log.selection import Selection
from fuselog.replay.mcap_file import records
from fuselog.replay.mcap_file.attachments import read_content, read_head
from fuselog.replay.mcap_file.contents import Place, find_places, survey
from fuselog.replay.mcap_file.decompress import Limits
from fuselog.replay.mcap_file.opener import Opener
from fuselog.replay.mcap_file.reading import Reading
from fuselog.replay.mcap_file.source import Source
from fuselog.replay.mcap_file.summary import MAGIC
from fuselog.schemas.errors import LogError

_HEAD = 1 << 16  # bytes of an attachment in which its name and type must lie


class McapFile:
    """An open MCAP file; ``library`` and ``profile`` as its header says.

    ``statistics`` is what its writer counted, None when the file does not tell. Raises LogError for what is no MCAP,
    or has more channels than the limit.
    """

    def __init__(self, source: Source, limits: Limits, *, check_crc: bool) -> None:
        if source.read(0, len(MAGIC)).tobytes() != MAGIC:
            raise LogError(source.path, 0, "not an MCAP: it does not begin with the magic bytes")
        self.path = source.path
        self.remote = "://" in source.path  # not a file of this machine
        self._source = source
        self._check_crc = check_crc
        self._losses = Losses(source.path)
        self._opener = Opener(source, limits, self._losses, check_crc=check_crc)
        self._contents = survey(source, self._opener.open, self._losses)
        definitions = self._contents.definitions
        if len(definitions) > limits.channels:
            raise LogError(self.path, 0, f"more than {limits.channels} channels, which is the limit")
        self.profile: str = self._contents.header.profile
        self.library: str = self._contents.header.library
        self.statistics: mcap.records.Statistics | None = self._contents.statistics
        self.schemas: dict[int, Schema] = definitions.schemas()
        self.channels: dict[int, Channel] = definitions.resolve(self._contents.message_counts())

    @property
    def losses(self) -> list[Loss]:
        """The damage met so far, in the order it was met."""
        return self._losses.list()

    @property
    def time_range(self) -> tuple[int, int] | None:
        """Earliest and latest log time in ns as the file says, without reading; None without messages."""
        statistics = self.statistics
        if statistics is not None:
            found = [(statistics.message_start_time, statistics.message_end_time)] * (statistics.message_count > 0)
        else:
            found = [(c.start_ns, c.finish_ns) for c in self._contents.chunks if c.finish_ns]
        return (min(first for first, _ in found), max(last for _, last in found)) if found else None

    def metadata(self) -> dict[str, dict[str, str]]:
        """The metadata records by name; where a name comes twice, the last counts."""
        found: dict[str, dict[str, str]] = {}
        for at, length in self._places(records.METADATA):
            try:
                record = parse(mcap.records.Metadata.read, self._metadata_content(at, length))
            except ValueError as error:
                self._losses.add(at, f"metadata: {error}", 0)
                continue
            found[record.name] = record.metadata
        return found

    def attachments(self) -> list[Attachment]:
        """The attachments in file order; nothing but their heads is read."""
        found: list[Attachment] = []
        for at, length in self._places(records.ATTACHMENT):
            try:
                head = read_head(self._source.read(at, at + min(length, _HEAD)))
            except ValueError as error:
                self._losses.add(at, str(error), 0)
                continue
            read = partial(self._read_attachment, at, length)
            found.append(
                Attachment(self.path, head.name, head.media_type, head.log_time, head.create_time, head.size, read)
            )
        return found

    def reading(self, selection: Selection) -> Reading:
        """Begin to read what is selected."""
        return Reading(self._opener, self._contents, self._losses, selection)

    def close(self) -> None:
        """Let go of the file."""
        self._source.close()

    def _places(self, opcode: int) -> list[Place]:
        """Where the metadata or attachments lie; a scan finds them when the summary does not say."""
        contents, statistics = self._contents, self.statistics
        known = contents.metadata if opcode == records.METADATA else contents.attachments
        places = find_places(self._source, opcode) if known is None else known
        name, told = "attachments", statistics and statistics.attachment_count
        if opcode == records.METADATA:
            name, told = "metadata records", statistics and statistics.metadata_count
        if told is not None and told != len(places):
            self._losses.add(0, f"{len(places)} {name} found, {told} in the statistics", 0)
        return places

    def _metadata_content(self, at: int, length: int) -> bytes:
        record = self._opener.record(at, length)
        if record[0] != records.METADATA:
            raise ValueError("no metadata where the index says")
        return record[records.FRAME :].tobytes()

    def _read_attachment(self, at: int, length: int) -> bytes:
        try:
            return read_content(self._opener.record(at, length), check_crc=self._check_crc)
        except ValueError as error:
            raise LogError(self.path, at, str(error)) from error
