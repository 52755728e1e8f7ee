"""Channels and schemas of a log, as its Channel and Schema records declare them."""

import struct
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from io import BytesIO
from typing import TypeVar

import mcap.records
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError

from fuselog.replay.mcap_file import records
from fuselog.schemas import MessageType

_Record = TypeVar("_Record")


@dataclass(frozen=True, slots=True)
class Schema:
    """A message definition as the log carries it; all empty when the channel has none."""

    name: str
    encoding: str  # "ros2msg", "jsonschema", "protobuf", ...
    data: bytes


@dataclass(frozen=True, slots=True)
class Channel:
    """One stream of messages of one type; `Messages.stream` holds its ``id``."""

    id: int
    topic: str
    schema: Schema
    encoding: str  # of the messages: "cdr", "json", "protobuf", ...
    metadata: dict[str, str]
    count: int | None  # messages, as the statistics of the file say; None when they do not

    @property
    def message_type(self) -> MessageType:
        """What its messages are, as decoders ask for it."""
        return {
            "encoding": self.encoding,
            "schema_encoding": self.schema.encoding,
            "schema_name": self.schema.name,
            "schema_text": self.schema.data,
        }


def parse(read: Callable[[ReadDataStream], _Record], content: bytes) -> _Record:
    """A record of the ``mcap`` package from its content; ValueError if it is broken."""
    try:
        return read(ReadDataStream(BytesIO(content)))
    except (struct.error, McapError, ValueError, OverflowError) as error:
        raise ValueError(f"broken record: {error or type(error).__name__}") from error


class Definitions:
    """The channels and schemas met so far; where one number is declared twice, the first counts.

    They take at most ``most_bytes`` in the file together.
    """

    def __init__(self, most_bytes: int = 64 << 20) -> None:
        self._left = self._most_bytes = most_bytes
        self._schemas: dict[int, mcap.records.Schema] = {}
        self._channels: dict[int, mcap.records.Channel] = {}

    def __len__(self) -> int:
        return len(self._channels)

    def numbers(self) -> frozenset[int]:
        """The numbers of the channels."""
        return frozenset(self._channels)

    def schemas(self) -> dict[int, Schema]:
        """The schemas by number, in that order, also those of no channel."""
        return {id: _public(self._schemas[id]) for id in sorted(self._schemas)}

    def add(self, opcode: int, content: bytes) -> None:
        """Take in the content of a Schema or Channel record; ValueError if it is broken, or too much."""
        known = self._schemas if opcode == records.SCHEMA else self._channels
        if len(content) >= 2 and int.from_bytes(content[:2], "little") in known:
            return
        if len(content) > self._left:
            raise ValueError(f"more than {self._most_bytes} bytes of schemas and channels, which is the limit")
        self._left -= len(content)
        if opcode == records.SCHEMA:
            schema = parse(mcap.records.Schema.read, content)
            self._schemas[schema.id] = schema
        else:
            channel = parse(mcap.records.Channel.read, content)
            self._channels[channel.id] = channel

    def cover(self, channels: Iterable[int]) -> bool:
        """Whether each of these channels, and its schema, is declared."""
        return all(id in self._channels and self._has_schema(self._channels[id]) for id in channels)

    def missing_schemas(self) -> list[tuple[int, int]]:
        """(channel, schema) for each channel whose schema is not declared."""
        return [(c.id, c.schema_id) for c in self._channels.values() if not self._has_schema(c)]

    def resolve(self, counts: dict[int, int] | None) -> dict[int, Channel]:
        """The channels by number, in that order, with their schemas and ``counts``."""
        return {id: self._resolve(self._channels[id], counts) for id in sorted(self._channels)}

    def _resolve(self, channel: mcap.records.Channel, counts: dict[int, int] | None) -> Channel:
        schema = self._schemas.get(channel.schema_id)
        return Channel(
            id=channel.id,
            topic=channel.topic,
            schema=_public(schema) if schema else Schema("", "", b""),
            encoding=channel.message_encoding,
            metadata=channel.metadata,
            count=None if counts is None else counts.get(channel.id, 0),
        )

    def _has_schema(self, channel: mcap.records.Channel) -> bool:
        return channel.schema_id == 0 or channel.schema_id in self._schemas


def _public(schema: mcap.records.Schema) -> Schema:
    return Schema(schema.name, schema.encoding, schema.data)
