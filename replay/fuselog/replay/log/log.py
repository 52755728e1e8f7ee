"""A log as its reader sees it: channels, metadata, losses, and messages in log-time order, of one file or several."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from types import TracebackType
from typing import Any, Self

import numpy as np

from fuselog.replay.log.channels import Channel
from fuselog.replay.log.loss import Loss
from fuselog.replay.log.merge import Piece, in_time_order
from fuselog.replay.log.part import Attachment, Part
from fuselog.replay.log.raw import RawMessage, one_by_one
from fuselog.replay.log.selection import Topics, select
from fuselog.replay.log.topic import Topic, show_topics
from fuselog.replay.log.unify import Numbers, unify
from fuselog.schemas.errors import LogError
from fuselog.schemas.messages import Columns, Messages
from fuselog.schemas.shown import Shown, clock


class Log:
    """An open log. ``parts`` are its files in order, ``channels`` by number, ``profile`` that of the first file.

    Every reading starts anew and sees all messages that are wanted in log-time order, ties by file and in file
    order. `losses` grows while reading; counts are compared with the statistics at the end of a reading of all times.

    What is wanted: ``topics`` is a name, a collection of names, or a compiled pattern that whole names match; None is
    all, absent ones give nothing. ``start_ns`` <= log time < ``end_ns``, None for an open end. Chunks that the index
    tells to hold nothing of it are not touched.
    """

    def __init__(self, path: str, parts: Sequence[Part], missing: Sequence[Loss] = ()) -> None:
        self.path = path
        self.parts = tuple(parts)
        self.profile = self.parts[0].profile
        self.channels, self._numbers = unify([part.channels for part in self.parts])
        self._missing = list(missing)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Let go of the files; batches that were already handed out stay valid."""
        for part in self.parts:
            part.close()

    @property
    def losses(self) -> list[Loss]:
        """The damage met so far, by file in the order it was met; empty after a full reading of a sound log."""
        return self._missing + [loss for part in self.parts for loss in part.losses]

    @property
    def topics(self) -> dict[str, list[Channel]]:
        """The channels of each topic; more than one when its type or publisher changed on the way."""
        topics: dict[str, list[Channel]] = {}
        for channel in self.channels.values():
            topics.setdefault(channel.topic, []).append(channel)
        return topics

    @property
    def time_range(self) -> tuple[int, int] | None:
        """Earliest and latest log time in ns as the files say, without reading; None without messages."""
        found = [part.time_range for part in self.parts]
        told = [span for span in found if span is not None]
        return (min(first for first, _ in told), max(last for _, last in told)) if told else None

    def metadata(self) -> dict[str, dict[str, str]]:
        """The metadata records by name; where a name comes twice, the last counts."""
        found: dict[str, dict[str, str]] = {}
        for part in self.parts:
            found |= part.metadata()
        return found

    def attachments(self) -> list[Attachment]:
        """The attachments in file order; `Attachment.read` gives the content."""
        return [attachment for part in self.parts for attachment in part.attachments()]

    def batches(
        self,
        topics: Topics | None = None,
        *,
        start_ns: int | None = None,
        end_ns: int | None = None,
        workers: int = 1,
    ) -> Iterator[Messages]:
        """The wanted messages, a chunk at a time; ``stream`` is the channel number.

        Payloads lie in the decompressed chunk, or in the file itself. Memory is bounded by a chunk and those that
        overlap it in time, and two more for each of ``workers``, when these are more than one: threads that decompress
        ahead, the caller's among them. Their number changes nothing that comes.
        """
        wanted = select(self.channels.values(), topics, start_ns, end_ns)
        readings = [
            part.reading(wanted.renumbered(numbers)) for part, numbers in zip(self.parts, self._numbers, strict=True)
        ]
        pieces = [self._placed(piece, number) for number, reading in enumerate(readings) for piece in reading.pieces()]
        yield from in_time_order(pieces, workers)
        for reading in readings:
            reading.finish()

    def messages(
        self, topics: Topics | None = None, *, start_ns: int | None = None, end_ns: int | None = None
    ) -> Iterator[RawMessage]:
        """The messages of `batches` one by one, each with its own bytes."""
        return one_by_one(self.batches(topics, start_ns=start_ns, end_ns=end_ns))

    def read(
        self,
        topic: str,
        fields: Sequence[str],
        *,
        stamp: str | None = None,
        start_ns: int | None = None,
        end_ns: int | None = None,
        workers: int = 1,
    ) -> Columns:
        """The topic as columns, in log-time order: ``read("/imu", ["angular_velocity.z"])``.

        ``stamp`` names the field of `Columns.t_ns`; by default the one that looks like it, and the log time
        where a type has none. Raises LogError without such a topic, SchemaError without such a field.
        """
        return self[topic].between(start_ns, end_ns).columns(fields, stamp=stamp, workers=workers)

    def __getitem__(self, topic: str) -> Topic:
        """The topic as a table: ``log["/imu"].pandas()``. Raises LogError without such a topic."""
        channels = self.topics.get(topic)
        if channels is None:
            raise LogError(self.path, 0, f"no topic {topic!r}; it has {', '.join(self.topics) or 'none'}")
        return Topic(topic, channels, partial(self.batches, topic))

    def _placed(self, piece: Piece, number: int) -> Piece:
        """A piece of file ``number`` among those of all files, its channels as in `channels`."""
        if len(self.parts) == 1:
            return piece
        numbers = self._numbers[number]

        def load(opened: Any) -> Messages | None:
            messages = piece.load(opened)
            return None if messages is None else _renumbered(messages, numbers)

        return piece._replace(place=(number, *piece.place), load=load)

    def __repr__(self) -> str:
        return self._shown().text()

    def _repr_html_(self) -> str:
        return self._shown().html()

    def _shown(self) -> Shown:
        first, last = self.time_range or (0, 0)
        counts = [channel.count for channel in self.channels.values() if channel.count is not None]
        many = f"{sum(counts)} messages" if len(counts) == len(self.channels) else "messages not counted"
        when = f", from {clock(first)} for {(last - first) * 1e-9:.3f} s" if self.time_range else ""
        title = f"Log {self.path}: {len(self.topics)} topics, {many}{when}"
        return show_topics(title, {name: self[name] for name in self.topics}, (last - first) * 1e-9)


def _renumbered(messages: Messages, numbers: Numbers) -> Messages:
    lookup = np.zeros(max(numbers) + 1, np.int32)
    lookup[list(numbers)] = list(numbers.values())
    return replace(messages, stream=lookup[messages.stream])
