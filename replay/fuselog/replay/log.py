"""A log as its reader sees it: channels, metadata, losses, and messages in log-time order."""

import os
from collections.abc import Collection, Iterator, Sequence
from os import PathLike
from types import TracebackType
from typing import NamedTuple, Self

import mcap.records
import numpy as np
from numpy.typing import NDArray

from fuselog.replay.channels import Channel, parse
from fuselog.replay.columns import decode_topic
from fuselog.replay.contents import MAGIC, survey
from fuselog.replay.decompress import Limits
from fuselog.replay.loss import Loss, Losses
from fuselog.replay.mapped import map_file
from fuselog.replay.merge import in_time_order
from fuselog.replay.reading import ChunkOpener, Reading
from fuselog.schemas.errors import LogError
from fuselog.schemas.messages import Columns, Messages


class RawMessage(NamedTuple):
    """One message with its payload bytes; times in ns."""

    log_time: int
    publish_time: int
    channel_id: int
    sequence: int
    data: bytes


class Log:
    """An open log. ``channels`` by number; ``profile`` as its header says.

    Every reading starts anew and sees all messages of the wanted topics in log-time order, ties in file
    order. `losses` grows while reading; counts are compared with the statistics at the end of a reading.
    """

    def __init__(self, path: str, data: NDArray[np.uint8], limits: Limits, *, check_crc: bool) -> None:
        self.path = path
        self._limits = limits
        self._losses = Losses()
        self._opener = ChunkOpener(path, data, limits, self._losses, check_crc=check_crc)
        self._contents = survey(data, self._opener.open, self._losses)
        self.profile = self._contents.profile
        if len(self._contents.definitions) > limits.channels:
            raise LogError(path, 0, f"more than {limits.channels} channels, which is the limit")
        self.channels: dict[int, Channel] = self._contents.definitions.resolve(self._contents.message_counts())

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Let go of the file; batches that were already handed out stay valid."""
        self._opener.close()

    @property
    def losses(self) -> list[Loss]:
        """The damage met so far, in the order it was met; empty after a full reading of a sound log."""
        return self._losses.list()

    @property
    def topics(self) -> dict[str, list[Channel]]:
        """The channels of each topic; more than one when its type or publisher changed on the way."""
        topics: dict[str, list[Channel]] = {}
        for channel in self.channels.values():
            topics.setdefault(channel.topic, []).append(channel)
        return topics

    @property
    def time_range(self) -> tuple[int, int] | None:
        """Earliest and latest log time in ns as the file says, without reading; None without messages."""
        statistics = self._contents.statistics
        if statistics is not None:
            found = [(statistics.message_start_time, statistics.message_end_time)] * (statistics.message_count > 0)
        else:
            found = [(c.start_ns, c.finish_ns) for c in self._contents.chunks if c.finish_ns]
        return (min(first for first, _ in found), max(last for _, last in found)) if found else None

    def metadata(self) -> dict[str, dict[str, str]]:
        """The metadata records by name; where a name comes twice, the last counts."""
        found: dict[str, dict[str, str]] = {}
        for at, length in self._contents.metadata:
            try:
                content = self._opener.content(at, length)
                record = parse(mcap.records.Metadata.read, content)
            except ValueError as error:
                self._losses.add(at, f"metadata: {error}", 0)
                continue
            found[record.name] = record.metadata
        return found

    def batches(self, topics: Collection[str] | None = None) -> Iterator[Messages]:
        """All messages of ``topics`` (all when None; absent ones give nothing), a chunk at a time.

        ``stream`` is the channel number. Payloads lie in the decompressed chunk, or in the file itself.
        Memory is bounded by a chunk and those that overlap it in time.
        """
        chosen = {id for id, c in self.channels.items() if topics is None or c.topic in topics}
        reading = Reading(self._opener, self._losses, chosen)
        chunks = [chunk for chunk in self._contents.chunks if reading.wants(chunk)]
        yield from in_time_order(chunks, reading.load)
        if topics is None:
            reading.note_undeclared()
        counts = self._contents.message_counts()
        if counts is not None:
            reading.compare({id: n for id, n in counts.items() if topics is None or id in chosen})

    def messages(self, topics: Collection[str] | None = None) -> Iterator[RawMessage]:
        """The messages of `batches` one by one, each with its own bytes."""
        for batch in self.batches(topics):
            data = batch.data.data
            for log, publish, channel, sequence, start, length in zip(
                batch.log_time.tolist(),
                batch.publish_time.tolist(),
                batch.stream.tolist(),
                batch.sequence.tolist(),
                batch.start.tolist(),
                batch.length.tolist(),
                strict=True,
            ):
                yield RawMessage(log, publish, channel, sequence, bytes(data[start : start + length]))

    def read(self, topic: str, fields: Sequence[str], *, stamp: str | None = None) -> Columns:
        """The whole topic as columns, in log-time order: ``read("/imu", ["angular_velocity.z"])``.

        ``stamp`` names the field of `Columns.t_ns`; by default the one that looks like it, and the log time
        where a type has none. Raises LogError without such a topic, SchemaError without such a field.
        """
        channels = self.topics.get(topic)
        if channels is None:
            raise LogError(self.path, 0, f"no topic {topic!r}; it has {', '.join(self.topics) or 'none'}")
        return decode_topic(self.batches([topic]), channels, fields, stamp)


def open_log(path: str | PathLike[str], *, limits: Limits | None = None, check_crc: bool = True) -> Log:
    """Open an MCAP log for reading; it is mapped, not loaded. Use it as a context manager.

    Damage is no error: bad chunks are skipped, a cut file is read up to its cut, and `Log.losses` tells.
    Raises LogError when there is nothing to read: no such file, a folder, empty, or not an MCAP.
    """
    name = os.fspath(path)
    return Log(name, _map(name), limits or Limits(), check_crc=check_crc)


def _map(path: str) -> NDArray[np.uint8]:
    """The bytes of the file, mapped; LogError if it is not a file that begins as an MCAP does."""
    data = map_file(path)
    if data[: len(MAGIC)].tobytes() != MAGIC:
        raise LogError(path, 0, "not an MCAP: it does not begin with the magic bytes")
    return data
