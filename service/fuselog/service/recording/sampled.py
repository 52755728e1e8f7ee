"""Samples into messages of the channels of a recording."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import zenoh

from fuselog.replay.recording import Recording
from fuselog.schemas import Messages
from fuselog.service.batch import Batch
from fuselog.service.live.sources import Progress
from fuselog.service.recording.declared import TURNED_AWAY, Declared
from fuselog.service.recording.selection import Selection
from fuselog.service.recording.spool import Arrived
from fuselog.service.wire import UNTAGGED, Tag, read_tag
from fuselog.service.zenoh_door import sent_ns

_MOST_STREAMS = 8192
_MOST_PUBLISHERS = 4096
_PATIENCE_S, _LONGEST_PATIENCE_S = 2.0, 60.0  # until the network is asked again for a type

Describe = Callable[[str, str], Declared]
_Identity = tuple[int, str, str, bool]  # subscription, key, Zenoh's encoding, whether no filter got it


class Sampled(NamedTuple):
    """A sample, the number of the subscription on which it came, and whether no filter got it."""

    subscription: int
    sample: zenoh.Sample
    turned_away: bool


@dataclass(slots=True)
class _Stream:
    """Samples of one key and type on one subscription."""

    topic: str
    wanted: bool
    channel: int | None  # None: not wanted, or too many
    patience_s: float
    ask_at: float  # monotonic s; never again where the type is known


@dataclass(slots=True)
class _Publisher:
    """One publisher of one key."""

    received: int = 0
    missed: int = 0
    last: int = 0  # number of its newest sample


class SampledStreams:
    """Knows every stream that something came of, and declares its channel in the recording.

    A type that nobody tells is asked for again, for publishers may announce theirs late; the channel is another then.
    """

    def __init__(self, recording: Recording, describe: Describe, selection: Selection) -> None:
        self._recording, self._describe, self._selection = recording, describe, selection
        self._streams: dict[_Identity, _Stream] = {}
        self._publishers: dict[tuple[bytes, str], _Publisher] = {}  # by their bytes and key

    def messages(self, arrived: Sequence[Arrived[Sampled]]) -> Messages:
        """The samples that are recorded, with the time of arrival as log time."""
        batch = Batch()
        for (subscription, sample, turned_away), arrival_ns in arrived:
            key = str(sample.key_expr)
            stream = self._stream((subscription, key, str(sample.encoding), turned_away))
            if not stream.wanted or sample.kind != zenoh.SampleKind.PUT:
                continue
            attachment = sample.attachment
            tag = UNTAGGED if attachment is None else read_tag(attachment.to_bytes())
            self._number(stream.topic, key, tag)
            if stream.channel is None:
                self._recording.drop(stream.topic, "limit")
                continue
            published = tag.t_ns if tag.t_ns > 0 else sent_ns(sample) or arrival_ns
            batch.streams.append(stream.channel)
            batch.received.append(arrival_ns)
            batch.published.append(published)
            batch.numbers.append(max(tag.sequence, 0))
            batch.payloads.append(sample.payload.to_bytes())
        return batch.messages()

    def drop(self, subscription: int, key: str, count: int) -> None:
        """Account for samples for which there was no room, if they were to be recorded."""
        known = (stream for (n, k, *_), stream in self._streams.items() if (n, k) == (subscription, key))
        stream = next(known, None) or self._unnamed(subscription, key)
        if stream.wanted:
            self._recording.drop(stream.topic, "queue", count)

    def progress(self) -> dict[str, dict[str, Progress]]:
        """How far each publisher (hexadecimal) has come with each key that is recorded."""
        table: dict[str, dict[str, Progress]] = {}
        for (source, key), publisher in self._publishers.items():
            table.setdefault(source.hex(), {})[key] = Progress(publisher.received, publisher.missed)
        return table

    def _stream(self, identity: _Identity) -> _Stream:
        stream = self._streams.get(identity)
        if stream is None:
            if len(self._streams) >= _MOST_STREAMS:
                return self._unnamed(identity[0], identity[1])
            stream = self._streams[identity] = self._open(*identity)
        elif stream.ask_at < time.monotonic():
            self._ask_again(stream, *identity[1:])
        return stream

    def _open(self, subscription: int, key: str, media: str, turned_away: bool) -> _Stream:
        if self._recording.full or not self._selection.takes(subscription, key):
            return self._unnamed(subscription, key)
        declared = self._declared(key, media, turned_away)
        wanted = self._selection.names(declared.topic)
        channel = self._add(declared) if wanted else None
        ask_at = time.monotonic() + _PATIENCE_S if wanted and not declared.schema.name else float("inf")
        return _Stream(declared.topic, wanted, channel, _PATIENCE_S, ask_at)

    def _unnamed(self, subscription: int, key: str) -> _Stream:
        """A stream of which nothing is known, and that has no channel."""
        wanted = self._selection.takes(subscription, key) and self._selection.names(key)
        return _Stream(key, wanted, None, 0.0, float("inf"))

    def _declared(self, key: str, media: str, turned_away: bool) -> Declared:
        """The channel; what no filter got has one of its own."""
        declared = self._describe(key, media)
        return declared._replace(metadata=declared.metadata | TURNED_AWAY) if turned_away else declared

    def _ask_again(self, stream: _Stream, key: str, media: str, turned_away: bool) -> None:
        declared = self._declared(key, media, turned_away)
        if declared.schema.name:
            stream.topic, stream.channel = declared.topic, self._add(declared)
            stream.ask_at = float("inf")
        else:
            stream.patience_s = min(2 * stream.patience_s, _LONGEST_PATIENCE_S)
            stream.ask_at = time.monotonic() + stream.patience_s

    def _add(self, declared: Declared) -> int | None:
        return self._recording.add_channel(
            declared.topic, declared.schema, encoding=declared.encoding, metadata=declared.metadata
        )

    def _number(self, topic: str, key: str, tag: Tag) -> None:
        """Count a sample of a publisher, and note what is missing in its numbering."""
        publisher = self._publishers.get((tag.source, key))
        if publisher is None:
            if len(self._publishers) >= _MOST_PUBLISHERS:
                del self._publishers[next(iter(self._publishers))]
            publisher = self._publishers[tag.source, key] = _Publisher()
        publisher.received += 1
        if publisher.last and tag.sequence > publisher.last + 1:
            gap = tag.sequence - publisher.last - 1
            publisher.missed += gap
            self._recording.miss(topic, gap)
        publisher.last = max(publisher.last, tag.sequence)
