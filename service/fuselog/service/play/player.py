"""Plays logs onto Zenoh: publishes each message as it comes, and waits until services are done with it."""

import secrets
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import zenoh

from fuselog.fusion import Stream
from fuselog.replay import Channel
from fuselog.replay.play import Played, Range
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

_Kind = tuple[str, str, str]  # topic, encoding and schema name of messages that are one stream


@dataclass(frozen=True, slots=True, kw_only=True)
class Report:
    """What was sent by topic as it was named, and what services have taken of it; empty where none answers."""

    sent: dict[str, int]
    processed: dict[str, int]
    seconds: float

    @property
    def complete(self) -> bool:
        """Whether services took all that they subscribe to."""
        return all(count >= self.sent[topic] for topic, count in self.processed.items())


class Player:
    """Publishes messages of channels on a session, reliably: a slow subscriber slows it down.

    ``names`` are the topics under which those of the channels are published. Samples of a stream are numbered from 1
    as they leave, so that a jump in the log is no loss to who counts them.
    """

    def __init__(self, session: zenoh.Session, channels: Sequence[Channel], names: Mapping[str, str]) -> None:
        self._session = session
        self._source = secrets.token_bytes(16)
        self._keys = {channel.topic: key_of(names[channel.topic]) for channel in channels}
        self._names = names
        kinds = {_kind(channel): channel for channel in channels}
        streams: dict[str, list[Stream]] = {}
        for channel in kinds.values():
            streams.setdefault(self._keys[channel.topic], []).append(stream_of(channel))
        tell(session, streams)
        self._publishers = {kind: Publisher(session, self._keys[kind[0]], media_type(*kind[1:])) for kind in kinds}
        self._numbers = dict.fromkeys(kinds, 0)
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

    def play(self, messages: Iterable[Played], span: Range) -> Report:
        """Publish ``messages`` as they come, then wait for the services.

        Raises ``TransportError`` when all listeners leave; it says where in ``span`` to go on.
        """
        started = looked = time.monotonic()
        expected = bool(self._listened())
        heard = before = (
            span.start
        )  # somebody listened; the look before it, for what was sent since may not have arrived
        try:
            for played in messages:
                kind = _kind(played.channel)
                self._numbers[kind] += 1
                tag = Tag(self._numbers[kind], played.log_time, self._source)
                self._publishers[kind].put(played.payload, write_tag(tag))
                now = time.monotonic()
                if now - looked > _LOOK_EVERY_S:
                    looked = now
                    if expected and not self._listened():
                        raise TransportError(self._gone(before - span.first))
                    heard, before = played.t_ns, heard
            processed = self._wait_for_services(before - span.first) if expected else {}
        except zenoh.ZError as error:
            raise TransportError(self._gone(before - span.first)) from error
        return Report(sent=self._sent(), processed=processed, seconds=time.monotonic() - started)

    def _wait_for_services(self, heard_ns: int) -> dict[str, int]:
        """What each topic's slowest service has taken, when all are done or none moves any more."""
        sent = self._sent()
        progressed, before = time.monotonic(), dict[str, int]()
        while True:
            counts = self._taken(ask_progress(self._session, self._source))
            now = time.monotonic()
            if self._answered and not self._listened():
                raise TransportError(self._gone(heard_ns))
            if counts != before:
                progressed, before = now, counts
            if all(count >= sent[topic] for topic, count in counts.items()) or now - progressed > _STUCK_S:
                return counts
            time.sleep(_POLL_S)

    def _taken(self, answers: Sequence[Received]) -> dict[str, int]:
        """By name: the samples that the slowest service has taken."""
        counts: dict[str, int] = {}
        for answer in answers:
            for topic, key in self._keys.items():
                if key in answer.keys:
                    taken = answer.progress[key].received if key in answer.progress else 0
                    counts[self._names[topic]] = min(counts.get(self._names[topic], taken), taken)
        return counts

    def _wanted(self) -> set[str]:
        """The keys of ours that services say they subscribe to."""
        answers = ask_progress(self._session, self._source)
        self._answered = bool(answers)
        return {key for answer in answers for key in answer.keys} & set(self._keys.values())

    def _listened(self) -> set[str]:
        """The keys that somebody subscribes to."""
        return {publisher.key for publisher in self._publishers.values() if publisher.wanted}

    def _sent(self) -> dict[str, int]:
        """By name: the samples that have left."""
        sent = dict.fromkeys((self._names[topic] for topic in self._keys), 0)
        for (topic, _, _), number in self._numbers.items():
            sent[self._names[topic]] += number
        return sent

    def _gone(self, heard_ns: int) -> str:
        """What happened, and where to go on: rounded down, so that nothing is left out."""
        sent, resume = sum(self._numbers.values()), max(heard_ns, 0) // 10**6 / 1e3
        why = "the service has stopped, or its connection broke"
        return f"nobody listens any more after {sent} messages: {why}; go on with --start {resume:.3f}"


def _kind(channel: Channel) -> _Kind:
    return channel.topic, channel.encoding, channel.schema.name
