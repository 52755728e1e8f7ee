"""Logs written as fast as they are read: messages come in columns and leave as compressed, indexed chunks."""

import os
import zlib
from importlib.metadata import PackageNotFoundError, version
from os import PathLike
from types import TracebackType
from typing import Self

import mcap.records
import numpy as np
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import McapRecord

from fuselog.replay.mcap_file import records
from fuselog.replay.mcap_file.framing import Batch, Frames
from fuselog.replay.mcap_file.records import MAX_TIME
from fuselog.replay.mcap_file.sink import Sink, encode
from fuselog.replay.mcap_file.summary import MAGIC
from fuselog.schemas.messages import Messages

# What ROS 2 players ask of each channel: reliable, volatile, keep the last ten, no deadline.
_ROS2_QOS = """\
- history: 1
  depth: 10
  reliability: 1
  durability: 2
  deadline:
    sec: 9223372036
    nsec: 854775807
  lifespan:
    sec: 9223372036
    nsec: 854775807
  liveliness: 1
  liveliness_lease_duration:
    sec: 9223372036
    nsec: 854775807
  avoid_ros_namespace_conventions: false
"""


class LogWriter:
    """Write an MCAP log; use it as a context manager, for closing it writes its summary.

    The same messages in the same order give the same bytes, however the calls to `write` divide them.
    ``compression`` is "zstd", "lz4" or ""; a chunk holds at most ``chunk_bytes`` before compression,
    or one larger message. Raises LogError, from any call, when the file cannot be written.
    """

    def __init__(
        self,
        path: str | PathLike[str],
        *,
        profile: str = "ros2",
        compression: str = "zstd",
        chunk_bytes: int = 4 << 20,
        library: str | None = None,
    ) -> None:
        self._profile = profile
        self._chunk_bytes = chunk_bytes
        self._schemas: dict[tuple[str, str, bytes], mcap.records.Schema] = {}
        self._channels: list[mcap.records.Channel] = []
        self._metadata: list[mcap.records.MetadataIndex] = []
        self._attachments: list[mcap.records.AttachmentIndex] = []
        self._counts = np.zeros(records.CHANNELS, np.int64)
        self._first, self._last = MAX_TIME, 0
        self._frames = Frames(chunk_bytes)
        self._sink = Sink(os.fspath(path), compression)
        self._open = True
        header = mcap.records.Header(profile, _library() if library is None else library)
        self._append(MAGIC + encode(header))

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @property
    def size(self) -> int:
        """Bytes of the file; exact right after `flush`."""
        return self._sink.offset

    def add_channel(
        self,
        topic: str,
        schema_name: str,
        schema_encoding: str,
        schema_text: str | bytes,
        *,
        encoding: str = "cdr",
        metadata: dict[str, str] | None = None,
    ) -> int:
        """Declare a channel -> its number, which `Messages.stream` refers to; the first is 1.

        An empty ``schema_name`` means no schema. In a ros2 log a cdr channel without ``metadata`` gets
        the quality of service that ROS 2 players ask for.
        """
        data = schema_text.encode() if isinstance(schema_text, str) else schema_text
        is_ros2 = self._profile == "ros2" and encoding == "cdr"
        standard = {"offered_qos_profiles": _ROS2_QOS} if is_ros2 else {}
        channel = mcap.records.Channel(
            id=len(self._channels) + 1,
            topic=topic,
            message_encoding=encoding,
            metadata=standard | dict(metadata or {}),
            schema_id=self._add_schema(schema_name, schema_encoding, data) if schema_name else 0,
        )
        self._channels.append(channel)
        self._append(encode(channel))
        return channel.id

    def add_metadata(self, name: str, metadata: dict[str, str]) -> None:
        """Write a metadata record."""
        record = encode(mcap.records.Metadata(name=name, metadata=dict(metadata)))

        def place(offset: int) -> bytes:
            self._metadata.append(mcap.records.MetadataIndex(offset=offset, length=len(record), name=name))
            return record

        self._sink.append(place)

    def add_attachment(self, name: str, data: bytes, *, media_type: str, log_time: int, create_time: int) -> None:
        """Write a file as an attachment record; times in ns."""
        content = encode(mcap.records.Attachment(create_time, log_time, name, media_type, data))

        def place(offset: int) -> bytes:
            size = len(data)
            index = mcap.records.AttachmentIndex(offset, len(content), log_time, create_time, size, name, media_type)
            self._attachments.append(index)
            return content

        self._sink.append(place)

    def write(self, messages: Messages) -> None:
        """Write the messages in their order; ``stream`` holds channel numbers of `add_channel`.

        Raises ValueError for a channel not declared, a payload outside of ``data``, or a time before 0.
        """
        if not len(messages):
            return
        self._check(messages)
        known = len(self._channels) + 1
        self._counts[:known] += np.bincount(messages.stream, minlength=known)
        self._first = min(self._first, int(messages.log_time.min()))
        self._last = max(self._last, int(messages.log_time.max()))
        batch, first = Batch.of(messages), 0
        while (first := self._frames.add(batch, first)) < len(messages):
            self._end_chunk()

    def flush(self, *, sync: bool = False) -> None:
        """End the chunk, hand all to the system, with ``sync`` to the disk: no crash loses it then."""
        self._end_chunk()
        self._sink.wait(sync=sync)

    def close(self) -> None:
        """Write the last chunk and the summary, and close the file."""
        if not self._open:
            return
        self._open = False
        try:
            self._end_chunk()
            self._append(encode(mcap.records.DataEnd(data_section_crc=0)))
            self._sink.wait()
            self._append(self._summary(self._sink.offset))
            self._sink.wait()
        finally:
            self._sink.close()

    def _add_schema(self, name: str, encoding: str, data: bytes) -> int:
        known = self._schemas.get((name, encoding, data))
        if known is not None:
            return known.id
        schema = mcap.records.Schema(id=len(self._schemas) + 1, data=data, encoding=encoding, name=name)
        self._schemas[name, encoding, data] = schema
        self._append(encode(schema))
        return schema.id

    def _append(self, data: bytes) -> None:
        self._sink.append(lambda _: data)

    def _end_chunk(self) -> None:
        if self._frames.count:
            self._sink.append_chunk(self._frames)
            self._frames = Frames(self._chunk_bytes)

    def _check(self, messages: Messages) -> None:
        if messages.stream.min() < 1 or messages.stream.max() > len(self._channels):
            raise ValueError("messages of a channel that was not added")
        if messages.log_time.min() < 0 or messages.publish_time.min() < 0:
            raise ValueError("messages from before the year 1970")
        end = messages.start + messages.length
        if messages.start.min() < 0 or messages.length.min() < 0 or end.max() > len(messages.data):
            raise ValueError("payloads outside of the data")

    def _summary(self, start: int) -> bytes:
        """Summary, summary offsets, footer and magic of a file whose data section ends at ``start``."""
        groups: list[tuple[Opcode, list[McapRecord]]] = [
            (Opcode.SCHEMA, [*self._schemas.values()]),
            (Opcode.CHANNEL, [*self._channels]),
            (Opcode.STATISTICS, [self._statistics()]),
            (Opcode.CHUNK_INDEX, [*self._sink.chunks]),
            (Opcode.METADATA_INDEX, [*self._metadata]),
            (Opcode.ATTACHMENT_INDEX, [*self._attachments]),
        ]
        builder = RecordBuilder()
        offsets: list[McapRecord] = []
        for opcode, group in groups:
            begin = builder.count
            for record in group:
                record.write(builder)
            if group:
                offsets.append(mcap.records.SummaryOffset(opcode, start + begin, builder.count - begin))
        offsets_start = start + builder.count
        summary = builder.end() + encode(*offsets)
        footer = mcap.records.Footer(summary_start=start, summary_offset_start=offsets_start, summary_crc=0)
        footer.summary_crc = zlib.crc32(summary + encode(footer)[:-4])
        return summary + encode(footer) + MAGIC

    def _statistics(self) -> mcap.records.Statistics:
        total = int(self._counts.sum())
        return mcap.records.Statistics(
            attachment_count=len(self._attachments),
            channel_count=len(self._channels),
            channel_message_counts={c.id: int(self._counts[c.id]) for c in self._channels},
            chunk_count=len(self._sink.chunks),
            message_count=total,
            message_end_time=self._last,
            message_start_time=self._first if total else 0,
            metadata_count=len(self._metadata),
            schema_count=len(self._schemas),
        )


def _library() -> str:
    try:
        return f"fuselog {version('fuselog')}"
    except PackageNotFoundError:  # run from a source tree
        return "fuselog"
