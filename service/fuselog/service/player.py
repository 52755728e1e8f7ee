"""Plays a log onto Zenoh: publishes each message when it is due, and waits until services are done with it."""

import secrets
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import zenoh

from fuselog.fusion import Stream
from fuselog.replay import Channel
from fuselog.replay.play import Played
from fuselog.replay.reprocess import stream_of
from fuselog.service.progress import Received, ask_progress
from fuselog.service.streams import tell
from fuselog.service.transport import TransportError, key_of
from fuselog.service.wire import Tag, media_type, write_tag
from fuselog.service.zenoh_door import Publisher

_LOOK_EVERY_S = 0.25  # whether anybody still listens
_SETTLED_S = 0.3  # without another subscription being announced
_STUCK_S = 10.0  # without progress of a service
_POLL_S = 0.02

Advance = Callable[[Played], None]


@dataclass(frozen=True, slots=True, kw_only=True)
class Report:
    """What was sent by topic, and what services have taken of it; empty where none answers."""

    sent: dict[str, int]
    processed: dict[str, int]
    seconds: float

    @property
    def complete(self) -> bool:
        """Whether services took all that they subscribe to."""
        return all(count >= self.sent[topic] for topic, count in self.processed.items())


class Player:
    """Publishes channels of a log on a session, reliably: a slow subscriber slows it down."""

    def __init__(self, session: zenoh.Session, channels: Sequence[Channel]) -> None:
        self._session = session
        self._source = secrets.token_bytes(16)
        self._topics = {channel.topic: key_of(channel.topic) for channel in channels}
        streams: dict[str, list[Stream]] = {}
        for channel in channels:
            streams.setdefault(self._topics[channel.topic], []).append(stream_of(channel))
        tell(session, streams)
        self._publishers = {
            channel.id: Publisher(
                session, self._topics[channel.topic], media_type(channel.encoding, channel.schema.name)
            )
            for channel in channels
        }
        self._sent = dict.fromkeys(self._topics, 0)
        self._answered = False  # whether a service has said that it is there

    def wait_for_subscriber(self, timeout_s: float) -> bool:
        """Whether somebody listens, and all that they listen to is known, within ``timeout_s``."""
        end = time.monotonic() + timeout_s
        seen, since = self._listened(), time.monotonic()
        while time.monotonic() < end:
            listened = self._listened()
            if listened != seen:
                seen, since = listened, time.monotonic()
            if listened and time.monotonic() - since > _SETTLED_S and self._wanted() <= listened:
                return True
            time.sleep(_POLL_S)
        return bool(self._listened())

    def play(self, messages: Iterable[Played], advance: Advance) -> Report:
        """Publish ``messages``, then wait for the services; raises ``TransportError`` when all listeners leave."""
        started = looked = time.monotonic()
        expected = bool(self._listened())
        for played in messages:
            tag = Tag(played.sequence, played.log_time, self._source)
            self._publishers[played.channel.id].put(played.payload, write_tag(tag))
            self._sent[played.channel.topic] += 1
            now = time.monotonic()
            if now - looked > _LOOK_EVERY_S:
                looked = now
                advance(played)
                if expected and not self._listened():
                    raise TransportError(self._gone())
        processed = self._wait_for_services() if expected else {}
        return Report(sent=self._sent, processed=processed, seconds=time.monotonic() - started)

    def _wait_for_services(self) -> dict[str, int]:
        """What each topic's slowest service has taken, when all are done or none moves any more."""
        progressed, before = time.monotonic(), dict[str, int]()
        while True:
            counts = self._taken(ask_progress(self._session, self._source))
            now = time.monotonic()
            if self._answered and not self._listened():
                raise TransportError(self._gone())
            if counts != before:
                progressed, before = now, counts
            if all(count >= self._sent[topic] for topic, count in counts.items()) or now - progressed > _STUCK_S:
                return counts
            time.sleep(_POLL_S)

    def _taken(self, answers: Sequence[Received]) -> dict[str, int]:
        """By topic: the samples that the slowest service has taken."""
        counts: dict[str, int] = {}
        for answer in answers:
            for topic, key in self._topics.items():
                if key in answer.keys:
                    taken = answer.progress[key].received if key in answer.progress else 0
                    counts[topic] = min(counts.get(topic, taken), taken)
        return counts

    def _wanted(self) -> set[str]:
        """The keys of ours that services say they subscribe to."""
        answers = ask_progress(self._session, self._source)
        self._answered = bool(answers)
        return {key for answer in answers for key in answer.keys} & set(self._topics.values())

    def _listened(self) -> set[str]:
        """The keys that somebody subscribes to."""
        return {publisher.key for publisher in self._publishers.values() if publisher.wanted}

    def _gone(self) -> str:
        sent = sum(self._sent.values())
        return f"nobody listens any more after {sent} messages: the service has stopped, or its connection broke"
